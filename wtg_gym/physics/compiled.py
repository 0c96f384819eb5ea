"""The one decorator for compiled functions, with a disk cache that cannot go stale.

Numba's own cache looks at the file of the decorated function alone: editing a callee in another file leaves a
stale caller. Here the cache folder is named after a hash of every file that holds compiled code, so an edit
anywhere starts a new folder and an unchanged package starts quickly. The files in it are those of
:mod:`wtg_gym.physics.machine_code`.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import event

from wtg_gym.physics.machine_code import Compilation, DiskCache

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).resolve().parent.parent


@functools.cache
def source_hash() -> str:
    """Return the sha256 hex digest of every source file that compiled code lives in."""
    digest = hashlib.sha256()
    for folder in ("physics", "scenarios", "envs"):
        for path in sorted([*(_PACKAGE / folder).glob("*.py"), *(_PACKAGE / folder).glob("*.npy")]):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _base_folder() -> Path:
    if numba.config.CACHE_DIR:
        return Path(numba.config.CACHE_DIR)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home())))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _temporary_folder() -> Path:
    folder = Path(tempfile.gettempdir())
    if hasattr(os, "getuid"):
        # Everybody can write there, and the code is run: another user's folder is not taken.
        folder /= f"wtg_gym-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.lstat().st_uid != os.getuid():
            raise PermissionError(f"{folder} is another user's")
    return folder


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder of this source version's machine code, or None where nothing can be written."""
    for base in (_base_folder, _temporary_folder):
        try:
            folder = base() / "wtg_gym" / source_hash()[:16]
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder
        except (OSError, RuntimeError):
            continue
    return None


def compiled(function: F) -> F:
    """Compile a function with numba, releasing the GIL, cached on disk per source version.

    No fast-math: reassociation or contraction would let a batched lane differ from the single environment.
    """
    return _compile(function, forceinline=False)


def inlined(function: F) -> F:
    """Compile like :func:`compiled`, and build the function into whatever calls it.

    A call hands over the tables of a :class:`~wtg_gym.physics.plant_constants.Plant` one by one, some eighty numbers:
    where a function runs for less than a microsecond, that took longer than its work.
    """
    return _compile(function, forceinline=True)


def _compile(function: F, *, forceinline: bool) -> F:
    compilation()
    result: F = numba.njit(nogil=True, error_model="numpy", forceinline=forceinline)(function)
    # With NUMBA_DISABLE_JIT it is the function itself.
    if result is not function:
        result._cache = DiskCache(function, cache_folder(), source_hash())  # type: ignore[attr-defined]
    return result


def is_compiled(function: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether the machine code of a compiled function for such arguments is kept; True where none is made."""
    cache = getattr(function, "_cache", None)
    return cache is None or cache.holds(tuple(map(numba.typeof, arguments)), function.targetctx)  # type: ignore[attr-defined]


@functools.cache
def compilation() -> Compilation:
    """Return what this process has compiled so far."""
    listener = Compilation(cache_folder())
    event.register("numba:compile", listener)
    return listener
