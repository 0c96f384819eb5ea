"""Rates of things that step: measured in turns, so that a busy spell of the machine strikes all alike."""

from __future__ import annotations

import contextlib
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

#: Works for at least so many seconds and returns what it has done per second: environment steps, or operations.
Stepper = Callable[[float], float]
#: Called with what is under way, and the expected seconds of what is done and of all.
OnProgress = Callable[[str, float, float], None]

#: How long a case is stepped before it counts [s].
WARM_UP_S = 0.01
_N_ACTIONS = 256


@dataclass(frozen=True)
class Case:
    """Something to step.

    Args:
        part: part of the benchmark that it belongs to.
        name: what it is called.
        n_envs: number of environments that it steps at once.
        make: prepares it and returns what measures it.
        preparation_s: how long that may take, for the forecast of the remaining time [s].
        least_s: shortest run that it can be measured by [s].
    """

    part: str
    name: str
    n_envs: int
    make: Callable[[], Stepper]
    preparation_s: float = 0.5
    least_s: float = 0.0


@dataclass(frozen=True)
class Rate:
    """A case with what was measured: what it counts, mostly environment steps, per second of every repeat."""

    case: Case
    all: tuple[float, ...]

    @property
    def per_s(self) -> float:
        """Median over the repeats."""
        return statistics.median(self.all)


def prepare(cases: Sequence[Case], on_progress: OnProgress) -> list[Stepper]:
    """Return what measures each case, compiled and warm."""
    total, done = sum(case.preparation_s for case in cases), 0.0
    steppers = []
    for case in cases:
        on_progress(f"preparing {case.name}", done, total)
        stepper = case.make()
        stepper(WARM_UP_S)
        steppers.append(stepper)
        done += case.preparation_s
    return steppers


def measure(
    cases: Sequence[Case], steppers: Sequence[Stepper], seconds: float, repeats: int, on_progress: OnProgress
) -> list[Rate]:
    """Return the rates of prepared cases, each measured for `seconds` in every one of `repeats` rounds."""
    runs = [max(seconds, case.least_s) for case in cases]
    total, done = repeats * sum(runs), 0.0
    rates: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats):
        for case, stepper, found, run in zip(cases, steppers, rates, runs, strict=True):
            on_progress(case.name, done, total)
            found.append(stepper(seconds))
            done += run
    return [Rate(case, tuple(found)) for case, found in zip(cases, rates, strict=True)]


def step_single(env: Any) -> Stepper:
    """Return what steps a single environment with random actions drawn beforehand, resets included."""
    actions = [env.action_space.sample() for _ in range(_N_ACTIONS)]
    env.reset(seed=0)

    def stepper(seconds: float) -> float:
        n, begin = 0, time.perf_counter()
        while (passed := time.perf_counter() - begin) < seconds or n == 0:
            _, _, terminated, truncated, _ = env.step(actions[n % _N_ACTIONS])
            if terminated or truncated:
                env.reset()
            n += 1
        return n / passed

    return stepper


def step_batch(envs: Any, action_space: Any, n_envs: int) -> Stepper:
    """Return what steps a started batch with random actions, eight sets in turn; it resets its environments itself.

    Args:
        envs: the batch.
        action_space: of one environment.
        n_envs: how many it steps at once.
    """
    actions = [np.stack([action_space.sample() for _ in range(n_envs)]) for _ in range(8)]

    def stepper(seconds: float) -> float:
        n, begin = 0, time.perf_counter()
        while (passed := time.perf_counter() - begin) < seconds or n == 0:
            envs.step(actions[n % 8])
            n += 1
        return n * n_envs / passed

    return stepper


def machine() -> str:
    """Return processor, number of processors and Python version as text."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{model}, {os.cpu_count()} processors, Python {platform.python_version()}"


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of packages, of those that are installed."""
    found = {}
    for name in packages:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
