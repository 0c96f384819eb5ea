"""The share of the machine's arithmetic that the simulator reaches: counted operations against measured ceilings."""

from __future__ import annotations

import functools
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from wtg_gym.analysis.benchmarks.counting import Counts, count_operations
from wtg_gym.analysis.benchmarks.plant_sizes import LanesCase
from wtg_gym.analysis.benchmarks.timing import Case, Rate, Stepper
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings

#: Lanes of the batch whose arithmetic is measured.
BATCH = 1024
#: Repetitions of the multiply-add on a number while it is in a register, and numbers of each of the eight arrays.
_DEPTH, _LENGTH = 16, 256
#: Bytes of the three arrays together that bandwidth is measured with: in the first two caches, and in none.
_FOOTPRINTS = {"first cache": 24 * 1024, "second cache": 384 * 1024, "memory": 192 * 1024 * 1024}


@dataclass(frozen=True)
class Ceiling:
    """A limit of the machine: its name, threads used, and operations or bytes per second [G/s]."""

    name: str
    threads: int
    giga_per_s: float


@dataclass(frozen=True)
class Achieved:
    """The rate of one way of stepping."""

    name: str  # of the case
    threads: int  # threads used
    steps_per_s: float  # environment steps per second
    gflop_per_s: float  # counted operations per second [Gflop/s]
    #: share, fused_share: of the ceiling of vectors without and with fused multiply-adds on as many threads.
    share: float
    fused_share: float


@dataclass(frozen=True)
class Roofline:
    """Counts, ceilings and rates."""

    counts: dict[str, Counts]  # of the right-hand side, a control interval and an environment step
    peaks: tuple[Ceiling, ...]  # arithmetic [Gflop/s]
    bandwidths: tuple[Ceiling, ...]  # reading and writing on one thread [GB/s]
    achieved: tuple[Achieved, ...]  # a row per way of stepping
    row_bytes: int  # size of a lane's rows [B], which are read and written once a step

    @property
    def cache_intensity(self) -> float:
        """Operations per byte moved between registers and first cache, as the source is written [flop/B]."""
        step = self.counts["environment step"]
        return step.flops / step.bytes

    @property
    def memory_intensity(self) -> float:
        """Operations per byte where a step reads and writes every row of a lane once [flop/B]."""
        return self.counts["environment step"].flops / (2 * self.row_bytes)


def _scalar_chains(n: int, b: float, c: float) -> float:
    # Each number depends on its predecessor, so that no vector can be formed; twelve chains hide the latency.
    p, q, r, s = 0.1, 0.2, 0.3, 0.4
    t, u, v, w = 0.5, 0.6, 0.7, 0.8
    x, y, z, k = 0.9, 1.0, 1.1, 1.2
    for _ in range(n):
        p, q, r, s = p * b + c, q * b + c, r * b + c, s * b + c
        t, u, v, w = t * b + c, u * b + c, v * b + c, w * b + c
        x, y, z, k = x * b + c, y * b + c, z * b + c, k * b + c
    return p + q + r + s + t + u + v + w + x + y + z + k


def _vector_chains(n: int, a: Any, b: float, c: float) -> None:
    # Eight independent chains hide the latency; each number is loaded and stored once per _DEPTH multiply-adds.
    for _ in range(n):
        for x in range(_LENGTH):
            p, q, r, s = a[0, x], a[1, x], a[2, x], a[3, x]
            t, u, v, w = a[4, x], a[5, x], a[6, x], a[7, x]
            for _ in range(_DEPTH):
                p, q, r, s = p * b + c, q * b + c, r * b + c, s * b + c
                t, u, v, w = t * b + c, u * b + c, v * b + c, w * b + c
            a[0, x], a[1, x], a[2, x], a[3, x] = p, q, r, s
            a[4, x], a[5, x], a[6, x], a[7, x] = t, u, v, w


def _triad(n: int, a: Any, b: Any, c: Any, s: float) -> None:
    for _ in range(n):
        for x in range(a.size):
            a[x] = b[x] + s * c[x]


def _on_threads(n_threads: int, make: Callable[[], Callable[[int], float]]) -> Stepper:
    """Return a stepper that runs `work(n)` on several threads; `make` makes the work of a thread."""
    works = [make() for _ in range(n_threads)]
    repetitions = 1
    for work in works:
        work(1)

    def stepper(seconds: float) -> float:
        done = [0.0] * n_threads
        begin = time.perf_counter()

        def run(index: int) -> None:
            nonlocal repetitions
            now = begin
            # Once at least: a thread may be given its first turn when the time is over.
            while now - begin < seconds or not done[index]:
                start = time.perf_counter()
                done[index] += works[index](repetitions)
                now = time.perf_counter()
                # A call into compiled code must not count.
                if now - start < 1e-3:
                    repetitions *= 2

        threads = [threading.Thread(target=run, args=(index,)) for index in range(n_threads)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return sum(done) / (time.perf_counter() - begin)

    return stepper


#: Makes the work of one thread: it takes a number of repetitions and returns the operations or bytes done.
_Maker = Callable[[], Callable[[int], float]]


def _make_scalar() -> Callable[[int], float]:
    kernel = numba.njit(nogil=True)(_scalar_chains)

    def work(n: int) -> float:
        kernel(1000 * n, 0.999, 1e-3)
        return 24.0 * 1000 * n

    return work


def _make_vector(fused: bool) -> Callable[[int], float]:
    # `contract` alone lets the compiler fuse a multiply with an add; nothing is reordered.
    kernel = numba.njit(nogil=True, fastmath={"contract"} if fused else False)(_vector_chains)
    array = np.full((8, _LENGTH), 0.5)

    def work(n: int) -> float:
        kernel(n, array, 0.999, 1e-3)
        return 16.0 * _LENGTH * _DEPTH * n

    return work


def _make_triad(footprint: int) -> Callable[[int], float]:
    kernel = numba.njit(nogil=True)(_triad)
    arrays = [np.full(footprint // 24, value) for value in (0.0, 1.0, 2.0)]

    def work(n: int) -> float:
        kernel(n, *arrays, 0.5)
        return 3.0 * 8 * arrays[0].size * n

    return work


_PEAKS: dict[str, _Maker] = {
    "scalar": _make_scalar,
    "vectors": functools.partial(_make_vector, False),
    "vectors, fused multiply-add": functools.partial(_make_vector, True),
}


def _threads() -> list[int]:
    return sorted({1, os.cpu_count() or 1})


def roofline_cases() -> tuple[list[Case], list[LanesCase]]:
    """Return the cases of the ceilings, and the environment's own cases."""
    works: dict[str, tuple[int, _Maker]] = {
        f"peak: {name}, {n} threads": (n, make) for name, make in _PEAKS.items() for n in _threads()
    }
    works |= {f"bandwidth: {name}": (1, functools.partial(_make_triad, size)) for name, size in _FOOTPRINTS.items()}
    ceilings = [
        Case("roofline", name, 1, functools.partial(_on_threads, n, make), 1.0) for name, (n, make) in works.items()
    ]
    own = [LanesCase("roofline", "single environment", 1)]
    own += [LanesCase("roofline", f"batch of {BATCH}, {n} threads", BATCH, n_threads=n) for n in _threads()]
    return ceilings, own


def roofline(rates: dict[str, Rate]) -> Roofline:
    """Return the summary of measured cases, after counting; `rates` by the cases' names."""
    counts = count_operations()
    flops = counts["environment step"].flops
    peaks = tuple(
        Ceiling(name, n, 1e-9 * rates[f"peak: {name}, {n} threads"].per_s) for name in _PEAKS for n in _threads()
    )
    bandwidths = tuple(Ceiling(name, 1, 1e-9 * rates[f"bandwidth: {name}"].per_s) for name in _FOOTPRINTS)
    limit = {(peak.name, peak.threads): peak.giga_per_s for peak in peaks}
    achieved = []
    for own in roofline_cases()[1]:
        threads = own.n_threads or 1
        rate = rates[own.name].per_s
        reached = 1e-9 * flops * rate
        shares = reached / limit["vectors", threads], reached / limit["vectors, fused multiply-add", threads]
        achieved.append(Achieved(own.name, threads, rate, reached, *shares))
    row_bytes = 8 * TaskLanes(EnvSettings(version="v0", duration_s=1.0)).simulator.layout.n_rows
    return Roofline(counts, peaks, bandwidths, tuple(achieved), row_bytes)
