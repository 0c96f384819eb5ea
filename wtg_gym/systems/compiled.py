"""The one decorator for compiled functions, with machine code on disk that cannot go stale and heals itself.

Numba's own cache looks at the file of the decorated function alone: editing a callee in another file leaves a stale
caller. It also trusts its files: a damaged one ends in a traceback or in code that was made for something else, and two
processes that compile at once can mix up its index. Here the folder is named after a hash of every file that holds
compiled code, so that an edit anywhere starts a new folder. It has one file for each function and types of arguments,
which begins with a checksum over its key and its content. A file that is missing, damaged or of something else counts
as missing: numba compiles again, and the file is replaced. Machine code is run, so files and folders that another user
could have changed are not used either (:func:`wtg_gym.files.read_trusted`).

A wheel brings machine code (`.ci/wheel.py`) for the processor that built it or for a kind of processors, such as
x86-64-v3. Where this one is of that kind, and Python and numba are those that the code was made with, nothing is
compiled; the bits are the same.

Compiling takes some fifteen seconds, so it is reported: in a terminal by a line that moves and goes away; elsewhere the
logger "wtg_gym" warns once, with the folder. `logging.getLogger("wtg_gym").setLevel(logging.ERROR)` silences both.
"""

import contextlib
import functools
import gc
import hashlib
import logging
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import llvmlite
import numba
from numba.core import event
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from wtg_gym.files import read_trusted, trusted_folder, write_trusted

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).resolve().parent.parent
_WINDOWS = sys.platform == "win32"
_log = logging.getLogger("wtg_gym")
#: What machine code depends on besides the sources and the processor.
VERSIONS = (numba.__version__, llvmlite.__version__, sys.implementation.cache_tag)
#: Machine code that a wheel brings, and the kinds of processor that it may be for, with what they must have.
SHIPPED = _PACKAGE / "machine_code"
_V3 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
KINDS = {"x86-64-v4": (*_V3, "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"), "x86-64-v3": _V3}
#: From this function or routine on compiling is reported: a single one takes a moment.
_SILENT_FUNCTIONS = 2


def digest_of(*parts: bytes) -> bytes:
    return hashlib.sha256(b"".join(parts)).digest()


@functools.cache
def source_hash() -> str:
    """Return the sha256 hex digest of every source file that compiled code lives in, and of the grids."""
    parts = []
    for folder in ("systems", "physics", "tasks", "scenarios", "envs", "gradients", "grids"):
        for path in sorted(file for ending in ("py", "json") for file in (_PACKAGE / folder).glob(f"*.{ending}")):
            parts += [path.name.encode(), path.read_bytes()]
    return digest_of(*parts).hex()


def _places() -> Iterator[Path]:
    """Yield the folders that machine code may lie in, the first choice first."""
    for chosen in (numba.config.CACHE_DIR, os.environ.get("LOCALAPPDATA" if _WINDOWS else "XDG_CACHE_HOME")):
        if chosen:
            yield Path(chosen)
    with contextlib.suppress(RuntimeError):
        yield Path.home() / ".cache"
    with contextlib.suppress(OSError):
        yield Path(tempfile.gettempdir()) / f"wtg_gym-{'' if _WINDOWS else os.getuid()}"


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder of this source version's machine code; None where none can be written by the user alone."""
    for place in _places():
        with contextlib.suppress(OSError):
            folder = trusted_folder(place / "wtg_gym" / source_hash()[:16], make=True)
            if os.access(folder, os.W_OK):
                return folder
    return None


Processor = tuple[str, str, str]


def places_for(folder: Path | None, processor: Processor) -> list[tuple[Path | None, Processor]]:
    """Return folders and whose code they may hold: that for a processor, as numba tells it; then those of a wheel."""
    if not SHIPPED.is_dir():
        return [(folder, processor)]
    has = llvmlite.binding.get_host_cpu_features()
    kinds = [(processor[0], name, "") for name, needed in KINDS.items() if all(map(has.get, needed))]
    return [(folder, processor), *((SHIPPED, each) for each in (processor, *kinds))]


def kept(path: Path | None, key: bytes) -> bytes | None:
    """Return what was kept in a file; None if it is missing, not the user's own, damaged or kept under another key."""
    if path is not None:
        with contextlib.suppress(OSError):
            content = read_trusted(path)
            checksum, code = content[: len(key)], content[len(key) :]
            if checksum == digest_of(key, code):
                return code
    return None


def keep(path: Path | None, key: bytes, code: bytes) -> None:
    """Write a file whole, or not at all."""
    if path is None:
        return
    try:
        write_trusted(path, digest_of(key, code) + code)
    except OSError as error:
        _warn_that_nothing_is_kept(path.parent, error.strerror)


class DiskCache(NullCache):  # type: ignore[misc]
    """The cache of a numba dispatcher, in files of a folder or nowhere, by the hash of the source that it may call."""

    def __init__(self, function: Callable[..., Any], folder: Path | None, source_hash: str) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._folder = folder
        self._source = (self._name, source_hash, VERSIONS)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for a signature; None makes numba compile."""
        target_context.refresh()
        for folder, processor in places_for(self._folder, target_context.codegen().magic_tuple()):
            code = kept(*self._place(folder, sig, processor))
            # A pickle of another version of numba may raise any error.
            with contextlib.suppress(Exception):
                if code is not None:
                    return CompileResult._rebuild(target_context, *pickle.loads(code))
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what numba has compiled."""
        if not data.library.has_dynamic_globals:
            keep(*self._place(self._folder, sig, data.codegen.magic_tuple()), dumps(data._reduce()))

    def _place(self, folder: Path | None, sig: Any, processor: Processor) -> tuple[Path | None, bytes]:
        """Return the file of the code, and the key that it is kept under."""
        key = digest_of(repr((self._source, sig, processor)).encode())
        return folder and folder / f"{self._name.removeprefix('wtg_gym.')}-{key.hex()[:16]}.nbc", key


@functools.cache
def _warn_that_nothing_is_kept(folder: Path, reason: str) -> None:
    _log.warning("wtg_gym cannot keep machine code in %s (%s): the next start compiles again", folder, reason)


class Compilation(event.Listener):  # type: ignore[misc]
    """Compiled code of this process: functions with a :class:`DiskCache`, and routines; numba's lock guards it.

    The folder of the machine code is for the report; None keeps nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        #: When the functions that are being compiled were begun [s]; one may be within another.
        self._began: list[float] = []
        #: Functions and routines compiled, and the time it took [s].
        self.n_functions, self.seconds = 0, 0.0
        self._collects = False

    def on_start(self, event: Any) -> None:
        """Numba begins to compile a function."""
        if self._is_ours(event):
            self.begin(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: Any) -> None:
        """Numba has compiled a function, or failed to."""
        if self._is_ours(event):
            self.end()

    @staticmethod
    def _is_ours(event: Any) -> bool:
        return isinstance(getattr((event.data or {}).get("dispatcher"), "_cache", None), DiskCache)

    def begin(self, name: str) -> None:
        """Begin to compile something of a name."""
        if not self._began:
            # The compiler makes millions of objects that last: looking through them takes a tenth of its time.
            self._collects = gc.isenabled()
            gc.disable()
        self._began.append(time.perf_counter())
        self.n_functions += 1
        if self.n_functions == _SILENT_FUNCTIONS and not _shows_a_line():
            kept = "not kept: no folder can be written to" if self._folder is None else f"kept in {self._folder}"
            _log.warning("wtg_gym compiles its simulator to machine code: some fifteen seconds, %s", kept)
        if self.n_functions >= _SILENT_FUNCTIONS and _shows_a_line():
            message = (
                f"wtg_gym compiles its simulator, once: {self.seconds:.0f} s, {self.n_functions} functions, now {name}"
            )
            print(f"\r{message[:78]}\x1b[K", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        """End what was begun last."""
        took = time.perf_counter() - self._began.pop()
        if not self._began:
            if self._collects:
                gc.enable()
            self.seconds += took
            if self.n_functions >= _SILENT_FUNCTIONS and _shows_a_line():
                print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _shows_a_line() -> bool:
    """Return whether somebody watches who may see a line that moves."""
    return sys.stderr is not None and sys.stderr.isatty() and _log.isEnabledFor(logging.WARNING)


@functools.cache
def compilation() -> Compilation:
    """Return what this process has compiled so far."""
    listener = Compilation(cache_folder())
    event.register("numba:compile", listener)
    return listener


@contextlib.contextmanager
def reporting(name: str) -> Iterator[None]:
    """Report that something of a name is compiled meanwhile."""
    compilation().begin(name)
    try:
        yield
    finally:
        compilation().end()


def compiled(function: F) -> F:
    """Compile a function with numba, releasing the GIL, cached on disk per source version.

    No fast-math: reassociation or contraction would let a batched environment differ from the single environment.
    """
    compilation()
    return _kept(function)


def addressed(function: F) -> F:
    """Compile a function that only compiled code calls, at an address: without a wrapper for Python."""
    return _kept(function, no_cpython_wrapper=True)


def _kept(function: F, **options: Any) -> F:
    # Left out, numba's _nrt would be that of whatever function is compiled meanwhile.
    result: F = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True, _nrt=True, **options)(function)
    # With NUMBA_DISABLE_JIT it is the function itself.
    if result is not function:
        result._cache = DiskCache(function, cache_folder(), source_hash())  # type: ignore[attr-defined]
    return result


def internal(function: F) -> F:
    """Compile a function that compiled functions call, and Python never: what Python needs for a call is left out.

    It is part of the machine code of its callers, and not kept by itself. It must neither make arrays nor return any:
    numba counts references to arrays and their views by atomic operations, for which two threads that read the same
    arrays wait. That took 40 % of a step, so these functions do not count.
    """
    return _part(function, _nrt=False)


def allocating(function: F) -> F:
    """Compile as :func:`internal`, but what makes arrays, returns them, or calls a function that returns them."""
    return _part(function, _nrt=True)


def _part(function: F, **options: Any) -> F:
    options |= dict(nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)
    result: F = numba.njit(**options)(function)
    return result
