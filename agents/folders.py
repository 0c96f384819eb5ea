"""The folder of a training run: one process at a time, and checkpoints that are complete or not there."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows has no such locks: two processes in one folder go unnoticed there.
    fcntl = None  # type: ignore[assignment]

#: In the folder of a run: its last checkpoint and its best policy.
CHECKPOINTS, BEST = "checkpoints", "best"
_LOCK_FILE = ".lock"


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Create the folder of a new run and hold it; it is removed again if nothing has been written into it.

    Raises:
        ValueError: the folder is not empty, or cannot be created.
    """
    made = not path.exists()
    if not made and (not path.is_dir() or any(each.name != _LOCK_FILE for each in path.iterdir())):
        raise ValueError(
            f"{path} exists and is not an empty folder; give a new one, or --resume {path} where there is that option"
        )
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
    """Keep other processes from training in a folder; the system frees it when this process ends in any way.

    Raises:
        ValueError: another process trains in the folder, or it cannot be written to.
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


def save_folder(parent: Path, timesteps: int, write: Callable[[Path], object]) -> None:
    """Write a folder that is named after a number of timesteps, then remove the older ones beside it.

    The folder gets its name when it is complete, so that a complete one remains after a kill at any moment. One of the
    same name is complete and of the same step; it is kept.
    """
    target, temporary = parent / f"{timesteps:012d}", parent / "incomplete"
    if not target.exists():
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        write(temporary)
        temporary.rename(target)
    for other in folders(parent):
        if other != target:
            shutil.rmtree(other)


def folders(parent: Path) -> list[Path]:
    """Return the complete folders in `parent`, the fewest timesteps first."""
    return sorted(path for path in parent.glob("*") if path.name.isdigit())


@contextlib.contextmanager
def loading(path: Path) -> Iterator[None]:
    """Turn any error while a file or folder is loaded into a ValueError that names it.

    Damaged pickles and archives raise errors of any kind.
    """
    try:
        yield
    except Exception as error:
        reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise ValueError(f"{path} is missing, damaged or of another kind: {reason}") from error
