"""A training run: its settings, its folder, its validations.

A run's folder holds run.json (settings, provenance, curve), checkpoints/, from which it goes on after an interruption
of any kind, and best/, the policy with the best validation score as an entry that `wtg-gym evaluate` plays.
"""

from __future__ import annotations

import contextlib
import dataclasses
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, TypeVar

import numpy as np
from filelock import FileLock, Timeout
from torch import nn

from wtg_gym.envs import EnvSettings
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.evaluation.circumstances import installed
from wtg_gym.files import interpreting, read_json, to_json, trusted_files, write_atomically
from wtg_gym.physics.checked import Checked, design, required
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.policies.entry_folder import ENTRY_FILE, POLICY_FILE, check_not_built_in, entry_text
from wtg_gym.policies.torch_export import TorchPolicy, onnx_bytes
from wtg_gym.progress import Progress
from wtg_gym.ranges import require_range, require_whole
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite
from wtg_gym.systems.compiled import source_hash

H = TypeVar("H")
RUN_FILE = "run.json"
#: In the folder of a run: its last checkpoint and its best policy.
CHECKPOINTS, BEST = "checkpoints", "best"
#: Settings of a run that are arguments of the environment.
_OF_ENVIRONMENT = ("action_mode", "observation_mode", "suite", "strategy")
_PACKAGES = ("gymnasium", "numba", "numpy", "stable-baselines3", "sb3-contrib", "torch")
#: Largest difference between a file's actions and the network's, on random observations, some of them far from any that
#: an episode has: there a single precision leaves this much.
_TOLERANCE = 1e-4


class Learner(Protocol):
    """What is trained."""

    def network(self, settings: RunSettings) -> nn.Module:
        """Return the deterministic policy for the environment of a run, in the form of `wtg_gym.export_onnx`."""
        ...

    def save(self, folder: Path) -> object:
        """Write everything that training goes on from."""
        ...


class RoundLearner(Learner, Protocol):
    """A learner for :func:`train_in_rounds`."""

    def load(self, folder: Path) -> None:
        """Go back to what :meth:`save` wrote; a ValueError names a folder that is damaged."""
        ...


@dataclass(frozen=True, kw_only=True)
class RunSettings(Checked):
    """Settings of a run; all of them survive JSON; a ValueError if a value is unknown or out of range."""

    algo: str  # name of the algorithm
    hyperparameters: Mapping[str, Any]  # section of a configuration file, as written there
    #: action_mode, observation_mode, suite, strategy: as for the environment.
    action_mode: str = "k+tau"
    observation_mode: str = "local"
    suite: str = DEFAULT_SUITE
    strategy: str = REFERENCE_STRATEGY
    seed: int = design(0, "-", "seed of the weights, the exploration and the scenarios", 0, 2**31 - 1)
    timesteps: int = required("-", "design", "steps of all environments together", 1, 10**12)
    n_envs: int = required("-", "design", "number of environments", 1, 100_000)
    interval: int = design(0, "-", "steps between two validations with a checkpoint each; 0: a 20th of all", 0, 10**12)
    validation_episodes: int = design(
        50, "-", "scenarios of a validation, the first of the validation split", 1, 10_000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        EnvSettings(**self.env_arguments)
        suite = get_suite(self.suite)
        if not suite.distributions:
            raise ValueError(f"suite {self.suite!r} is a fixed list of cases, nothing to train on")
        fewest, most = max(1, len(suite.strata)), len(suite.seeds("validation"))
        require_whole("validation_episodes", self.validation_episodes, fewest, most)

    @property
    def env_arguments(self) -> dict[str, Any]:
        """Arguments of the environment."""
        return {name: getattr(self, name) for name in _OF_ENVIRONMENT}

    def entry(self, name: str = "", description: str = "") -> dict[str, Any]:
        """Return the keys and values of entry.toml for the run's policy; a ValueError if its name would be refused.

        Without name or description they are made of algorithm and action mode.
        """
        values: dict[str, Any] = {
            "name": name or f"{self.algo} {self.action_mode}",
            "description": description or f"Trained with {self.algo}.",
            "action_mode": self.action_mode,
            "observation_mode": self.observation_mode,
            "training_seed": self.seed,
            "environment": get_suite(self.suite).env_id,
        }
        values |= {} if self.strategy == REFERENCE_STRATEGY else {"strategy": self.strategy}
        check_not_built_in("the entry's name", values["name"])
        Entry(**values)
        return values


# --- the folder ------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other processes from training in a folder; a ValueError if one does."""
    try:
        lock = FileLock(folder / ".lock").acquire(timeout=0)
    except Timeout as error:
        raise ValueError(f"another process trains in {folder}; wait for it to end, or end it") from error
    with lock:
        yield


def save_folder(parent: Path, timesteps: int, write: Callable[[Path], object]) -> None:
    """Write a folder that is named after a number of timesteps, then remove the older ones beside it.

    The folder gets its name when it is complete, so that a complete one remains after a kill at any moment. One of the
    same name is complete and of the same step; it is kept. Only the user can enter it.
    """
    target = parent / f"{timesteps:012d}"
    if not target.exists():
        parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix="incomplete-", dir=parent))
        write(temporary)
        for file in temporary.iterdir():
            file.chmod(0o600)
        temporary.rename(target)
    for other in (*folders(parent), *parent.glob("incomplete-*")):
        if other != target:
            shutil.rmtree(other)


def folders(parent: Path) -> list[Path]:
    """Return the complete folders in `parent`, the fewest timesteps first."""
    return sorted(path for path in parent.glob("*") if path.name.isdecimal())


@contextlib.contextmanager
def loading(path: Path) -> Iterator[Path]:
    """Return a folder to load from, and turn any error meanwhile into a ValueError that names it.

    Damaged pickles and archives raise errors of any kind. They also run code: what another user could have written is
    refused, be it a file, the folder or one above it.
    """
    try:
        yield trusted_files(path)
    except Exception as error:
        raise ValueError(f"{path} is missing, damaged or of another kind: {type(error).__name__}: {error}") from error


# --- the run ---------------------------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class Run(Checked):
    """A run as run.json in its folder describes it."""

    MOST = MappingProxyType({"curve": 100_000})

    folder: Path
    settings: RunSettings
    provenance: Mapping[str, Any]  # command, versions, commit and start time of the process that began it
    curve: list[dict[str, Any]] = field(default_factory=list)  # one row per validation
    #: Provenance of the processes that went on, the latest last.
    resumptions: list[Mapping[str, Any]] = field(default_factory=list)
    finished: bool = False  # whether all timesteps are done
    _began: float = field(default=0.0, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for row in self.curve:
            for name in ("timesteps", "wall_time_s", "score", "marked"):
                require_range(f"{name} of the curve", row[name], -1e12, 1e12, "")
        for process in (self.provenance, *self.resumptions):
            if not isinstance(process["versions"], Mapping) or not isinstance(process["started"], str):
                raise ValueError(f"provenance must have versions and the time of the start, got {process!r:.80}")

    def hyperparameters(self, kind: type[H]) -> H:
        """Return the hyperparameters as a record; a ValueError names the run's file and the one that is wrong."""
        with interpreting(self.folder / RUN_FILE, "description of the run"):
            return kind(**self.settings.hyperparameters)

    @classmethod
    def new(cls, folder: Path, settings: RunSettings) -> Run:
        """Return a run that starts now, with this process's provenance."""
        return cls(folder=folder, settings=settings, provenance=_provenance(settings))

    @classmethod
    def read(cls, folder: Path) -> Run:
        """Read run.json; a ValueError if there is none, or it is damaged."""
        path = folder / RUN_FILE
        data = read_json(path, "description of the run")
        with interpreting(path, "description of the run"):
            return cls(**{**data, "folder": folder, "settings": RunSettings(**data["settings"])})

    def write(self, folder: Path | None = None) -> None:
        """Write run.json into the run's folder, or another, in one go."""
        data = dataclasses.asdict(self)
        del data["folder"], data["_began"]
        write_atomically((folder or self.folder) / RUN_FILE, to_json(data))

    def is_same(self, other: Run) -> bool:
        """Return whether another description is of the same run: its settings, and when it was begun."""
        return self.settings == other.settings and self.provenance["started"] == other.provenance["started"]

    @property
    def best(self) -> dict[str, float]:
        """The row that ranks first: in v1 with the mark, then by its score; the first one of several."""
        return max(self.curve, key=lambda row: (row["marked"], row["score"]))

    @property
    def title(self) -> str:
        """How far the run is, for the line of its progress."""
        return f"{self.settings.algo}, score {self.curve[-1]['score']:.1f}, best {self.best['score']:.1f}"

    @property
    def checkpoint(self) -> Path | None:
        """The folder that the run goes on from, named after its timesteps; None for a new run.

        Raises:
            ValueError: the run has validations, but no checkpoint, or one of another run or step.
        """
        saved = folders(self.folder / CHECKPOINTS)
        if self.curve and not saved:
            raise ValueError(f"{self.folder} has validations, but no checkpoint to go on from; begin anew in another")
        if not saved:
            return None
        run = Run.read(saved[-1])
        step = run.curve[-1]["timesteps"] if run.curve else None
        if not run.is_same(self) or step != int(saved[-1].name):
            raise ValueError(
                f"{saved[-1]} is a checkpoint of another run or of step {step}; begin anew in another folder"
            )
        return saved[-1]

    def go_on(self) -> None:
        """Note that this process goes on with the run; a finished run stays as it is."""
        if not self.finished:
            self.resumptions.append(_provenance(self.settings))

    def begin(self, learner: Learner) -> None:
        """Write run.json before the first step, so that the run can go on whenever it is interrupted.

        Raises:
            ValueError: the policy of a new run could not be exported, which is better known now than in the end.
        """
        if not self.curve:
            _exported(learner, self.settings)
        self.write()
        self._began = time.monotonic() - (self.curve[-1]["wall_time_s"] if self.curve else 0.0)

    def take_stock(self, learner: Learner, timesteps: int, *, finished: bool = False) -> dict[str, float] | None:
        """Validate, keep the best policy and write a checkpoint, if an interval has ended or the training has.

        Returns:
            the metrics of the validation; None where there was none.
        """
        self.finished = finished
        interval = self.settings.interval or max(1, self.settings.timesteps // 20)
        last = int(self.curve[-1]["timesteps"]) if self.curve else -interval
        if timesteps // interval <= last // interval and not (finished and last < timesteps):
            if finished:
                self.write()
            return None
        metrics = self.validate(learner, timesteps)
        # First, because one whose row is missing in run.json is validated again on resumption.
        save_folder(self.folder / CHECKPOINTS, timesteps, lambda folder: self._write_checkpoint(folder, learner))
        if self.best is self.curve[-1]:
            save_folder(self.folder / BEST, timesteps, lambda folder: self._write_best(folder, learner))
        self.write()
        return metrics

    def validate(self, learner: Learner, timesteps: int) -> dict[str, float]:
        """Play the validation scenarios, add a row with score and metrics to the curve, and return the metrics."""
        s, network = self.settings, learner.network(self.settings)
        entry = Entry(
            name="policy",
            policy=TorchPolicy(network),
            strategy=s.strategy,
            action_mode=s.action_mode,
            observation_mode=s.observation_mode,
            per_group=_per_group(network),
        )
        seeds = get_suite(s.suite).seeds("validation")[: s.validation_episodes]
        results = evaluate([entry], s.suite, "validation", seeds=seeds)
        (summary,) = (summary for summary in results.summaries if summary.name == entry.name)
        metrics = {
            "score": results.scores[entry.name].value,
            **{f"score_{name}": each.value for name, each in summary.strata.items()},
            "marked": float(summary.marked),
            "lost_or_beyond_percent": summary.lost_or_beyond_percent,
            "cost": summary.mean_pinned_cost,
            "failures_percent": summary.failures_percent,
            "nadir_hz": summary.median_nadir_hz,
            "median_deviation_mhz": summary.median_deviation_mhz,
            "duty_error_percent": summary.mean_duty_error_percent,
            "energy_share_percent": summary.mean_energy_share_percent,
        }
        wall_time_s = round(time.monotonic() - self._began, 2)
        self.curve.append({"timesteps": timesteps, "wall_time_s": wall_time_s, **metrics})
        return metrics

    def _write_checkpoint(self, folder: Path, learner: Learner) -> None:
        """Write the learner, and which run and step it is of."""
        learner.save(folder)
        self.write(folder)

    def _write_best(self, folder: Path, learner: Learner) -> None:
        """Write the policy as an entry that `wtg-gym evaluate` plays."""
        (folder / POLICY_FILE).write_bytes(_exported(learner, self.settings))
        per_group = {"per_group": True} if _per_group(learner.network(self.settings)) else {}
        write_atomically(folder / ENTRY_FILE, entry_text({**self.settings.entry(), **per_group}))


def _exported(learner: Learner, settings: RunSettings) -> bytes:
    """Return the file of a policy as ONNX."""
    lanes, network = TaskLanes(EnvSettings(**settings.env_arguments), 1, 1), learner.network(settings)
    n_parts = lanes.n_wtg if _per_group(network) else 1
    return onnx_bytes(network, lanes.n_observation // n_parts, lanes.n_action // n_parts, tolerance=_TOLERANCE)


def _per_group(network: nn.Module) -> bool:
    """Return whether a network answers for one group at a time, which its attribute `per_group` says."""
    return bool(getattr(network, "per_group", False))


def _provenance(settings: RunSettings) -> dict[str, Any]:
    return {
        "command": shlex.join([Path(sys.executable).name, *sys.orig_argv[1:]]),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "machine": f"{platform.system()} {platform.machine()}",
        "git_commit": _git_commit(),
        "source_hash": source_hash(),
        "suite_hash": get_suite(settings.suite).hash,
        "versions": installed(_PACKAGES),
    }


def _git_commit() -> str | None:
    """Return the checkout's commit, marked where files differ from it; None outside of a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def draw(lanes: TaskLanes, rng: np.random.Generator, n_scenarios: int) -> list[Scenario]:
    """Return training scenarios.

    Where there are strata, the seeds follow one another: a multiple of three holds as many of each stratum.
    """
    if not lanes.suite.strata:
        return lanes.draw([rng] * n_scenarios)
    seeds = lanes.suite.train
    first = int(rng.integers(seeds.start, seeds.stop - n_scenarios))
    return lanes.scenarios(range(first, first + n_scenarios))


def train_in_rounds(run: Run, learner: RoundLearner, timesteps: int, learn: Callable[[int, int], float]) -> None:
    """Train from the last checkpoint, if there is one, to the end, in rounds of equally many steps.

    `learn(index, n_rounds)` learns from one round and returns what is to be lowered. It should draw from a generator of
    the round: then a resumed run draws what an undisturbed one would have drawn.
    """
    n_rounds, first = -(-run.settings.timesteps // timesteps), 0
    if saved := run.checkpoint:
        first = int(saved.name) // timesteps
        learner.load(saved)
    run.begin(learner)
    with Progress("rounds") as progress:
        for index in range(first, n_rounds):
            run.take_stock(learner, index * timesteps)
            value = learn(index, n_rounds)
            progress.update(f"objective {value:.3f}, {run.title}", index + 1 - first, n_rounds - first)
    run.take_stock(learner, n_rounds * timesteps, finished=True)
