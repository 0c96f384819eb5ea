"""Means over scenarios and training seeds, and the bootstrap intervals of version v0.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law. The score
of v0, see :mod:`wtg_gym.evaluation.score`, holds a ratio of two means over the same scenarios: the bootstrap resamples
both.
"""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import fmean

import numpy as np
import numpy.typing as npt
from scipy import special

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
#: The scenarios of each stratum by its name, as indices, each (n,); all of them by the name "" without strata.
Groups = Mapping[str, Indices]

#: Resamples of the bootstrap, and the seed of its generator: the same results give the same intervals.
N_RESAMPLES = 2000
BOOTSTRAP_SEED = 20260101
CONFIDENCE = 0.95
#: Share of the scenarios that count as the worst.
_WORST = 0.1


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float


def mean(values: Floats) -> float:
    """Return the exactly rounded mean of all values."""
    return fmean(values.ravel().tolist())


@functools.lru_cache(maxsize=4)
def _drawn_scenarios(n: int) -> Indices:
    """Return the scenarios of every resample, (N_RESAMPLES, n)."""
    return np.random.default_rng(BOOTSTRAP_SEED).integers(0, n, size=(N_RESAMPLES, n))


def _resampled(values: Floats, side: int = 0, chosen: Callable[[Floats], Floats] | None = None) -> Floats:
    """Return the mean over (n_runs, n_scenarios) in every resample of the bootstrap, (N_RESAMPLES,).

    Every drawn seed plays the same drawn scenarios (A. B. Owen, "The pigeonhole bootstrap", 2007): the cost of a hard
    scenario to all seeds does not average out. Scenarios are drawn alike in every call, so that means are paired; side
    0 or 1 says which draws of training seeds are taken, `chosen` which of the values (n_runs, N_RESAMPLES, n) count.
    """
    # All runs at once: the order of the numbers in memory decides the last bits of their mean.
    drawn = values[:, _drawn_scenarios(values.shape[1])]
    means = (drawn if chosen is None else chosen(drawn)).mean(axis=2)
    n_runs = len(values)
    runs = np.random.default_rng([BOOTSTRAP_SEED, side]).integers(0, n_runs, size=(N_RESAMPLES, n_runs))
    resampled: Floats = np.take_along_axis(means.T, runs, axis=1).mean(axis=1)
    return resampled


def _percentile_interval(value: float, samples: Floats) -> Interval:
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(samples, [tail, 100.0 - tail])
    return Interval(value, float(low), float(high))


def share(happened: Floats, groups: Groups) -> float:
    """Return how often something happened [%], all strata alike: 1 where it did, 0 where not, (n_runs, n_scenarios)."""
    return 100.0 * fmean(mean(happened[:, group]) for group in groups.values())


def sign_test(happened: Floats, other: Floats) -> float:
    """Return the chance that something happens this much more often than to another entry, were both equally prone.

    That is the one-sided exact test of Q. McNemar (Psychometrika 12, 1947, 153-157): only scenarios in which the two
    differ count, each as likely for one as for the other, with the sum of the differences of all training seeds. Both
    are 1 where it happened and 0 where not, (n_runs, n_scenarios) and (1, n_scenarios).
    """
    differences = np.rint(happened.sum(axis=0) - len(happened) * other[0]).astype(np.int64)
    # Chances of every sum of the differences with random signs; index i is the sum i - (len - 1) / 2.
    chances = np.ones(1)
    for size, n in zip(*np.unique(np.abs(differences[differences != 0]), return_counts=True), strict=True):
        signs = np.zeros(2 * size * n + 1)
        signs[:: 2 * size] = np.diff(special.bdtr(np.arange(n + 1), n, 0.5), prepend=0.0)
        chances = np.convolve(chances, signs)
    return min(1.0, float(chances[(chances.size - 1) // 2 + differences.sum() :].sum()))


def worst_tenth(costs: Floats) -> Floats:
    """Return the largest tenth along the last axis, in no order."""
    n = math.ceil(_WORST * costs.shape[-1])
    return np.partition(costs, -n, axis=-1)[..., -n:]


class Bootstrap:
    """Scores, and differences between entries, of v0: Λ from the scenarios played, percentile bootstrap intervals.

    It takes the gains of the zero (n_scenarios,). There are no strata. In each resample Λ is computed anew: with a
    fixed one the intervals have the wrong width. A resample in which it is not positive is left out, of every entry.
    """

    def __init__(self, zero: Floats) -> None:
        self._scale, self._scales = -mean(zero), -_resampled(zero[np.newaxis])

    def points(self, gains: Floats) -> float:
        """Return the points above 100 that gains make."""
        return 100.0 * mean(gains) / self._scale

    def score(self, gains: Floats) -> Interval:
        """Return the score with its interval."""
        scored = self._scales > 0.0
        samples = 100.0 * (1.0 + _resampled(gains)[scored] / self._scales[scored])
        return _percentile_interval(100.0 * (1.0 + mean(gains) / self._scale), samples)

    def strata(self, gains: Floats) -> dict[str, Interval]:
        """Return nothing."""
        return {}

    def share_difference(self, happened: Floats, other: Floats) -> Interval:
        """Return how much more often something happened than under another entry [percentage points], paired."""
        value = 100.0 * mean(happened) - 100.0 * mean(other)
        return _percentile_interval(value, 100.0 * (_resampled(happened, 0) - _resampled(other, 1)))

    def worst_tenth_difference(self, costs: Floats, other: Floats) -> Interval:
        """Return how much more the :func:`worst_tenth` costs than that of another entry [%], paired."""
        tail, base = (_resampled(values, side, worst_tenth) for side, values in enumerate((costs, other)))
        value = 100.0 * (mean(worst_tenth(costs)) / mean(worst_tenth(other)) - 1.0)
        return _percentile_interval(value, 100.0 * (tail / base - 1.0))
