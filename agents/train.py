"""`python -m agents.train`: trains a policy with Stable-Baselines3 on the native vector environment."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import nn

from agents.command import (
    Parser,
    add_plant_options,
    add_training_options,
    given_options,
    opened_run,
    run_command,
    settings_of,
)
from agents.hyperparameters import ALGORITHMS, CONFIG_FOLDER, parse, read_config
from agents.learners import build_model, load_checkpoint, save_checkpoint
from agents.multi_agent import SharedPolicy, agent_env
from agents.runs import Run, RunSettings
from agents.training import SHARED, Training, last_checkpoint
from agents.vec_env import GainVecEnv
from wtg_gym.envs import EnvSettings
from wtg_gym.progress import Progress
from wtg_gym.sb3 import DeterministicPolicy
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite

_DESCRIPTION = """\
Trains a policy and writes everything about it to a folder: run.json, TensorBoard's files, the policy with the best
validation score, and a checkpoint to go on from with --resume after an interruption of any kind.

With "ippo" (independent PPO with shared parameters) every WTG group plays the same policy by itself, from what it
measures itself. A lane is then one group of one episode: one step of an episode is as many steps as it has groups."""
_EXAMPLES = """\
examples:
  python -m agents.train --algo ppo --output runs/ppo-0 --seed 0
  python -m agents.train --algo sac --action-mode k --timesteps 200000 --output runs/sac-k
  python -m agents.train --algo ippo --groups 4 --output runs/ippo-4
  python -m agents.train --resume runs/ppo-0
  tensorboard --logdir runs"""

#: The algorithms to choose from.
TRAINED = (*ALGORITHMS, *SHARED)


def _base(algo: str) -> str:
    """Return the algorithm of Stable-Baselines3 that an algorithm is made of."""
    return "ppo" if algo in SHARED else algo


class SB3Learner:
    """A learner of Stable-Baselines3, for :class:`agents.training.Training`."""

    def __init__(self, model: BaseAlgorithm) -> None:
        self.model = model

    def network(self, settings: RunSettings) -> nn.Module:
        """Return the deterministic policy for the environment of a run."""
        network = DeterministicPolicy(self.model)
        if settings.algo in SHARED:
            return SharedPolicy(network, EnvSettings(**settings.env_arguments))
        return network

    def save(self, folder: Path) -> None:
        """Write everything that training goes on from."""
        save_checkpoint(folder, self.model)


def start(run: Run) -> BaseAlgorithm:
    """Return a new run's learner.

    Raises:
        ValueError: a hyperparameter is unknown or out of range.
    """
    # Sums over several threads depend on which of them ends first, those that draw the first weights among them.
    torch.set_num_threads(1)
    settings = run.settings
    hyperparameters = parse(_base(settings.algo), settings.hyperparameters)
    shared = settings.algo in SHARED
    lanes = agent_env(settings) if shared else GainVecEnv(settings.n_envs, **settings.env_arguments)
    env: VecEnv = VecMonitor(lanes)
    if hyperparameters.normalize is not None:
        env = VecNormalize(env, **hyperparameters.normalize)
    try:
        return build_model(_base(settings.algo), hyperparameters, env, seed=settings.seed, device=settings.device)
    except ValueError:
        env.close()
        raise


def train(run: Run, folder: Path) -> None:
    """Train until the run's timesteps are done, from its last checkpoint on if there is one.

    Args:
        run: its curve grows here.
        folder: for checkpoints, the best policy, TensorBoard's files and run.json.

    Raises:
        ValueError: a hyperparameter is wrong, or the run's checkpoint is gone or damaged.
    """
    torch.set_num_threads(1)
    settings, saved = run.settings, last_checkpoint(run, folder)
    model = load_checkpoint(saved, _base(settings.algo), settings.device) if saved else start(run)
    env = model.get_env()
    assert env is not None
    try:
        training = Training(run, folder, SB3Learner(model))
        model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
        with Progress("thousand steps") as progress:
            restored_at = model.num_timesteps if saved else None
            supervision = _Supervision(training, progress, settings.timesteps, restored_at)
            supervision.init_callback(model)
            left = settings.timesteps - model.num_timesteps
            if left > 0:
                # A new learner starts its environments all the same; one from a checkpoint, be it of step 0, goes on.
                model.learn(left, callback=supervision, reset_num_timesteps=False)
            supervision.take_stock(finished=True)
            model.logger.dump(model.num_timesteps)
    finally:
        env.close()


class _Supervision(BaseCallback):
    """Measures, validates and saves while a learner learns.

    Args:
        restored_at: timesteps of the checkpoint that the learner is from; None for a new one.
    """

    def __init__(self, training: Training, progress: Progress, timesteps: int, restored_at: int | None) -> None:
        super().__init__()
        self._training, self._progress, self._timesteps = training, progress, timesteps
        self._restored_at, self._first = restored_at, restored_at or 0

    def _on_step(self) -> bool:
        for info in itertools.compress(self.locals["infos"], self.locals["dones"]):
            for key, value in info["metrics"].items():
                self.logger.record_mean(f"episode/{key}", value)
        # Counted from where this process began, so that the remaining time follows from its own speed.
        done, total = self.num_timesteps - self._first, self._timesteps - self._first
        self._progress.update(self._training.title, done / 1000, round(total / 1000))
        return True

    def _on_rollout_start(self) -> None:
        # Here, and not in the middle of a rollout, the learner is at rest and can be saved whole.
        self.take_stock()

    def take_stock(self, *, finished: bool = False) -> None:
        """Validate, keep the best policy, and write a checkpoint, where it is time for it."""
        model = self.model
        metrics = self._training.take_stock(model.num_timesteps, finished=finished)
        if metrics is None:
            return
        for key, value in metrics.items():
            self.logger.record(f"validation/{key}", value)
        if model.num_timesteps != self._restored_at and getattr(model, "use_sde", False):
            # A learner draws the noise of its next rollout before it calls us, and once more after a resumption.
            actor: Any = model.policy
            actor.reset_noise(model.n_envs)


def sb3_settings(given: Mapping[str, Any]) -> RunSettings:
    """Return the settings that the options and the hyperparameter file ask for.

    Raises:
        ValueError: a value is missing, unknown or out of range.
    """
    if "algo" not in given:
        raise ValueError(f"--algo is needed: {', '.join(TRAINED)}")
    algo = given["algo"]
    env_id = get_suite(given.get("suite", DEFAULT_SUITE)).benchmark.env_id
    path = Path(given.get("config", CONFIG_FOLDER / f"{algo}.yml"))
    raw = read_config(path, env_id)
    try:
        file = parse(_base(algo), raw)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return settings_of(given, algo, raw, timesteps=file.n_timesteps, n_envs=file.n_envs)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.train", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--algo", choices=TRAINED, help="the algorithm")
    add_training_options(parser, timesteps="the file's")
    add_plant_options(parser)
    parser.add_argument("--n-envs", type=int, metavar="N", help="lanes side by side (default: the file's)")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="where the networks are (default: cpu)")
    text = "hyperparameters (default: agents/configs/<algo>.yml, of td3 and tqc for v0 only)"
    parser.add_argument("--config", metavar="FILE", help=text)

    def work() -> None:
        given = given_options(parser.parse_args(argv))
        with opened_run(given, TRAINED, lambda: sb3_settings(given)) as (run, folder):
            train(run, folder)

    return run_command(work, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
