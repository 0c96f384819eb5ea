"""From costs to scores and their uncertainty.

Pinned cost of scenario i: J_i is the episode's total cost; that of a failed episode is cap · (duration + 1 s), as if it
had failed at once, which is the worst any episode can cost.

Score of scenario i: s_i = 100 · (1 + ln((J_ref,i + J0) / (J_i + J0)) / Λ), where Λ is the mean over the scenarios of
ln((J_mppt,i + J0) / (J_ref,i + J0)). On the same scenarios MPPT has the mean score 0 and the reference 100 in each. J0
bounds what a scenario that happens to be nearly free of cost can bring.

The mean score holds a ratio of two means over the same scenarios, 100 · (1 + mean gain / Λ).
The bootstrap resamples both.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

#: J0 of the score, in units of the cost.
COST_OFFSET = 5.0
#: Resamples of the bootstrap, and the seed of its generator: the same results give the same intervals.
N_RESAMPLES = 2000
BOOTSTRAP_SEED = 20260101
CONFIDENCE = 0.95


class NoScaleError(ValueError):
    """On these scenarios MPPT is not worse than the reference, so that there is nothing to score with."""


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def pinned_cost(cost: float, *, failed: bool, duration_s: float, cap: float) -> float:
    """Return the pinned cost of an episode.

    Args:
        cost: its total cost.
        failed: whether it ended in a failure.
        duration_s: how long it should have lasted [s].
        cap: largest cost rate [1/s].
    """
    return cap * (duration_s + 1.0) if failed else cost


def log_gains(costs: Floats, reference: Floats) -> Floats:
    """Return ln((J_ref + J0) / (J + J0)), shape (n_runs, n_scenarios).

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        reference: pinned costs of the reference (n_scenarios,).

    Raises:
        ValueError: a cost is negative or not finite.
    """
    for values in (costs, reference):
        if not np.isfinite(values).all() or (values < 0.0).any():
            raise ValueError(f"costs must be finite and not negative, got {values.min():g} … {values.max():g}")
    # math.log, because numpy's own logarithm differs between processors in the last bit.
    base = [math.log(cost + COST_OFFSET) for cost in reference.tolist()]
    return np.array([[b - math.log(c + COST_OFFSET) for b, c in zip(base, run, strict=True)] for run in costs.tolist()])


def mean(values: Floats) -> float:
    """Return the exactly rounded mean of all values."""
    return math.fsum(values.ravel().tolist()) / values.size


def score_scale(mppt: Floats, reference: Floats) -> float:
    """Return Λ from the pinned costs of the two anchors, each of shape (n_scenarios,).

    Raises:
        NoScaleError: Λ is not positive, so that there is no scale to score on.
    """
    scale = -mean(log_gains(mppt[np.newaxis], reference))
    if not scale > 0.0:
        raise NoScaleError(
            f"on these {reference.size} scenarios MPPT (mean cost {mean(mppt):.4g}) is not worse than the reference "
            f"(mean cost {mean(reference):.4g}): Λ = {scale:.3g} must be positive to score with; "
            "take more scenarios or longer ones"
        )
    return scale


def scenario_scores(gains: Floats, scale: float) -> Floats:
    """Return s_i of every run and scenario from the :func:`log_gains` and Λ."""
    scores: Floats = 100.0 * (1.0 + gains / scale)
    return scores


def mean_score(gains: Floats, scale: float) -> float:
    """Return the mean of s_i; exactly 0 for MPPT and 100 for the reference."""
    return 100.0 * (1.0 + mean(gains) / scale)


def interquartile_mean(values: Floats) -> Floats:
    """Return the mean along the last axis without the lowest and the highest quarter (numbers rounded down).

    Source: R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021.
    """
    n = values.shape[-1]
    cut = n // 4
    means: Floats = np.sort(values, axis=-1)[..., cut : n - cut].mean(axis=-1)
    return means


def improvement(costs: Floats, reference: Floats) -> Floats:
    """Return 1 where a cost is below the reference's on the same scenario, ½ where equal, else 0; the mean is P."""
    better: Floats = (costs < reference) + 0.5 * (costs == reference)
    return better


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

    Scenarios and training seeds are both drawn with replacement, and every drawn seed plays the same drawn scenarios,
    as all seeds do in truth (A. B. Owen, "The pigeonhole bootstrap", 2007): what a hard scenario costs all seeds alike
    does not average out over them. The drawn scenarios are the same in every call, so that means can be subtracted as
    a paired difference, and divided by one another.
    """
    means = values[:, _drawn_scenarios(values.shape[1])].mean(axis=2)
    resampled: Floats = np.take_along_axis(means.T, _drawn_runs(values.shape[0], side), axis=1).mean(axis=1)
    return resampled


def percentile_interval(value: float, samples: Floats) -> Interval:
    """Return a value with the percentile interval of its bootstrap samples (n,)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(samples, [tail, 100.0 - tail])
    return Interval(value, float(low), float(high))


def mean_interval(values: Floats) -> Interval:
    """Return the mean of (n_runs, n_scenarios) with its bootstrap interval."""
    return percentile_interval(mean(values), _resampled_means(values))


def resampled_scores(gains: Floats, mppt: Floats, side: int = 0) -> Floats:
    """Return the mean score in every resample of the bootstrap.

    Λ is a mean over the same scenarios as the gains, so it is computed anew from the scenarios of each resample: with a
    fixed Λ the intervals have the wrong width. A resample whose Λ is not positive has no score and is left out; these
    are the same for every entry.

    Args:
        gains: :func:`log_gains` of the entry (n_runs, n_scenarios).
        mppt: log gains of MPPT (n_scenarios,).
        side: 0 or 1. The training seeds of two different entries are drawn independently if their sides differ.
    """
    scale = -_resampled_means(mppt[np.newaxis])
    scored = scale > 0.0
    scores: Floats = 100.0 * (1.0 + _resampled_means(gains, side)[scored] / scale[scored])
    return scores


def score_interval(gains: Floats, mppt: Floats) -> Interval:
    """Return the mean score with its bootstrap interval, see :func:`resampled_scores`."""
    return percentile_interval(mean_score(gains, -mean(mppt)), resampled_scores(gains, mppt))


def score_difference(gains: Floats, other: Floats, mppt: Floats) -> Interval:
    """Return the mean score of one entry minus that of another, with the interval of the paired difference.

    Args:
        gains, other: log gains of the two entries, (n_runs, n_scenarios) each.
        mppt: log gains of MPPT (n_scenarios,).
    """
    value = 100.0 * (mean(gains) - mean(other)) / -mean(mppt)
    return percentile_interval(value, resampled_scores(gains, mppt) - resampled_scores(other, mppt, side=1))


def interquartile_interval(gains: Floats, mppt: Floats) -> Interval:
    """Return the interquartile mean of the scenarios' scores with its bootstrap interval, Λ resampled too.

    Args:
        gains: log gains of the entry (n_runs, n_scenarios).
        mppt: log gains of MPPT (n_scenarios,).
    """
    runs, scenarios = _drawn_runs(gains.shape[0], 0), _drawn_scenarios(mppt.size)
    means = interquartile_mean(gains[runs[:, :, np.newaxis], scenarios[:, np.newaxis]].reshape(N_RESAMPLES, gains.size))
    scale = -_resampled_means(mppt[np.newaxis])
    scored = scale > 0.0
    value = 100.0 * (1.0 + float(interquartile_mean(gains.ravel())) / -mean(mppt))
    return percentile_interval(value, 100.0 * (1.0 + means[scored] / scale[scored]))


def points_by_term(costs: Floats, reference: Floats, terms: Floats, reference_terms: Floats, scale: float) -> Floats:
    """Return how many points of the score above 100 come from each term of the cost, (n_terms,).

    A logarithm of a ratio is a difference divided by its logarithmic mean, ln(A / B) = (A - B) / L(A, B), and the
    difference of two costs is the sum of the differences of their terms. So each term gets the share
    100 · (J_ref,term - J_term) / L(J_ref + J0, J + J0) / Λ of its scenario. Shares of terms that add up to the pinned
    costs add up to the score minus 100, without a remainder.

    Source: the logarithmic mean Divisia index (LMDI) of B. W. Ang, Energy Policy 32 (2004) 1131-1139 and 33 (2005)
    867-871.

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        reference: pinned costs of the reference (n_scenarios,).
        terms: parts of `costs` (n_terms, n_runs, n_scenarios).
        reference_terms: parts of `reference` (n_terms, n_scenarios).
        scale: Λ.
    """
    inverse_means = np.array(
        [[_inverse_log_mean(r, c) for r, c in zip(reference.tolist(), run, strict=True)] for run in costs.tolist()]
    )
    shares = (reference_terms[:, np.newaxis] - terms) * inverse_means
    return np.array([100.0 * mean(share) / scale for share in shares])


def _inverse_log_mean(reference: float, cost: float) -> float:
    """Return 1 / L(J_ref + J0, J + J0)."""
    ratio = (reference - cost) / (cost + COST_OFFSET)
    return (math.log1p(ratio) / ratio if ratio else 1.0) / (cost + COST_OFFSET)


def gap_closed(costs: Floats, reference: Floats, oracle: Floats) -> Interval | None:
    """Return 100 · (mean J_ref - mean J) / (mean J_ref - mean J_oracle) with its bootstrap interval [%].

    All three means are over the same scenarios, in every resample too. A resample whose scenarios the oracle does not
    improve has no share and is left out.

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        reference, oracle: pinned costs of the two, (n_scenarios,).

    Returns:
        None where the mean cost is not below the reference's, which closes no part of the gap, and where the oracle's
        is not.
    """
    gains, gaps = reference - costs, reference - oracle
    if not mean(gaps) > 0.0 or not mean(gains) > 0.0:
        return None
    gained, gap = _resampled_means(gains), _resampled_means(gaps[np.newaxis])
    return percentile_interval(100.0 * mean(gains) / mean(gaps), 100.0 * gained[gap > 0.0] / gap[gap > 0.0])


__all__ = [
    "BOOTSTRAP_SEED",
    "CONFIDENCE",
    "COST_OFFSET",
    "N_RESAMPLES",
    "Interval",
    "NoScaleError",
    "gap_closed",
    "improvement",
    "interquartile_interval",
    "interquartile_mean",
    "log_gains",
    "mean",
    "mean_interval",
    "mean_score",
    "percentile_interval",
    "pinned_cost",
    "points_by_term",
    "resampled_scores",
    "scenario_scores",
    "score_difference",
    "score_interval",
    "score_scale",
]
