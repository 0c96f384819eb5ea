"""Everything beside the entries that decides the last bits of a result: code, packages, Python and the processor."""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import platform
from collections.abc import Iterable
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

from wtg_gym import __version__
from wtg_gym.files import sha256
from wtg_gym.systems.compiled import source_hash

_PACKAGES = ("numpy", "scipy", "numba", "onnxruntime")


@functools.cache
def versions() -> dict[str, str]:
    """Return the versions of wtg_gym, Python and the installed packages that compute, and the kind of processor."""
    return {**installed(_PACKAGES), "processor": f"{platform.machine()} {get_host_cpu_name()}"}


def installed(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of wtg_gym, Python, and those of the packages that are installed."""
    numbers = {"wtg_gym": __version__, "python": platform.python_version()}
    for package in packages:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            numbers[package] = importlib.metadata.version(package)
    return numbers


@functools.cache
def measurement_hash() -> str:
    """Return the sha256 of the code that plays and measures: old batches of other code are stale."""
    package = Path(__file__).parents[1]
    folders = (package / "evaluation", package / "policies")
    return sha256(b"".join(path.read_bytes() for folder in folders for path in sorted(folder.glob("*.py"))))


def circumstances() -> dict[str, str]:
    """Return the code, packages and processor of this process."""
    return {"source code": source_hash()[:16], "evaluation code": measurement_hash()[:16], **versions()}
