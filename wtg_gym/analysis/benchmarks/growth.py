"""How the cost of an environment step grows with the plant, the number of lanes and the number of threads."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from wtg_gym.analysis.benchmarks.plant_sizes import LanesCase
from wtg_gym.analysis.benchmarks.timing import Rate

#: Numbers of WTG groups and of machines measured by default and in full; each new one compiles for half a minute.
GROUPS, ALL_GROUPS = (1, 2, 4, 8, 16), (1, 2, 4, 8, 16, 32, 64, 128)
MACHINES, ALL_MACHINES = (4, 8, 16), (4, 8, 16, 32, 64, 128)
LANES = (1, 4, 16, 64, 256, 1024, 4096, 16384)
#: Lanes of a batch where something else grows, and where threads do.
BATCH, THREADED_BATCH = 64, 4096


@dataclass(frozen=True)
class Point:
    """One size."""

    n: int  # the size: groups, machines, lanes or threads
    microseconds: float  # time per environment step [µs]
    compile_s: float  # how long numba compiled for it, 0 where everything was cached on disk [s]
    bytes_per_lane: float  # memory of one lane [B]


@dataclass(frozen=True)
class Curve:
    """Cost against one kind of size."""

    name: str
    points: tuple[Point, ...]

    @property
    def exponent(self) -> float:
        """Slope p of the cost ~ n^p over the upper half of the sizes; NaN for a single size."""
        upper = self.points[len(self.points) // 2 - (len(self.points) < 4) :] if len(self.points) > 1 else ()
        if len(upper) < 2:
            return math.nan
        n, cost = np.log([point.n for point in upper]), np.log([point.microseconds for point in upper])
        return float(np.polyfit(n, cost, 1)[0])

    @property
    def quadratic_share(self) -> float:
        """Share that the square has in the cost at the largest size, from a fit of a + b n + c n², all positive."""
        n = np.array([point.n for point in self.points], dtype=np.float64)
        cost = np.array([point.microseconds for point in self.points])
        terms = np.stack([np.ones_like(n), n, n * n], axis=1)
        # Relative errors count, or the largest size alone would decide.
        weights, _ = nnls(terms / cost[:, None], np.ones_like(n))
        parts = weights * terms[-1]
        return float(parts[2] / parts.sum())


def growth_cases(*, full: bool) -> dict[str, list[tuple[int, LanesCase]]]:
    """Return every curve's sizes with their cases; those up to 16 groups and machines compile in a few minutes."""
    groups, machines = (ALL_GROUPS, ALL_MACHINES) if full else (GROUPS, MACHINES)
    n_cpu = os.cpu_count() or 1
    threads = sorted({*(2**k for k in range(n_cpu.bit_length())), n_cpu})

    def case(name: str, **sizes: int) -> LanesCase:
        return LanesCase("growth", name, **{"n_lanes": BATCH, **sizes})

    return {
        "groups": [(n, case(f"{n} groups", groups=n)) for n in groups],
        "groups, single": [(n, case(f"{n} groups, single", groups=n, n_lanes=1)) for n in groups],
        "machines": [(n, case(f"{n} machines", machines=n)) for n in machines],
        "lanes": [(n, case(f"{n} lanes", n_lanes=n)) for n in LANES],
        "threads": [(n, case(f"{n} threads", n_lanes=THREADED_BATCH, n_threads=n)) for n in threads],
    }


def growth_curves(cases: dict[str, list[tuple[int, LanesCase]]], rates: dict[str, Rate]) -> list[Curve]:
    """Return the curves of measured cases; `rates` by the cases' names."""
    return [
        Curve(
            name,
            tuple(Point(n, 1e6 / rates[case.name].per_s, case.compile_s, case.bytes_per_lane) for n, case in sizes),
        )
        for name, sizes in cases.items()
    ]


def describe_growth(curves: Sequence[Curve]) -> list[str]:
    """Return a sentence per curve, computed from its numbers."""
    return [_describe(curve) for curve in curves if len(curve.points) > 1]


def _describe(curve: Curve) -> str:
    first, last = curve.points[0], curve.points[-1]
    ratio, size_ratio = last.microseconds / first.microseconds, last.n / first.n
    if curve.name == "lanes":
        least = min(curve.points, key=lambda point: point.microseconds)
        return (
            f"Lanes: a step costs {first.microseconds:.3g} µs alone and {last.microseconds:.3g} µs in a batch of "
            f"{last.n}, {1.0 / ratio:.1f} times less; the least is {least.microseconds:.3g} µs, at {least.n} lanes."
        )
    if curve.name == "threads":
        return (
            f"Threads: {last.n} are {1.0 / ratio:.2f} times as fast as one in a batch of {THREADED_BATCH} "
            f"({100.0 / ratio / size_ratio:.0f} % of the ideal)."
        )
    what, *single = curve.name.split(", ")
    where = "a single environment" if single else f"a batch of {BATCH}"
    text = (
        f"{what.capitalize()} in {where}: from {first.n} to {last.n} a step costs {ratio:.3g} times as much; in the "
        f"upper half the cost goes with n to the power of {curve.exponent:.2f}"
    )
    if len(curve.points) < 4:
        return f"{text}."
    share = 100.0 * curve.quadratic_share
    return f"{text}. In a fit of a + b n + c n² the square is {share:.0f} % of the cost at {last.n}."
