"""What a training run is, and the run.json that says so."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.metadata
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wtg_gym import __version__
from wtg_gym.envs import EnvSettings
from wtg_gym.files import read_json, to_json, write_atomically
from wtg_gym.physics.compiled import source_hash
from wtg_gym.scenarios import get_suite

try:
    import fcntl
except ImportError:  # Windows: two processes in one folder are not noticed there.
    fcntl = None  # type: ignore[assignment]

#: In the folder of a run: its description, its last checkpoint, its best policy.
RUN_FILE, CHECKPOINTS, BEST = "run.json", "checkpoints", "best"
_LOCK_FILE = ".lock"
_ASIDE = ".aside"
#: What decides the weights besides the packages.
_HASHES = ("source_hash", "suite_hash")
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
        provenance: command, versions, commit and start time of the process that began it.
        curve: one row per validation: timesteps, wall_time_s and the metrics of :func:`agents.validation.validate`.
        resumed: how many times it went on after an interruption.
        resumptions: provenance of the processes that went on, the latest last, each with what it found different.
        finished: whether all timesteps are done.
    """

    settings: RunSettings
    provenance: Mapping[str, Any]
    curve: list[dict[str, float]] = field(default_factory=list)
    resumed: int = 0
    resumptions: list[Mapping[str, Any]] = field(default_factory=list)
    finished: bool = False

    @classmethod
    def new(cls, settings: RunSettings) -> Run:
        """Return a run that starts now, with this process's provenance."""
        return cls(settings=settings, provenance=_provenance(settings))

    @property
    def best(self) -> dict[str, float]:
        """The row with the best score, the first one of several."""
        return max(self.curve, key=lambda row: row["score"])

    def go_on(self, *, allow_other_versions: bool = False) -> None:
        """Note that this process goes on with the run; one that is finished is left as it is.

        Args:
            allow_other_versions: go on where the sources, the suite or a package are not those of the process before.

        Raises:
            ValueError: they are not, and that is not allowed; the message names them.
        """
        now = _provenance(self.settings)
        differences = _differences(self.resumptions[-1] if self.resumptions else self.provenance, now)
        if differences and not allow_other_versions:
            raise ValueError(
                f"the run would not end as it began: {'; '.join(differences)}; go back to what it had, "
                "or go on all the same with --allow-other-versions"
            )
        if not self.finished:
            self.resumed += 1
            self.resumptions.append({**now, "differences": differences})

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
        data = read_json(path, "description of the run")
        try:
            run = cls(**{**data, "settings": RunSettings(**data["settings"])})
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is no description of a training run: {error}") from error
        run._check(path)
        return run

    def _check(self, path: Path) -> None:
        """Raise a ValueError where a value is not of the type that :meth:`write` writes."""
        right = {
            "curve": isinstance(self.curve, list) and all(map(_is_row, self.curve)),
            "hyperparameters": isinstance(self.settings.hyperparameters, dict),
            "provenance": _is_provenance(self.provenance),
            "resumptions": isinstance(self.resumptions, list) and all(map(_is_provenance, self.resumptions)),
            "resumed": type(self.resumed) is int,
            "finished": type(self.finished) is bool,
        }
        wrong = [name for name, is_right in right.items() if not is_right]
        if wrong:
            raise ValueError(f"{path} is no description of a training run: wrong values of {', '.join(wrong)}")


@contextlib.contextmanager
def loading(path: Path) -> Iterator[None]:
    """Name the file or folder of a run that cannot be loaded, in a ValueError.

    Pickles and archives raise anything when they are damaged.
    """
    try:
        yield
    except Exception as error:
        reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise ValueError(f"{path} is missing, damaged or of another kind: {reason}") from error


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Create the folder of a new run and hold it; at the end it is removed if nothing has been written into it.

    Raises:
        ValueError: there is something in it, or it cannot be created.
    """
    made = not path.exists()
    if not made and (not path.is_dir() or any(each.name != _LOCK_FILE for each in path.iterdir())):
        raise ValueError(f"{path} exists and is not an empty folder; give a new one, or go on with --resume {path}")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot create the folder {path}: {error.strerror}") from error
    try:
        with held(path):
            yield path
    finally:
        if made and all(each.name == _LOCK_FILE for each in path.iterdir()):
            shutil.rmtree(path)


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep every other process from training in a folder; however this one ends, the folder is free again.

    Raises:
        ValueError: another process trains in it, or it cannot be written to.
    """
    try:
        file = (folder / _LOCK_FILE).open("a")
    except OSError as error:
        raise ValueError(f"cannot write to the folder {folder}: {error.strerror}") from error
    with file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise ValueError(f"another process trains in {folder}; wait for it to end, or end it") from error
            except OSError:
                pass  # A file system without locks.
        yield


def save_folder(parent: Path, timesteps: int, write: Callable[[Path], None]) -> None:
    """Write a folder that is named after a number of timesteps, then remove the older ones beside it.

    It gets its name when it is complete, and one of the same name is moved aside before, so that a kill at any moment
    leaves a complete one behind; :func:`put_back` returns one that was left aside to its place.

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
    put_back(parent)
    aside = target.with_name(target.name + _ASIDE)
    if target.exists():
        target.rename(aside)
    temporary.rename(target)
    for other in [*folders(parent), aside]:
        if other != target and other.exists():
            shutil.rmtree(other)


def put_back(parent: Path) -> None:
    """Mend what a kill within :func:`save_folder` left: a folder aside goes back to its place, or goes if it is taken.

    Only the process that holds the run's folder may do so.
    """
    for aside in parent.glob(f"*{_ASIDE}"):
        target = aside.with_name(aside.name.removesuffix(_ASIDE))
        if target.exists():
            shutil.rmtree(aside)
        else:
            aside.rename(target)


def folders(parent: Path) -> list[Path]:
    """Return the complete folders in `parent`, the fewest timesteps first."""
    return sorted(path for path in parent.glob("*") if path.name.isdigit())


def _is_row(value: Any) -> bool:
    numbers = [value.get(key) for key in ("timesteps", "wall_time_s", "score")] if isinstance(value, dict) else [None]
    return all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in numbers)


def _is_provenance(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and isinstance(value.get("versions", {}), dict)
        and all(isinstance(value.get(key, ""), str) for key in _HASHES)
    )


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


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return what decides the weights and is not the same, in words; packages that only one side has do not count."""
    values = [(key.replace("_", " "), before[key][:12], now[key][:12]) for key in _HASHES if key in before]
    versions = before.get("versions", {}), now["versions"]
    values += [(name, versions[0][name], versions[1][name]) for name in sorted(versions[0].keys() & versions[1].keys())]
    return [f"{name} was {old} and is {new}" for name, old, new in values if old != new]


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


__all__ = [
    "BEST",
    "CHECKPOINTS",
    "RUN_FILE",
    "Run",
    "RunSettings",
    "folders",
    "held",
    "loading",
    "new_folder",
    "put_back",
    "save_folder",
]
