"""A training run from start to end, or from its last checkpoint on."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize, unwrap_vec_wrapper

from agents.checkpoints import load_checkpoint, save_checkpoint, save_policy
from agents.entry_file import entry_file, entry_of
from agents.hyperparameters import build_model, parse
from agents.learners import network_of
from agents.metrics import EpisodeMetrics
from agents.onnx_graph import to_onnx
from agents.runs import BEST, CHECKPOINTS, Run, folders, put_back, save_folder
from agents.validation import validate
from agents.vec_env import GainVecEnv
from wtg_gym.cli.output import Progress
from wtg_gym.files import write_atomically
from wtg_gym.policies.load import ENTRY_FILE
from wtg_gym.policies.sb3_archive import NormalizedPolicy
from wtg_gym.sb3 import SB3VecEnv

_TENSORBOARD = "tensorboard"

#: Called with (timesteps, score) after each validation; an exception that it raises ends the run.
OnScore = Callable[[int, float], None]


class _Supervision(BaseCallback):
    """Measures, validates and saves while a learner learns.

    Args:
        run: the run; its curve grows here.
        folder: of the run; None to write nothing.
        metrics: of the episodes under way.
        progress: where to say how far it is.
        on_score: see :data:`OnScore`.
        restored_at: timesteps of the checkpoint that the learner is from; None for a new one.
    """

    def __init__(
        self,
        run: Run,
        folder: Path | None,
        metrics: EpisodeMetrics,
        progress: Progress,
        on_score: OnScore | None,
        restored_at: int | None,
    ) -> None:
        super().__init__()
        self._run = run
        self._folder = folder
        self._metrics = metrics
        self._progress = progress
        self._on_score = on_score
        self._began = time.monotonic()
        self._before_s = run.curve[-1]["wall_time_s"] if run.curve else 0.0
        self._restored_at = restored_at

    def _on_training_start(self) -> None:
        self._first = self.num_timesteps
        monitor = unwrap_vec_wrapper(self.training_env, VecMonitor)
        assert isinstance(monitor, VecMonitor) and isinstance(monitor.venv, SB3VecEnv)
        self._lanes = monitor.venv.vector_env.lanes

    def _on_step(self) -> bool:
        for metrics in self._metrics.update(self._lanes, self.locals["dones"], self.locals["infos"]):
            for key, value in metrics.items():
                self.logger.record_mean(f"episode/{key}", value)
        self._show()
        return True

    def _on_rollout_start(self) -> None:
        # Here, and not in the middle of a rollout, the learner is at rest and can be saved whole.
        rows, interval = self._run.curve, self._run.settings.interval
        if not rows or self.num_timesteps // interval > int(rows[-1]["timesteps"]) // interval:
            self.take_stock()

    def take_stock(self) -> None:
        """Validate, keep the best policy, and write a checkpoint."""
        run, model = self._run, self.model
        row = validate(NormalizedPolicy(model.policy, model.get_vec_normalize_env()), run.settings)
        for key, value in row.items():
            self.logger.record(f"validation/{key}", value)
        wall_time_s = self._before_s + time.monotonic() - self._began
        run.curve.append({"timesteps": model.num_timesteps, "wall_time_s": round(wall_time_s, 2), **row})
        if self._folder is not None:
            self._save(self._folder)
        if model.num_timesteps != self._restored_at and getattr(model, "use_sde", False):
            # A learner draws the noise of its next rollout before it calls us, and once more after a resumption.
            policy: Any = model.policy
            policy.reset_noise(model.n_envs)
        if self._on_score is not None:
            self._on_score(model.num_timesteps, row["score"])

    def _save(self, folder: Path) -> None:
        # In this order a kill in between is mended on resumption: a checkpoint whose row is missing in run.json is
        # validated again.
        model, run = self.model, self._run
        if model.num_timesteps != self._restored_at:
            write = functools.partial(save_checkpoint, model=model, extra=self._metrics)
            save_folder(folder / CHECKPOINTS, model.num_timesteps, write)
        if run.best is run.curve[-1]:
            save_folder(folder / BEST, model.num_timesteps, self._write_entry)
        run.write(folder)

    def _write_entry(self, folder: Path) -> None:
        """Write the policy as an entry for `wtg-gym evaluate --trust-pickle`."""
        save_policy(folder, self.model)
        entry = entry_of(self._run.settings, self.model.num_timesteps)
        write_atomically(folder / ENTRY_FILE, entry_file(entry, algorithm=type(self.model).__name__))

    def _show(self) -> None:
        total = self._run.settings.timesteps - self._first
        latest, best = self._run.curve[-1]["score"], self._run.best["score"]
        name = f"{self._run.settings.algo}, score {latest:.1f}, best {best:.1f}"
        # Counted from where this process began, so that the remaining time follows from its own speed.
        self._progress.update(name, (self.num_timesteps - self._first) / 1000, round(total / 1000))


def _use_one_thread() -> None:
    # Sums over several threads depend on which of them ends first, those that draw the first weights among them, and
    # networks this small gain nothing from them.
    torch.set_num_threads(1)


def start(run: Run) -> tuple[BaseAlgorithm, EpisodeMetrics]:
    """Return a new run's learner and measurements.

    Raises:
        ValueError: a hyperparameter is unknown or out of range, or makes a policy that cannot be exported.
    """
    _use_one_thread()
    settings = run.settings
    hyperparameters = parse(settings.algo, settings.hyperparameters)
    env: VecEnv = VecMonitor(GainVecEnv(settings.n_envs, **settings.env_arguments))
    if hyperparameters.normalize is not None:
        env = VecNormalize(env, **hyperparameters.normalize)
    try:
        model = build_model(settings.algo, hyperparameters, env, seed=settings.seed, device=settings.device)
        # Only to see that it can be written: better now than after the training.
        to_onnx(network_of(model.policy, model.get_vec_normalize_env()))
    except ValueError:
        env.close()
        raise
    return model, EpisodeMetrics(settings.n_envs)


def resume(run: Run, folder: Path, *, allow_other_versions: bool = False) -> tuple[BaseAlgorithm, EpisodeMetrics]:
    """Return a run's learner and measurements as its last checkpoint has them; anew if it has not validated yet.

    Args:
        run: what run.json says; it notes that it goes on.
        folder: of the run; no other process trains in it.
        allow_other_versions: as for :meth:`agents.runs.Run.go_on`.

    Raises:
        ValueError: the checkpoint is gone, or sources, suite or packages are not what they were.
    """
    _use_one_thread()
    for name in (CHECKPOINTS, BEST):
        put_back(folder / name)
    checkpoints = folders(folder / CHECKPOINTS)
    if run.curve and not checkpoints:
        raise ValueError(f"{folder} has validations, but no checkpoint to go on from; begin anew in another folder")
    run.go_on(allow_other_versions=allow_other_versions)
    if not checkpoints:
        return start(run)
    model, metrics = load_checkpoint(checkpoints[-1], run.settings.algo, run.settings.device)
    return model, metrics


def train(
    run: Run,
    model: BaseAlgorithm,
    metrics: EpisodeMetrics,
    folder: Path | None = None,
    on_score: OnScore | None = None,
) -> None:
    """Let a learner learn until the run's timesteps are done.

    Args:
        run: what :func:`start` or :func:`resume` was given; its curve grows here.
        model, metrics: what they returned.
        folder: where checkpoints, the best policy, TensorBoard's files and run.json go; None to write nothing.
        on_score: called with (timesteps, score) after every validation; an exception that it raises ends the run.
    """
    # A folder of a new learner has no checkpoint, even if its run was interrupted before the first one.
    restored = folder is not None and bool(folders(folder / CHECKPOINTS))
    restored_at = model.num_timesteps if restored else None
    if folder is not None:
        # Before anything else, so that whatever folder is left can be gone on with.
        run.write(folder)
    outputs = (None, []) if folder is None else (str(folder / _TENSORBOARD), ["tensorboard"])
    model.set_logger(configure(*outputs))
    env = model.get_env()
    assert env is not None
    try:
        with Progress("thousand steps") as progress:
            supervision = _Supervision(run, folder, metrics, progress, on_score, restored_at)
            supervision.init_callback(model)
            left = run.settings.timesteps - model.num_timesteps
            if left > 0:
                # A new learner starts its environments all the same; one from a checkpoint, be it of step 0, goes on.
                model.learn(left, callback=supervision, reset_num_timesteps=False)
            run.finished = True
            if run.curve[-1]["timesteps"] < model.num_timesteps:
                supervision.take_stock()
                model.logger.dump(model.num_timesteps)
            elif folder is not None:
                run.write(folder)
    finally:
        env.close()


__all__ = ["OnScore", "resume", "start", "train"]
