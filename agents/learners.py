"""Learners of Stable-Baselines3: made, and saved with everything that they go on from.

A checkpoint holds the learner with its optimisers, the replay buffer, the environments in the middle of their episodes,
the normalisation and every random generator. It is made of pickles, which run code when they are loaded: load your own
only.
"""

from __future__ import annotations

import pickle
import random
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize, unwrap_vec_wrapper
from torch import nn

from agents.folders import loading
from agents.hyperparameters import IPPO, TRAINED, algorithm_arguments, normalization_arguments
from agents.multi_agent import SharedPolicy, agent_env
from agents.runs import RunSettings
from wtg_gym.envs import EnvSettings
from wtg_gym.sb3 import DeterministicPolicy, SB3VecEnv

_MODEL = "model.zip"
_NORMALIZE = "vec_normalize.pkl"
_REPLAY_BUFFER = "replay_buffer.pkl"
_STATE = "state.pkl"
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
        """Write everything that training goes on from into an empty folder, between two rollouts of the learner."""
        model = self.model
        model.save(folder / _MODEL)
        if isinstance(model, OffPolicyAlgorithm):
            model.save_replay_buffer(folder / _REPLAY_BUFFER)
        env, normalize = model.get_env(), model.get_vec_normalize_env()
        assert env is not None
        if normalize is not None:
            normalize.save(str(folder / _NORMALIZE))
        monitor = unwrap_vec_wrapper(env, VecMonitor)
        assert isinstance(monitor, VecMonitor)
        state = {
            "environments": monitor.venv,
            "monitor": (monitor.episode_returns, monitor.episode_lengths, monitor.episode_count),
            # VecNormalize leaves it out of its own file.
            "discounted_returns": None if normalize is None else normalize.returns,
            "lstm_states": getattr(model, "_last_lstm_states", None),
            "python": random.getstate(),
            "numpy": np.random.get_state(),
            "torch": torch.get_rng_state(),
            "action_space": model.action_space.np_random.bit_generator.state,
        }
        (folder / _STATE).write_bytes(pickle.dumps(state))


def new_model(settings: RunSettings) -> BaseAlgorithm:
    """Return an untrained learner in its environments; lane i draws its scenarios from the run's seed plus i.

    Raises:
        ValueError: the algorithm refuses a hyperparameter.
    """
    single = settings.algo != IPPO
    lanes = SB3VecEnv(settings.n_envs, gains=True, **settings.env_arguments) if single else agent_env(settings)
    env: VecEnv = VecMonitor(lanes)
    try:
        arguments = algorithm_arguments(settings.hyperparameters)
        if (normalization := normalization_arguments(settings.hyperparameters)) is not None:
            env = VecNormalize(env, **normalization)
        return TRAINED[settings.algo](env=env, seed=settings.seed, device="cpu", **arguments)
    # They are checked nowhere but in the algorithm, which raises errors of any kind.
    except Exception as error:
        env.close()
        raise ValueError(f"{settings.algo} refuses {dict(settings.hyperparameters)}: {error}") from error


def load_model(folder: Path, settings: RunSettings) -> BaseAlgorithm:
    """Return the learner of a checkpoint, in its environments and with every random generator as it was.

    Raises:
        ValueError: a file is missing or damaged.
    """
    with loading(folder):
        state = pickle.loads((folder / _STATE).read_bytes())
        monitor = VecMonitor(state["environments"])
        monitor.episode_returns, monitor.episode_lengths, monitor.episode_count = state["monitor"]
        env: VecEnv = monitor
        if state["discounted_returns"] is not None:
            env = normalize = VecNormalize.load(str(folder / _NORMALIZE), monitor)
            normalize.returns = state["discounted_returns"]
        model = TRAINED[settings.algo].load(
            folder / _MODEL, env=env, device="cpu", custom_objects=CUSTOM_OBJECTS, force_reset=False
        )
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / _REPLAY_BUFFER)
        if state["lstm_states"] is not None:
            model._last_lstm_states = state["lstm_states"]  # type: ignore[attr-defined]
        # Last, because making the learner seeds the generators anew.
        random.setstate(state["python"])
        np.random.set_state(state["numpy"])
        torch.set_rng_state(state["torch"])
        model.action_space.np_random.bit_generator.state = state["action_space"]
    return model
