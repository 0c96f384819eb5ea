"""What a training run is, and the run.json that says so."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wtg_gym import __version__
from wtg_gym.envs import EnvSettings
from wtg_gym.files import parse_json, read_text, to_json, write_atomically
from wtg_gym.physics.compiled import source_hash
from wtg_gym.scenarios import get_suite

#: In the folder of a run: its description, its last checkpoint, its best policy.
RUN_FILE, CHECKPOINTS, BEST = "run.json", "checkpoints", "best"
_PACKAGES = ("gymnasium", "numba", "numpy", "ray", "stable-baselines3", "sb3-contrib", "torch")


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """What a run is asked for; all of it survives JSON.

    Args:
        algo: name of the algorithm.
        hyperparameters: its section of a configuration file, as written there.
        action_mode, observation_mode, suite: as for the environment.
        seed: seed of the weights, the exploration and the scenarios.
        timesteps: environment steps in all, all lanes together.
        n_envs: number of lanes.
        interval: steps between two validations with a checkpoint each.
        validation_episodes: scenarios that a validation plays: the first ones of the suite's validation split.
        device: "cpu" or "cuda".

    Raises:
        ValueError: a value is unknown or out of range; the message says what is allowed.
    """

    algo: str
    hyperparameters: Mapping[str, Any]
    action_mode: str = "k+tau"
    observation_mode: str = "local"
    suite: str = "standard"
    seed: int = 0
    timesteps: int
    n_envs: int
    interval: int
    validation_episodes: int = 50
    device: str = "cpu"

    def __post_init__(self) -> None:
        EnvSettings(**self.env_arguments)
        if get_suite(self.suite).distribution is None:
            raise ValueError(f"suite {self.suite!r} is a fixed list of cases, nothing to train on")
        available = len(get_suite(self.suite).seeds("validation"))
        for name, low, high in (
            ("seed", 0, 2**31 - 1),
            ("timesteps", 1, 10**12),
            ("n_envs", 1, 100_000),
            ("interval", 1, 10**12),
            ("validation_episodes", 1, available),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise ValueError(f"{name} must be a whole number, {low} … {high}, got {value!r}")
        if self.device not in ("cpu", "cuda"):
            raise ValueError(f"device must be cpu or cuda, got {self.device!r}")

    @property
    def env_arguments(self) -> dict[str, Any]:
        """The environment's arguments that the run decides."""
        return {"action_mode": self.action_mode, "observation_mode": self.observation_mode, "suite": self.suite}


@dataclass(kw_only=True)
class Run:
    """A run as run.json describes it.

    Args:
        settings: what it was asked for.
        provenance: command, versions, commit and start time.
        curve: one row per validation: timesteps, wall_time_s and the metrics of :func:`agents.validation.validate`.
        resumed: how many times it went on after an interruption.
        finished: whether all timesteps are done.
    """

    settings: RunSettings
    provenance: Mapping[str, Any]
    curve: list[dict[str, float]] = field(default_factory=list)
    resumed: int = 0
    finished: bool = False

    @classmethod
    def new(cls, settings: RunSettings) -> Run:
        """Return a run that starts now, with this process's provenance."""
        return cls(settings=settings, provenance=_provenance(settings))

    @property
    def best(self) -> dict[str, float]:
        """The row with the best score, the first one of several."""
        return max(self.curve, key=lambda row: row["score"])

    def write(self, folder: Path) -> None:
        """Write run.json in one go."""
        write_atomically(folder / RUN_FILE, to_json(dataclasses.asdict(self)))

    @classmethod
    def read(cls, folder: Path) -> Run:
        """Read run.json.

        Raises:
            ValueError: there is none, or it is damaged.
        """
        path = folder / RUN_FILE
        data = parse_json(read_text(path, "description of the run"), path, "description of the run")
        try:
            return cls(**{**data, "settings": RunSettings(**data["settings"])})
        except (KeyError, TypeError) as error:
            raise ValueError(f"{path} is no description of a training run: {error!r}") from error


def new_folder(path: Path) -> Path:
    """Create the folder of a new run; a ValueError if there is something in it."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"{path} exists and is not an empty folder; give a new one, or go on with --resume {path}")
    path.mkdir(parents=True, exist_ok=True)
    return path


def save_folder(parent: Path, timesteps: int, write: Callable[[Path], None]) -> None:
    """Write a folder that is named after a number of timesteps, then remove the older ones beside it.

    It gets its name when it is complete, so that a kill at any moment leaves a complete one behind.

    Args:
        parent: where to put it.
        timesteps: number of timesteps.
        write: writes the files into the folder that it is given.
    """
    parent.mkdir(parents=True, exist_ok=True)
    target, temporary = parent / f"{timesteps:012d}", parent / "incomplete"
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    write(temporary)
    shutil.rmtree(target, ignore_errors=True)
    temporary.rename(target)
    for other in folders(parent):
        if other != target:
            shutil.rmtree(other)


def folders(parent: Path) -> list[Path]:
    """Return the complete folders in `parent`, the fewest timesteps first."""
    return sorted(path for path in parent.glob("*") if path.name.isdigit())


def _provenance(settings: RunSettings) -> dict[str, Any]:
    return {
        "command": shlex.join([Path(sys.executable).name, *sys.orig_argv[1:]]),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "machine": f"{platform.system()} {platform.machine()}",
        "git_commit": _git_commit(),
        "source_hash": source_hash(),
        "suite_hash": get_suite(settings.suite).hash,
        "versions": {
            "python": platform.python_version(),
            "wtg_gym": __version__,
            **{name: version for name in _PACKAGES if (version := _version(name)) is not None},
        },
    }


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _git_commit() -> str | None:
    """The checkout's commit, marked where files differ from it; None outside of a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


__all__ = ["BEST", "CHECKPOINTS", "RUN_FILE", "Run", "RunSettings", "folders", "new_folder", "save_folder"]
