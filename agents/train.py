"""`python -m agents.train`: trains a policy with Stable-Baselines3 on the native vector environment.

Hyperparameters are in the yml format of RL Zoo. A checkpoint holds the learner with its optimisers, the normalisation
and the replay buffer. It is made of pickles, which run code when they are loaded: load your own only.
"""

import copy
import functools
import itertools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import yaml
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from agents.run import Learner, Run, RunOptions, RunSettings, begin_or_go_on, loading, run_command
from wtg_gym.files import interpreting, read_text, require_plain
from wtg_gym.progress import Progress
from wtg_gym.sb3 import DeterministicPolicy, make_sb3_vec_env
from wtg_gym.scenarios import get_suite

#: The algorithms by name; RL Zoo calls recurrent_ppo ppo_lstm.
TRAINED: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "recurrent_ppo": RecurrentPPO}
CONFIG_FOLDER = Path(__file__).parent / "configs"
#: A text that begins so is a schedule that falls linearly to zero.
_LINEAR = "lin_"
_OF_THE_RUN = ("n_timesteps", "n_envs", "normalize")
_MODEL, _NORMALIZE, _REPLAY_BUFFER = "model.zip", "vec_normalize.pkl", "replay_buffer.pkl"
#: Without it, a class that the learner chose for its n_steps counts as the user's choice, with a warning.
CUSTOM_OBJECTS = {"replay_buffer_class": None}


def read_config(path: Path, env_id: str) -> dict[str, Any]:
    """Return the section of an environment in a yml file as it is written there; a ValueError if there is none."""
    text = read_text(path, "hyperparameter file")
    with interpreting(path, "hyperparameter file"):
        try:
            data = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ValueError(f"it is not yml: {error}") from error
        require_plain(data, "it", len(text), infinite=False)
        if not isinstance(data, dict) or not isinstance(data.get(env_id), dict):
            raise ValueError(f"it must have a section {env_id!r} with keys and values")
    return dict(data[env_id])


def algorithm_arguments(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the algorithm, `policy` among them, that a section of a file means."""
    # Dictionaries are written as such: RL Zoo evaluates texts in the place of them, which would run any code. The
    # algorithms write into policy_kwargs.
    arguments = copy.deepcopy({key: value for key, value in raw.items() if key not in _OF_THE_RUN})
    for key, value in arguments.items():
        if isinstance(value, str) and value.startswith(_LINEAR):
            arguments[key] = LinearSchedule(float(value.removeprefix(_LINEAR)), 0.0, 1.0)
    return arguments


def normalization_arguments(raw: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the arguments of VecNormalize that a section of a file means; None for no normalisation."""
    arguments = raw.get("normalize", False)
    if arguments is False:
        return None
    # Rewards are scaled by the spread of the returns that the learner sees.
    return {**({} if arguments is True else arguments), **({"gamma": raw["gamma"]} if "gamma" in raw else {})}


class SB3Learner(Learner):
    """A learner of Stable-Baselines3, as it is now; :func:`load_model` loads what it saves."""

    def __init__(self, model: BaseAlgorithm) -> None:
        self.model, self.network = model, DeterministicPolicy(model)

    def save(self, folder: Path) -> None:
        self.model.save(folder / _MODEL)
        if isinstance(self.model, OffPolicyAlgorithm):
            self.model.save_replay_buffer(folder / _REPLAY_BUFFER)
        if (normalize := self.model.get_vec_normalize_env()) is not None:
            normalize.save(str(folder / _NORMALIZE))


def new_model(settings: RunSettings) -> BaseAlgorithm:
    """Return an untrained learner in its environments; environment i draws its scenarios from the run's seed plus i."""
    env: VecEnv = make_sb3_vec_env(settings.n_envs, reward="score", **settings.env_arguments)
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
    """Return the learner of a checkpoint, which begins new episodes; a ValueError if a file is missing or damaged."""
    with loading(folder) as folder:
        env: VecEnv = make_sb3_vec_env(settings.n_envs, reward="score", **settings.env_arguments)
        if normalization_arguments(settings.hyperparameters) is not None:
            env = VecNormalize.load(str(folder / _NORMALIZE), env)
        model = TRAINED[settings.algo].load(folder / _MODEL, env=env, device="cpu", custom_objects=CUSTOM_OBJECTS)
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / _REPLAY_BUFFER)
        (seed,) = np.random.SeedSequence((settings.seed, model.num_timesteps)).generate_state(1) >> 1
        model.set_random_seed(int(seed))
    return model


def train(run: Run) -> None:
    """Train to the end, from the last checkpoint on if there is one; all files go to the run's folder.

    A wrong hyperparameter, or a checkpoint that is gone or damaged, is a ValueError.
    """
    # Sums over several threads depend on which of them ends first, those that draw the first weights among them.
    torch.set_num_threads(1)
    settings, saved = run.settings, run.checkpoint
    model = load_model(saved, settings) if saved else new_model(settings)
    env = model.get_env()
    assert env is not None
    try:
        run.begin(SB3Learner(model))
        model.set_logger(configure(str(run.folder / "tensorboard"), ["tensorboard"]))
        with Progress("thousand steps") as progress:
            supervision = _Supervision(run, progress, model.num_timesteps)
            supervision.init_callback(model)
            if (remaining := settings.timesteps - model.num_timesteps) > 0:
                model.learn(remaining, callback=supervision, reset_num_timesteps=False)
            supervision.take_stock(finished=True)
            model.logger.dump(model.num_timesteps)
    finally:
        env.close()


class _Supervision(BaseCallback):
    """Measures, validates and saves while a learner learns; `first` is the step at which this process began."""

    def __init__(self, run: Run, progress: Progress, first: int) -> None:
        super().__init__()
        self._run, self._progress, self._first = run, progress, first

    def _on_step(self) -> bool:
        for info in itertools.compress(self.locals["infos"], self.locals["dones"]):
            self.logger.record_mean("episode/failure", float(info["termination_reason"] != ""))
        # So that the remaining time follows from this process's own speed.
        done, total = self.num_timesteps - self._first, self._run.settings.timesteps - self._first
        self._progress.update(self._run.title, done / 1000, round(total / 1000))
        return True

    def _on_rollout_start(self) -> None:
        # Here, and not in the middle of a rollout, the learner is at rest and can be saved whole.
        self.take_stock()

    def take_stock(self, *, finished: bool = False) -> None:
        """Validate, keep the best policy, and write a checkpoint, where it is time for it."""
        learner = SB3Learner(self.model)
        metrics = self._run.take_stock(learner, self.model.num_timesteps, finished=finished)
        for key, value in (metrics or {}).items():
            self.logger.record(f"validation/{key}", value)


def command(
    *,
    algo: Literal["ppo", "recurrent_ppo", "sac"] | None = None,
    config: Path | None = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Train a policy with Stable-Baselines3.

    Everything about it is written to a folder: run.json, TensorBoard's files, the policy with the best validation
    score, and a checkpoint to go on from with --resume after an interruption of any kind.

    Args:
        algo: the algorithm
        config: hyperparameters; default: agents/configs/<algo>.yml
    """

    def settings() -> RunSettings:
        if algo is None:
            raise ValueError(f"--algo is needed: {', '.join(TRAINED)}")
        raw = read_config(config or CONFIG_FOLDER / f"{algo}.yml", get_suite(options.suite).task.env_id)
        return options.settings(algo, raw, timesteps=raw.get("n_timesteps", 0), n_envs=raw.get("n_envs", 1))

    begin_or_go_on(options, TRAINED, settings, train)


main = functools.partial(run_command, command, "agents.train", "go on with --resume")

if __name__ == "__main__":
    sys.exit(main())
