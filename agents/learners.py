"""Learners of Stable-Baselines3: made, saved and loaded.

A checkpoint holds the learner with its optimisers, the replay buffer and the normalisation. The learner is a pickle,
which runs code when it is loaded: load your own only.
"""

from __future__ import annotations

from pathlib import Path

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import nn

from agents.folders import loading
from agents.hyperparameters import IPPO, TRAINED, algorithm_arguments, normalization_arguments
from agents.multi_agent import GainVecEnv, SharedPolicy, agent_env
from agents.runs import RunSettings
from wtg_gym.envs import EnvSettings
from wtg_gym.sb3 import DeterministicPolicy

_MODEL = "model.zip"
_NORMALIZE = "vec_normalize.pkl"
_REPLAY_BUFFER = "replay_buffer.pkl"
#: Without it, a class that the learner chose for its n_steps counts as the user's choice, with a warning.
CUSTOM_OBJECTS = {"replay_buffer_class": None}


class SB3Learner:
    """A learner of Stable-Baselines3, for :class:`agents.training.Training`."""

    def __init__(self, model: BaseAlgorithm) -> None:
        self.model = model

    def network(self, settings: RunSettings) -> nn.Module:
        """Return the deterministic policy for the environment of a run."""
        network = DeterministicPolicy(self.model)
        if settings.algo == IPPO:
            return SharedPolicy(network, EnvSettings(**settings.env_arguments))
        return network

    def save(self, folder: Path) -> None:
        """Write what training goes on from into an empty folder, between two rollouts of the learner."""
        model = self.model
        model.save(folder / _MODEL)
        if isinstance(model, OffPolicyAlgorithm):
            model.save_replay_buffer(folder / _REPLAY_BUFFER)
        if (normalize := model.get_vec_normalize_env()) is not None:
            normalize.save(str(folder / _NORMALIZE))


def _monitored(settings: RunSettings) -> VecEnv:
    lanes = agent_env(settings) if settings.algo == IPPO else GainVecEnv(settings.n_envs, **settings.env_arguments)
    return VecMonitor(lanes)


def new_model(settings: RunSettings) -> BaseAlgorithm:
    """Return an untrained learner in its environments; lane i draws its scenarios from the run's seed plus i.

    Raises:
        ValueError: the algorithm refuses a hyperparameter.
    """
    env = _monitored(settings)
    try:
        arguments = algorithm_arguments(settings.hyperparameters)
        if (normalization := normalization_arguments(settings.hyperparameters)) is not None:
            env = VecNormalize(env, **normalization)
        return TRAINED[settings.algo](env=env, seed=settings.seed, device="cpu", **arguments)
    except (AssertionError, AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        env.close()
        raise ValueError(f"{settings.algo} refuses {dict(settings.hyperparameters)}: {error}") from error


def load_model(folder: Path, settings: RunSettings) -> BaseAlgorithm:
    """Return the learner of a checkpoint, in environments that draw new episodes.

    Raises:
        ValueError: a file is missing or damaged.
    """
    with loading(folder):
        env = _monitored(settings)
        if normalization_arguments(settings.hyperparameters) is not None:
            env = VecNormalize.load(str(folder / _NORMALIZE), env)
        model = TRAINED[settings.algo].load(folder / _MODEL, env=env, device="cpu", custom_objects=CUSTOM_OBJECTS)
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / _REPLAY_BUFFER)
        model.set_random_seed(settings.seed + model.num_timesteps)
    return model
