"""Means over scenarios and training seeds, with their bootstrap intervals.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law. The score,
see :mod:`wtg_gym.evaluation.score`, holds a ratio of two means over the same scenarios: the bootstrap resamples both.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

#: Resamples of the bootstrap, and the seed of its generator: the same results give the same intervals.
N_RESAMPLES = 2000
BOOTSTRAP_SEED = 20260101
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def mean(values: Floats) -> float:
    """Return the exactly rounded mean of all values."""
    return math.fsum(values.ravel().tolist()) / values.size


@functools.lru_cache(maxsize=1)
def _drawn_scenarios(n: int) -> Indices:
    """Return the scenarios of every resample, (N_RESAMPLES, n)."""
    drawn = np.random.default_rng(BOOTSTRAP_SEED).integers(0, n, size=(N_RESAMPLES, n))
    drawn.setflags(write=False)
    return drawn


def _drawn_runs(n_runs: int, side: int) -> Indices:
    """Return the training seeds of every resample, (N_RESAMPLES, n_runs); each side has draws of its own."""
    return np.random.default_rng([BOOTSTRAP_SEED, side]).integers(0, n_runs, size=(N_RESAMPLES, n_runs))


def _resampled_means(values: Floats, side: int = 0) -> Floats:
    """Return the mean of (n_runs, n_scenarios) in every resample of the bootstrap, (N_RESAMPLES,).

    Scenarios and training seeds are both drawn with replacement, and every drawn seed plays the same drawn scenarios
    (A. B. Owen, "The pigeonhole bootstrap", 2007): the cost of a hard scenario to all seeds does not average out over
    them. The drawn scenarios are the same in every call, so that means can be subtracted as a paired difference, and
    divided by one another.
    """
    means = values[:, _drawn_scenarios(values.shape[1])].mean(axis=2)
    resampled: Floats = np.take_along_axis(means.T, _drawn_runs(values.shape[0], side), axis=1).mean(axis=1)
    return resampled


def percentile_interval(value: float, samples: Floats) -> Interval:
    """Return a value with the percentile interval of its bootstrap samples (n,)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(samples, [tail, 100.0 - tail])
    return Interval(value, float(low), float(high))


def resampled_scores(gains: Floats, zero: Floats, side: int = 0) -> Floats:
    """Return the mean score in every resample of the bootstrap.

    Λ is a mean over the same scenarios as the gains, so it is computed anew from the scenarios of each resample: with a
    fixed Λ the intervals have the wrong width. A resample whose Λ is not positive has no score and is left out; these
    are the same for every entry.

    Args:
        gains: :func:`log_gains` of the entry (n_runs, n_scenarios).
        zero: log gains of the zero (n_scenarios,).
        side: 0 or 1. The training seeds of two different entries are drawn independently if their sides differ.
    """
    scale = -_resampled_means(zero[np.newaxis])
    scored = scale > 0.0
    scores: Floats = 100.0 * (1.0 + _resampled_means(gains, side)[scored] / scale[scored])
    return scores


def score_interval(gains: Floats, zero: Floats) -> Interval:
    """Return the mean score with its bootstrap interval, see :func:`resampled_scores`."""
    return percentile_interval(100.0 * (1.0 + mean(gains) / -mean(zero)), resampled_scores(gains, zero))


def score_difference(gains: Floats, other: Floats, zero: Floats) -> Interval:
    """Return the mean score of one entry minus that of another, with the interval of the paired difference.

    Args:
        gains, other: log gains of the two entries, (n_runs, n_scenarios) each.
        zero: log gains of the zero (n_scenarios,).
    """
    value = 100.0 * (mean(gains) - mean(other)) / -mean(zero)
    return percentile_interval(value, resampled_scores(gains, zero) - resampled_scores(other, zero, side=1))
