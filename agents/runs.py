"""A training run: its settings, its provenance, its validations, and run.json, which keeps them."""

from __future__ import annotations

import dataclasses
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from wtg_gym.envs import EnvSettings
from wtg_gym.evaluation import Entry, Policy, evaluate
from wtg_gym.evaluation.circumstances import installed
from wtg_gym.files import interpreting, read_json, to_json, write_atomically
from wtg_gym.physics.checked import Checked, design, required
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.ranges import require_range, require_whole
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite
from wtg_gym.systems.compiled import source_hash

H = TypeVar("H")

RUN_FILE = "run.json"
#: What decides the weights besides the packages.
_HASHES = ("source_hash", "suite_hash")
_PACKAGES = ("gymnasium", "numba", "numpy", "ray", "stable-baselines3", "sb3-contrib", "torch")


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
    timesteps: int = required("-", "design", "steps of all lanes together", 1, 10**12)
    n_envs: int = required("-", "design", "number of lanes", 1, 100_000)
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
        names = ("action_mode", "observation_mode", "suite", "strategy")
        return {name: getattr(self, name) for name in names}


@dataclass(kw_only=True)
class Run(Checked):
    """A run as run.json describes it."""

    MOST = MappingProxyType({"curve": 100_000})

    settings: RunSettings  # of the run
    provenance: Mapping[str, Any]  # command, versions, commit and start time of the process that began it
    curve: list[dict[str, Any]] = field(default_factory=list)  # one row per validation, see :meth:`validate`
    #: Provenance of the processes that went on, the latest last, each with the differences it found.
    resumptions: list[Mapping[str, Any]] = field(default_factory=list)
    finished: bool = False  # whether all timesteps are done

    def __post_init__(self) -> None:
        super().__post_init__()
        for row in self.curve:
            for name in ("timesteps", "wall_time_s", "score", "marked"):
                require_range(f"{name} of the curve", row[name], -1e12, 1e12, "")
        for process in (self.provenance, *self.resumptions):
            if not isinstance(process["versions"], Mapping) or not all(
                isinstance(process[key], str) for key in _HASHES
            ):
                raise ValueError(f"provenance must have versions and hashes, got {process!r:.80}")

    def hyperparameters(self, kind: type[H], folder: Path) -> H:
        """Return the hyperparameters as a record; a ValueError names the run's file and the one that is wrong."""
        with interpreting(folder / RUN_FILE, "description of the run"):
            return kind(**self.settings.hyperparameters)

    @classmethod
    def new(cls, settings: RunSettings) -> Run:
        """Return a run that starts now, with this process's provenance."""
        return cls(settings=settings, provenance=_provenance(settings))

    @property
    def best(self) -> dict[str, float]:
        """The row that ranks first: in v1 with the mark, then by its score; the first one of several."""
        return max(self.curve, key=lambda row: (row["marked"], row["score"]))

    def is_due(self, timesteps: int) -> bool:
        """Return whether an interval has ended since the last validation."""
        interval = self.settings.interval or max(1, self.settings.timesteps // 20)
        return not self.curve or timesteps // interval > int(self.curve[-1]["timesteps"]) // interval

    def validate(self, policy: Policy, per_group: bool, timesteps: int, wall_time_s: float) -> dict[str, float]:
        """Play the validation scenarios, add a row with score and metrics to the curve, and return the metrics.

        The policy takes raw observations, of one group at a time or of all; it was trained for that many environment
        steps and seconds. On scenarios without a scale there is a NoScaleError.
        """
        s = self.settings
        entry = Entry(
            name="policy",
            policy=policy,
            strategy=s.strategy,
            action_mode=s.action_mode,
            observation_mode=s.observation_mode,
            per_group=per_group,
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
        self.curve.append({"timesteps": timesteps, "wall_time_s": round(wall_time_s, 2), **metrics})
        return metrics

    def go_on(self) -> list[str]:
        """Note that this process goes on with the run; a finished run stays as it is.

        Returns:
            in words what decides the weights and is not as it was before: sources, suite or packages.
        """
        if self.finished:
            return []
        now = _provenance(self.settings)
        differences = _differences(self.resumptions[-1] if self.resumptions else self.provenance, now)
        self.resumptions.append({**now, "differences": differences})
        return differences

    def write(self, folder: Path) -> None:
        """Write run.json in one go."""
        write_atomically(folder / RUN_FILE, to_json(dataclasses.asdict(self)))

    @classmethod
    def read(cls, folder: Path) -> Run:
        """Read run.json; a ValueError if there is none, or it is damaged."""
        path = folder / RUN_FILE
        data = read_json(path, "description of the run")
        with interpreting(path, "description of the run"):
            return cls(**{**data, "settings": RunSettings(**data["settings"])})


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


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return in words what decides the weights and differs; packages that only one side has do not count."""
    old, new = ({**{key: each[key][:12] for key in _HASHES}, **each["versions"]} for each in (before, now))
    common = [name for name in new if name in old]
    return [f"{name} was {old[name]} and is {new[name]}" for name in common if old[name] != new[name]]


def _git_commit() -> str | None:
    """Return the checkout's commit, marked where files differ from it; None outside of a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
