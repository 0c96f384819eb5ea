"""What decides the last bits of a result beside this package's own code: other packages, Python and the processor."""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import platform

from llvmlite.binding import get_host_cpu_name

from wtg_gym import __version__

_PACKAGES = ("numpy", "scipy", "numba", "onnxruntime")


def versions() -> dict[str, str]:
    """Return the versions of wtg_gym, Python and the packages that compute, as far as they are installed, and the kind
    of processor.
    """
    return dict(_versions())


@functools.cache
def _versions() -> dict[str, str]:
    found = {"wtg_gym": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return {**found, "processor": f"{platform.machine()} {get_host_cpu_name()}"}


__all__ = ["versions"]
