"""Means over scenarios and training seeds, with their bootstrap intervals.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law. The score,
see :mod:`wtg_gym.evaluation.score`, holds a ratio of two means over the same scenarios: the bootstrap resamples both.
Where the scenarios are of strata, they are resampled within each.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
    """A value and its 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def mean(values: Floats) -> float:
    """Return the exactly rounded mean of all values."""
    return math.fsum(values.ravel().tolist()) / values.size


def mean_over_groups(values: Iterable[float]) -> float:
    """Return the mean of a value of each group: strata count alike."""
    own = list(values)
    return math.fsum(own) / len(own)


@functools.lru_cache(maxsize=4)
def _drawn(sizes: tuple[int, ...]) -> list[Indices]:
    """Return the draws of every resample, (N_RESAMPLES, size), from groups of scenarios."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return [rng.integers(0, size, size=(N_RESAMPLES, size)) for size in sizes]


def _drawn_scenarios(groups: Groups) -> list[Indices]:
    """Return the scenarios of every resample, (N_RESAMPLES, n), of each group."""
    drawn = _drawn(tuple(group.size for group in groups.values()))
    return [group[own] for group, own in zip(groups.values(), drawn, strict=True)]


def _drawn_runs(n_runs: int, side: int) -> Indices:
    """Return the training seeds of every resample, (N_RESAMPLES, n_runs); each side has draws of its own."""
    return np.random.default_rng([BOOTSTRAP_SEED, side]).integers(0, n_runs, size=(N_RESAMPLES, n_runs))


def _resampled(
    values: Floats, scenarios: Indices, side: int, chosen: Callable[[Floats], Floats] | None = None
) -> Floats:
    """Return the mean over (n_runs, n_scenarios) in every resample of the bootstrap, (N_RESAMPLES,).

    Scenarios and training seeds are both drawn with replacement, and every drawn seed plays the same drawn scenarios
    (A. B. Owen, "The pigeonhole bootstrap", 2007): the cost of a hard scenario to all seeds does not average out over
    them. The drawn scenarios are the same in every call, so that means can be subtracted as a paired difference, and
    divided by one another.

    Args:
        values: (n_runs, n_scenarios).
        scenarios: those of every resample (N_RESAMPLES, n).
        side: 0 or 1, which draws of the training seeds are taken.
        chosen: which of the values drawn count, (n_runs, N_RESAMPLES, n); None for all.
    """
    # All runs at once: the order of the numbers in memory decides the last bits of their mean.
    drawn = values[:, scenarios]
    means = (drawn if chosen is None else chosen(drawn)).mean(axis=2)
    resampled: Floats = np.take_along_axis(means.T, _drawn_runs(values.shape[0], side), axis=1).mean(axis=1)
    return resampled


def percentile_interval(value: float, samples: Floats) -> Interval:
    """Return a value with the percentile interval of its bootstrap samples (n,)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(samples, [tail, 100.0 - tail])
    return Interval(value, float(low), float(high))


def resampled_scores(gains: Floats, zero: Floats, groups: Groups, side: int = 0) -> Floats:
    """Return the score in every resample of the bootstrap.

    Λ is a mean over the same scenarios as the gains, so it is computed anew from the scenarios of each resample: with a
    fixed Λ the intervals have the wrong width. A resample in which a group's Λ is not positive has no score and is left
    out; these are the same for every entry.

    Args:
        gains: :func:`wtg_gym.evaluation.score.gains` of the entry (n_runs, n_scenarios).
        zero: gains of the zero (n_scenarios,).
        groups: of the scenarios.
        side: 0 or 1. The training seeds of two different entries are drawn independently if their sides differ.
    """
    drawn = _drawn_scenarios(groups)
    scales = np.array([-_resampled(zero[np.newaxis], own, 0) for own in drawn])
    means = np.array([_resampled(gains, own, side) for own in drawn])
    scored = (scales > 0.0).all(axis=0)
    scores: Floats = (100.0 * (1.0 + means[:, scored] / scales[:, scored])).mean(axis=0)
    return scores


def score_interval(gains: Floats, zero: Floats, groups: Groups) -> Interval:
    """Return the score with its bootstrap interval, see :func:`resampled_scores`."""
    value = mean_over_groups(100.0 * (1.0 + mean(gains[:, own]) / -mean(zero[own])) for own in groups.values())
    return percentile_interval(value, resampled_scores(gains, zero, groups))


def score_difference(gains: Floats, other: Floats, zero: Floats, groups: Groups) -> Interval:
    """Return the score of one entry minus that of another, with the interval of the paired difference.

    Args:
        gains, other: gains of the two entries, (n_runs, n_scenarios) each.
        zero: gains of the zero (n_scenarios,).
        groups: of the scenarios.
    """
    value = mean_over_groups(
        100.0 * (mean(gains[:, own]) - mean(other[:, own])) / -mean(zero[own]) for own in groups.values()
    )
    scores = resampled_scores(gains, zero, groups), resampled_scores(other, zero, groups, side=1)
    return percentile_interval(value, scores[0] - scores[1])


def share(happened: Floats, groups: Groups) -> float:
    """Return how often something happened [%], from 1 where it did and 0 where not, (n_runs, n_scenarios)."""
    return 100.0 * mean_over_groups(mean(happened[:, own]) for own in groups.values())


def share_difference(happened: Floats, other: Floats, groups: Groups) -> Interval:
    """Return the :func:`share` minus that of another entry [percentage points], paired.

    Args:
        happened, other: 1 where it happened and 0 where not, (n_runs, n_scenarios) each.
        groups: of the scenarios.
    """
    drawn = _drawn_scenarios(groups)
    differences = [_resampled(happened, own, 0) - _resampled(other, own, 1) for own in drawn]
    value = share(happened, groups) - share(other, groups)
    return percentile_interval(value, 100.0 * np.mean(differences, axis=0))


def worst_tenth(costs: Floats) -> Floats:
    """Return the largest tenth along the last axis, in no order."""
    n = math.ceil(_WORST * costs.shape[-1])
    return np.partition(costs, -n, axis=-1)[..., -n:]


def worst_tenth_difference(costs: Floats, other: Floats, groups: Groups) -> Interval:
    """Return how much more the :func:`worst_tenth` costs than that of another entry [%], paired.

    Args:
        costs, other: (n_runs, n_scenarios) each.
        groups: of the scenarios.
    """
    scenarios = np.concatenate(_drawn_scenarios(groups), axis=1)
    own, base = (_resampled(each, scenarios, side, worst_tenth) for side, each in enumerate((costs, other)))
    value = 100.0 * (mean(worst_tenth(costs)) / mean(worst_tenth(other)) - 1.0)
    return percentile_interval(value, 100.0 * (own / base - 1.0))
