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

#: Works for at least so many seconds and returns its rate per second: of environment steps, or of operations.
Stepper = Callable[[float], float]
#: Called with the name of the present case, and the expected seconds of the finished part and of all.
OnProgress = Callable[[str, float, float], None]

#: How long a case is stepped before it counts [s].
WARM_UP_S = 0.01
_N_ACTIONS = 256


@dataclass(frozen=True)
class Case:
    """Something to step."""

    part: str  # part of the benchmark that it belongs to
    name: str  # of the case
    n_envs: int  # number of environments that it steps at once
    make: Callable[[], Stepper]  # prepares it and returns its stepper
    preparation_s: float = 0.5  # how long that may take, for the forecast of the remaining time [s]
    least_s: float = 0.0  # shortest run that it can be measured by [s]


@dataclass(frozen=True)
class Rate:
    """A case with its rate in every repeat [1/s]."""

    case: Case
    all: tuple[float, ...]

    @property
    def per_s(self) -> float:
        """Median over the repeats."""
        return statistics.median(self.all)


def prepare(cases: Sequence[Case], on_progress: OnProgress) -> list[Stepper]:
    """Return the cases' steppers, compiled and warm."""
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
    total, done = repeats * sum(max(seconds, case.least_s) for case in cases), 0.0
    rates: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats):
        for case, stepper, found in zip(cases, steppers, rates, strict=True):
            on_progress(case.name, done, total)
            found.append(stepper(seconds))
            done += max(seconds, case.least_s)
    return [Rate(case, tuple(found)) for case, found in zip(cases, rates, strict=True)]


def repeat(step: Callable[[int], object], n_per_step: int = 1) -> Stepper:
    """Return a stepper that calls `step` with 0, 1, 2 …, once at least; each call counts `n_per_step`."""

    def stepper(seconds: float) -> float:
        n, begin = 0, time.perf_counter()
        while (passed := time.perf_counter() - begin) < seconds or n == 0:
            step(n)
            n += 1
        return n * n_per_step / passed

    return stepper


def step_single(env: Any) -> Stepper:
    """Return the stepper of a single environment: random actions drawn beforehand, resets included."""
    actions = [env.action_space.sample() for _ in range(_N_ACTIONS)]
    env.reset(seed=0)

    def step(n: int) -> None:
        _, _, terminated, truncated, _ = env.step(actions[n % _N_ACTIONS])
        if terminated or truncated:
            env.reset()

    return repeat(step)


def step_batch(envs: Any, action_space: Any, n_envs: int) -> Stepper:
    """Return the stepper of a started batch that resets its environments itself, with eight sets of random actions."""
    actions = [np.stack([action_space.sample() for _ in range(n_envs)]) for _ in range(8)]
    return repeat(lambda n: envs.step(actions[n % 8]), n_envs)


def machine() -> str:
    """Return processor, number of processors and Python version as text."""
    model = platform.processor() or platform.machine()
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return f"{model}, {os.cpu_count()} processors, Python {platform.python_version()}"


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of those packages that are installed."""
    found = {}
    for name in packages:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
