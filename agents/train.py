"""`python -m agents.train`: trains a policy with Stable-Baselines3 on the native vector environment."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from agents.command import opened_run, run_command, settings_of, training_parser
from agents.hyperparameters import CONFIG_FOLDER, TRAINED, read_config
from agents.learners import SB3Learner, load_model, new_model
from agents.runs import Run, RunSettings
from agents.training import Training, last_checkpoint
from wtg_gym.progress import Progress
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite

_DESCRIPTION = """\
Trains a policy and writes everything about it to a folder: run.json, TensorBoard's files, the policy with the best
validation score, and a checkpoint to go on from with --resume after an interruption of any kind.

With "ippo" (independent PPO with shared parameters) every WTG group plays the same policy by itself, from what it
measures itself. A lane is then one group of one episode: one step of an episode is as many steps as it has groups."""


def train(run: Run, folder: Path) -> None:
    """Train until the run's timesteps are done, from its last checkpoint on if there is one.

    The curve, checkpoints, the best policy and TensorBoard's files go to `folder`. A wrong hyperparameter, or a
    checkpoint that is gone or damaged, is a ValueError.
    """
    # Sums over several threads depend on which of them ends first, those that draw the first weights among them.
    torch.set_num_threads(1)
    settings, saved = run.settings, last_checkpoint(run, folder)
    model = load_model(saved, settings) if saved else new_model(settings)
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
            self.logger.record_mean("episode/failure", float(info["termination_reason"] != ""))
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
    """Return the settings that the options and the hyperparameter file ask for; a ValueError if one is wrong."""
    if "algo" not in given:
        raise ValueError(f"--algo is needed: {', '.join(TRAINED)}")
    path = Path(given.get("config", CONFIG_FOLDER / f"{given['algo']}.yml"))
    raw = read_config(path, get_suite(given.get("suite", DEFAULT_SUITE)).task.env_id)
    return settings_of(given, given["algo"], raw, timesteps=raw.get("n_timesteps", 0), n_envs=raw.get("n_envs", 1))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = training_parser("agents.train", _DESCRIPTION, timesteps="the file's")
    parser.add_argument("--algo", choices=tuple(TRAINED), help="the algorithm")
    parser.add_argument("--n-envs", type=int, metavar="N", help="lanes side by side (default: the file's)")
    parser.add_argument("--config", metavar="FILE", help="hyperparameters (default: agents/configs/<algo>.yml)")

    def work() -> None:
        given = vars(parser.parse_args(argv))
        with opened_run(given, TRAINED, lambda: sb3_settings(given)) as (run, folder):
            train(run, folder)

    return run_command(work, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
