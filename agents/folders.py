"""The folder of a training run: one process at a time, and checkpoints that are complete or not there."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

#: In the folder of a run: its last checkpoint and its best policy.
CHECKPOINTS, BEST = "checkpoints", "best"


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
    return sorted(path for path in parent.glob("*") if path.name.isdecimal())


@contextlib.contextmanager
def loading(path: Path) -> Iterator[None]:
    """Turn any error while a file or folder is loaded into a ValueError that names it.

    Damaged pickles and archives raise errors of any kind.
    """
    try:
        yield
    except Exception as error:
        raise ValueError(f"{path} is missing, damaged or of another kind: {type(error).__name__}: {error}") from error
