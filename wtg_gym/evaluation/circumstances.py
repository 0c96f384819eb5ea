"""Everything beside the entries that decides the last bits of a result: code, packages, Python and the processor."""

import contextlib
import dataclasses
import functools
import hashlib
import importlib.metadata
import platform
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from llvmlite.binding import get_host_cpu_name

from wtg_gym import __version__
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import sha256
from wtg_gym.physics.tracking_law import REFERENCE_LAW
from wtg_gym.systems.compiled import source_hash

_PACKAGES = ("numpy", "scipy", "numba", "onnxruntime")
_N_SCENARIOS, _N_STEPS = 4, 150


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


def environment_fingerprint(settings: EnvSettings) -> str:
    """Return a sha256 over what the environment answers: with the same, machines compute the same bits.

    The first validation scenarios are played for 15 s under the reference law with all actions and observations.
    """
    probed = dataclasses.replace(settings, strategy=REFERENCE_LAW, action_mode="k+tau", observation_mode="privileged")
    seeds = settings.resolved_suite.seeds("validation")[:_N_SCENARIOS]
    with contextlib.closing(EnvBatch(probed, len(seeds), 1)) as batch:
        batch.start(range(len(seeds)), batch.scenarios(seeds))
        digest = hashlib.sha256("\n".join(batch.observation_names).encode())
        digest.update(batch.observations.tobytes())
        for step in range(_N_STEPS):
            if np.logical_or(*batch.ended()).all():
                break
            # Actions in [-1, 1], of whole numbers: no generator and no rounding.
            count = (step * len(seeds) + np.arange(len(seeds))[:, np.newaxis]) * batch.n_action
            batch.step(((count + np.arange(batch.n_action)) * 7919 % 2049 - 1024) / 1024.0)
            for values in batch.outputs:
                digest.update(values.tobytes())
        return digest.hexdigest()
