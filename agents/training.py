"""What every trainer does besides learning: it goes on from a checkpoint, validates, and keeps the best policy."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from torch import nn

from agents.folders import BEST, CHECKPOINTS, folders, save_folder
from agents.runs import Run, RunSettings
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation import Entry
from wtg_gym.files import write_atomically
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.names import check_not_built_in
from wtg_gym.policies.submission_folder import entry_text
from wtg_gym.policies.torch_export import TorchPolicy, onnx_bytes
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite

#: Largest difference between a file's actions and the network's, on random observations, some of them far from any that
#: an episode has: there a single precision leaves this much.
_TOLERANCE = 1e-4


class Learner(Protocol):
    """What is learned, as :class:`Training` needs to know it."""

    def network(self, settings: RunSettings) -> nn.Module:
        """Return the deterministic policy for the environment of a run, in the form of `wtg_gym.export_onnx`."""
        ...

    def save(self, folder: Path) -> object:
        """Write everything that training goes on from."""
        ...


class ResumableLearner(Learner, Protocol):
    """A learner that goes back to its checkpoints by itself, for :func:`train_in_rounds`."""

    def load(self, folder: Path) -> None:
        """Go back to what :meth:`save` wrote; a ValueError names a folder that is damaged."""
        ...


def last_checkpoint(run: Run, folder: Path) -> Path | None:
    """Return the folder that a run goes on from, named after its timesteps; None for a new run.

    Raises:
        ValueError: the run has validations, but no checkpoint.
    """
    saved = folders(folder / CHECKPOINTS)
    if run.curve and not saved:
        raise ValueError(f"{folder} has validations, but no checkpoint to go on from; begin anew in another folder")
    return saved[-1] if saved else None


def draw(lanes: TaskLanes, rng: np.random.Generator, n_scenarios: int) -> list[Scenario]:
    """Return training scenarios.

    Where there are strata, the seeds follow one another: a multiple of 15 holds as many of each stratum and kind.
    """
    if not lanes.suite.strata:
        return lanes.draw([rng] * n_scenarios)
    seeds = lanes.suite.train
    first = int(rng.integers(seeds.start, seeds.stop - n_scenarios))
    return lanes.scenarios(range(first, first + n_scenarios))


class Training:
    """A run while it is trained; made before the first step, so that it can go on whenever it is interrupted.

    Raises:
        ValueError: the policy of a new run could not be exported.
    """

    def __init__(self, run: Run, folder: Path, learner: Learner) -> None:
        self._run, self._folder, self._learner = run, folder, learner
        if not run.curve:
            # Refused now rather than after the training.
            _exported(learner, run.settings)
        run.write(folder)
        self._began = time.monotonic() - (run.curve[-1]["wall_time_s"] if run.curve else 0.0)

    @property
    def title(self) -> str:
        """How far the run is, for the line of its progress."""
        run = self._run
        return f"{run.settings.algo}, score {run.curve[-1]['score']:.1f}, best {run.best['score']:.1f}"

    def take_stock(self, timesteps: int, *, finished: bool = False) -> dict[str, float] | None:
        """Validate, keep the best policy and write a checkpoint, if an interval has ended or the training has.

        Returns:
            the metrics of the validation; None where there was none.
        """
        run, learner = self._run, self._learner
        run.finished = finished
        if not run.is_due(timesteps) and not (finished and run.curve[-1]["timesteps"] < timesteps):
            if finished:
                run.write(self._folder)
            return None
        network = learner.network(run.settings)
        played = TorchPolicy(network), per_group(network)
        metrics = run.validate(*played, timesteps, time.monotonic() - self._began)
        # First, because one whose row is missing in run.json is validated again on resumption.
        save_folder(self._folder / CHECKPOINTS, timesteps, learner.save)
        if run.best is run.curve[-1]:
            save_folder(self._folder / BEST, timesteps, self._write_best)
        run.write(self._folder)
        return metrics

    def _write_best(self, folder: Path) -> None:
        """Write the policy as an entry that `wtg-gym evaluate` plays."""
        settings = self._run.settings
        (folder / POLICY_FILE).write_bytes(_exported(self._learner, settings))
        values = entry_values(settings)
        if per_group(self._learner.network(settings)):
            values["per_group"] = True
        write_atomically(folder / ENTRY_FILE, entry_text(values))


def train_in_rounds(
    run: Run, folder: Path, learner: ResumableLearner, timesteps: int, learn: Callable[[int, int], float]
) -> None:
    """Train from the last checkpoint, if there is one, to the end, in rounds of equally many steps.

    `learn(index, n_rounds)` learns from one round and returns what is to be lowered. It should draw from a generator of
    the round: then a resumed run draws what an undisturbed one would have drawn.
    """
    n_rounds, first = -(-run.settings.timesteps // timesteps), 0
    if saved := last_checkpoint(run, folder):
        first = int(saved.name) // timesteps
        learner.load(saved)
    training = Training(run, folder, learner)
    with Progress("rounds") as progress:
        for index in range(first, n_rounds):
            training.take_stock(index * timesteps)
            value = learn(index, n_rounds)
            progress.update(f"objective {value:.3f}, {training.title}", index + 1 - first, n_rounds - first)
    training.take_stock(n_rounds * timesteps, finished=True)


def _exported(learner: Learner, settings: RunSettings) -> bytes:
    """Return the file of a policy as ONNX."""
    lanes, network = TaskLanes(EnvSettings(**settings.env_arguments), 1, 1), learner.network(settings)
    n_parts = lanes.n_wtg if per_group(network) else 1
    return onnx_bytes(network, lanes.n_observation // n_parts, lanes.n_action // n_parts, tolerance=_TOLERANCE)


def per_group(network: nn.Module) -> bool:
    """Return whether a network answers for one group at a time, which its attribute `per_group` says."""
    return bool(getattr(network, "per_group", False))


def entry_values(settings: RunSettings, name: str = "", description: str = "") -> dict[str, Any]:
    """Return the keys and values of entry.toml for a run's policy; a ValueError if its name would be refused.

    Without name or description they are made of algorithm and action mode.
    """
    values: dict[str, Any] = {
        "name": name or f"{settings.algo} {settings.action_mode}",
        "description": description or f"Trained with {settings.algo}.",
        "action_mode": settings.action_mode,
        "observation_mode": settings.observation_mode,
        "training_seed": settings.seed,
        "environment": get_suite(settings.suite).env_id,
    }
    values |= {} if settings.strategy == REFERENCE_STRATEGY else {"strategy": settings.strategy}
    check_not_built_in("the entry's name", values["name"])
    Entry(**values)
    return values
