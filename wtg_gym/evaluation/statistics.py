"""From costs to scores and their uncertainty.

Pinned cost of scenario i: J_i is the episode's total cost; that of a failed episode is cap · (duration + 1 s), as if it
had failed at once, which is the worst any episode can cost.

Score of scenario i: s_i = 100 · (1 + ln((J_ref,i + J0) / (J_i + J0)) / Λ), where Λ is the mean over the scenarios of
ln((J_mppt,i + J0) / (J_ref,i + J0)). On the same scenarios MPPT has the mean score 0 and the reference 100 in each. J0
bounds what a scenario that happens to be nearly free of cost can bring.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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


def bootstrap(values: Floats, statistic: Callable[[Floats], Floats]) -> tuple[float, float]:
    """Return the bounds of the percentile bootstrap interval.

    Scenarios and training seeds are both drawn with replacement, and every drawn seed plays the same drawn scenarios,
    as all seeds do in truth (A. B. Owen, "The pigeonhole bootstrap", 2007): what a hard scenario costs all seeds alike
    does not average out over them. The score's Λ is taken as known.

    Args:
        values: (n_runs, n_scenarios).
        statistic: takes (n_resamples, n_runs · n_scenarios) to (n_resamples,).
    """
    return _bounds(statistic(_resampled(values).reshape(N_RESAMPLES, values.size)))


def resampled_means(values: Floats) -> Floats:
    """Return the mean of (n_runs, n_scenarios) in every resample of the bootstrap, (n_resamples,).

    Every call draws the same scenarios, so that two entries' means can be subtracted as a paired difference.
    """
    means: Floats = _resampled(values).mean(axis=(1, 2))
    return means


def _resampled(values: Floats) -> Floats:
    """Return the values (n_runs, n_scenarios) of every resample, (N_RESAMPLES, n_runs, n_scenarios)."""
    n_runs, n = values.shape
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    scenarios = rng.integers(0, n, size=(N_RESAMPLES, 1, n))
    runs = rng.integers(0, n_runs, size=(N_RESAMPLES, n_runs, 1))
    resampled: Floats = values[runs, scenarios]
    return resampled


def _bounds(samples: Floats) -> tuple[float, float]:
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(samples, [tail, 100.0 - tail])
    return float(low), float(high)


def mean_interval(values: Floats) -> Interval:
    """Return the mean of (n_runs, n_scenarios) with its bootstrap interval."""
    return Interval(mean(values), *bootstrap(values, lambda samples: samples.mean(axis=-1)))


def interquartile_interval(values: Floats) -> Interval:
    """Return the interquartile mean of (n_runs, n_scenarios) with its bootstrap interval."""
    return Interval(float(interquartile_mean(values.ravel())), *bootstrap(values, interquartile_mean))


def gap_closed(costs: Floats, reference: Floats, oracle: Floats) -> Interval | None:
    """Return 100 · (mean J_ref - mean J) / (mean J_ref - mean J_oracle) with its bootstrap interval [%].

    All three means are over the same scenarios, in every resample too. A resample whose scenarios the oracle does not
    improve has no share and is left out.

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        reference, oracle: pinned costs of the two, (n_scenarios,).

    Returns:
        None where the oracle is not cheaper than the reference.
    """
    gains, gaps = reference - costs, reference - oracle
    if not mean(gaps) > 0.0:
        return None
    gained = _resampled(gains).sum(axis=(1, 2))
    # The same draws, for as many runs.
    gap = _resampled(np.broadcast_to(gaps, costs.shape)).sum(axis=(1, 2))
    return Interval(100.0 * mean(gains) / mean(gaps), *_bounds(100.0 * gained[gap > 0.0] / gap[gap > 0.0]))


def score_gap(public: tuple[Floats, Floats], fresh: tuple[Floats, Floats]) -> Interval:
    """Return the score on public scenarios minus that on fresh ones, with its bootstrap interval.

    The training seeds of a resample are the same on both sides, the scenarios are drawn on each side by themselves, and
    Λ is made anew from those that were drawn: between two sets of scenarios it is not the same.

    Args:
        public, fresh: log gains of the entry (n_runs, n_scenarios) and of MPPT (n_scenarios,), see :func:`log_gains`.
    """
    n_runs = public[0].shape[0]
    values = [mean_score(gains, -mean(mppt)) for gains, mppt in (public, fresh)]
    one, other = (
        100.0 * gains[runs, scenarios].mean(axis=(1, 2)) / -mppt[scenarios[:, 0]].mean(axis=1)
        for (gains, mppt), (runs, scenarios) in zip(
            (public, fresh), _two_sides(n_runs, public[1].size, fresh[1].size), strict=True
        )
    )
    return Interval(values[0] - values[1], *_bounds(one - other))


def excess_gap(public: tuple[Floats, Floats], fresh: tuple[Floats, Floats], scale: float) -> Interval:
    """Return the part of the gap that controls do not share, in points of the score, with its bootstrap interval.

    A set of scenarios that suits one good controller suits the others too. So the mean gain over the training seeds is
    regressed on the gains of controls, over the fresh scenarios; what this predicts for the public ones is taken off
    their gains. In the resamples, whose scenarios are those of :func:`score_gap`, the coefficients are taken as known,
    and so are the training seeds: asked is what these policies are, not what others trained alike would be. A row of
    which only some seeds know the public scenarios is seen as sharply as any other.

    Source: control variates, e.g. P. Glasserman, "Monte Carlo Methods in Financial Engineering", 2003, section 4.1.

    Args:
        public, fresh: log gains of the entry (n_runs, n_scenarios) and of the controls (n_controls, n_scenarios).
        scale: Λ of the fresh scenarios.
    """
    gains, controls = fresh
    centred = controls - controls.mean(axis=1, keepdims=True)
    weights = np.linalg.lstsq(centred.T, gains.mean(axis=0), rcond=None)[0]
    one, other = (100.0 * (own.mean(axis=0) - weights @ those) / scale for own, those in (public, fresh))
    sides = _two_sides(1, one.size, other.size)
    drawn = [own[scenarios[:, 0]].mean(axis=1) for own, (_, scenarios) in zip((one, other), sides, strict=True)]
    return Interval(mean(one) - mean(other), *_bounds(drawn[0] - drawn[1]))


def _two_sides(n_runs: int, n_public: int, n_fresh: int) -> list[tuple[Indices, Indices]]:
    """Return what two sets of scenarios are resampled by: the same runs for both, scenarios of each by themselves."""
    streams = [np.random.default_rng(seed) for seed in np.random.SeedSequence(BOOTSTRAP_SEED).spawn(3)]
    runs = streams[0].integers(0, n_runs, size=(N_RESAMPLES, n_runs, 1))
    return [
        (runs, stream.integers(0, n, size=(N_RESAMPLES, 1, n)))
        for stream, n in zip(streams[1:], (n_public, n_fresh), strict=True)
    ]


__all__ = [
    "BOOTSTRAP_SEED",
    "CONFIDENCE",
    "COST_OFFSET",
    "N_RESAMPLES",
    "Interval",
    "NoScaleError",
    "bootstrap",
    "excess_gap",
    "gap_closed",
    "improvement",
    "interquartile_interval",
    "interquartile_mean",
    "log_gains",
    "mean",
    "mean_interval",
    "mean_score",
    "pinned_cost",
    "resampled_means",
    "scenario_scores",
    "score_gap",
    "score_scale",
]
