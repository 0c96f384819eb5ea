"""`python -m agents.train`: trains a policy with Stable-Baselines3 on the native vector environment."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from agents.command import RunOptions, begin_or_go_on, run_command
from agents.learners import CONFIG_FOLDER, TRAINED, SB3Learner, load_model, new_model, read_config
from agents.run import Run, RunSettings
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite


def train(run: Run) -> None:
    """Train until the run's timesteps are done, from its last checkpoint on if there is one.

    The curve, checkpoints, the best policy and TensorBoard's files go to the run's folder. A wrong hyperparameter, or a
    checkpoint that is gone or damaged, is a ValueError.
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
            if (left := settings.timesteps - model.num_timesteps) > 0:
                model.learn(left, callback=supervision, reset_num_timesteps=False)
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
        metrics = self._run.take_stock(SB3Learner(self.model), self.model.num_timesteps, finished=finished)
        for key, value in (metrics or {}).items():
            self.logger.record(f"validation/{key}", value)


def new_settings(options: RunOptions, algo: str | None, config: Path | None) -> RunSettings:
    """Return the settings that the options and the hyperparameter file ask for; a ValueError if one is wrong."""
    if algo is None:
        raise ValueError(f"--algo is needed: {', '.join(TRAINED)}")
    raw = read_config(config or CONFIG_FOLDER / f"{algo}.yml", get_suite(options.suite).task.env_id)
    return options.settings(algo, raw, timesteps=raw.get("n_timesteps", 0), n_envs=raw.get("n_envs", 1))


def command(
    *,
    algo: Literal["ppo", "recurrent_ppo", "sac", "ippo"] | None = None,
    config: Path | None = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Train a policy with Stable-Baselines3.

    Everything about it is written to a folder: run.json, TensorBoard's files, the policy with the best validation
    score, and a checkpoint to go on from with --resume after an interruption of any kind.

    With "ippo" (independent PPO with shared parameters) every WTG group plays the same policy by itself, from what it
    measures itself. An environment is then one group of one episode: one step of an episode is as many steps as it has
    groups.

    Args:
        algo: the algorithm
        config: hyperparameters; default: agents/configs/<algo>.yml
    """
    begin_or_go_on(options, TRAINED, lambda: new_settings(options, algo, config), train)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    return run_command(command, "agents.train", argv, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
