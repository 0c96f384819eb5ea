"""The score: from the costs of episodes to points.

Pinned cost of scenario i: J_i is the episode's total cost; that of a failed episode is cap · (duration + 1 s), as if it
had failed at once, which is the worst any episode can cost.

Score of scenario i: s_i = 100 · (1 + ln((J_100,i + J0) / (J_i + J0)) / Λ), where Λ is the mean over the scenarios of
ln((J_0,i + J0) / (J_100,i + J0)), and J_0 and J_100 are the pinned costs of the two anchors of the benchmark's version.
On the same scenarios the zero, one of them, has the mean score 0, and the other, the hundred, 100 in each. J0 bounds
the gain in a scenario that happens to be nearly free of cost.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law.
"""

from __future__ import annotations

import math

import numpy as np

from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.statistics import Floats, mean

#: J0 of the score, in units of the cost.
COST_OFFSET = 5.0


class NoScaleError(ValueError):
    """On these scenarios the zero is not worse than the hundred, so that there is no scale."""


def pinned_cost(cost: float, *, failed: bool, duration_s: float, cap: float) -> float:
    """Return the pinned cost of an episode.

    Args:
        cost: its total cost.
        failed: whether it ended in a failure.
        duration_s: how long it should have lasted [s].
        cap: largest cost rate [1/s].
    """
    return cap * (duration_s + 1.0) if failed else cost


def pinned(episode: Episode, cap: float) -> float:
    """Return the pinned cost of an episode, with the largest cost rate `cap` [1/s]."""
    cost = episode.metrics["cost"]
    assert cost is not None
    return pinned_cost(cost, failed=episode.failed, duration_s=episode.duration_s, cap=cap)


def log_gains(costs: Floats, hundred: Floats) -> Floats:
    """Return ln((J_100 + J0) / (J + J0)), shape (n_runs, n_scenarios).

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        hundred: pinned costs of the hundred (n_scenarios,).

    Raises:
        ValueError: a cost is negative or not finite.
    """
    for values in (costs, hundred):
        if not np.isfinite(values).all() or (values < 0.0).any():
            raise ValueError(f"costs must be finite and not negative, got {values.min():g} … {values.max():g}")
    # math.log, because numpy's own logarithm differs between processors in the last bit.
    base = [math.log(cost + COST_OFFSET) for cost in hundred.tolist()]
    return np.array([[b - math.log(c + COST_OFFSET) for b, c in zip(base, run, strict=True)] for run in costs.tolist()])


def score_scale(zero: Floats, hundred: Floats, names: tuple[str, str] = ("the zero", "the hundred")) -> float:
    """Return Λ from the pinned costs of the two anchors, each of shape (n_scenarios,), and their names for messages.

    Raises:
        NoScaleError: Λ is not positive, so that there is no scale to score on.
    """
    scale = -mean(log_gains(zero[np.newaxis], hundred))
    if not scale > 0.0:
        raise NoScaleError(
            f"on these {hundred.size} scenarios {names[0]} (mean pinned cost {mean(zero):.4g}) is not worse than "
            f"{names[1]} (mean pinned cost {mean(hundred):.4g}): Λ = {scale:.3g} must be positive to score with"
        )
    return scale


def mean_score(gains: Floats, scale: float) -> float:
    """Return the mean of s_i from the :func:`log_gains` and Λ; exactly 0 for the zero and 100 for the hundred."""
    return 100.0 * (1.0 + mean(gains) / scale)


def points_by_term(costs: Floats, hundred: Floats, terms: Floats, hundred_terms: Floats, scale: float) -> Floats:
    """Return how many points of the score above 100 come from each term of the cost, (n_terms,).

    A logarithm of a ratio is a difference divided by its logarithmic mean, ln(A / B) = (A - B) / L(A, B), and the
    difference of two costs is the sum of the differences of their terms. So each term gets the share
    100 · (J_100,term - J_term) / L(J_100 + J0, J + J0) / Λ of its scenario. Shares of terms that add up to the pinned
    costs add up to the score minus 100, without a remainder.

    Source: the logarithmic mean Divisia index (LMDI) of B. W. Ang, Energy Policy 32 (2004) 1131-1139 and 33 (2005)
    867-871.

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        hundred: pinned costs of the hundred (n_scenarios,).
        terms: parts of `costs` (n_terms, n_runs, n_scenarios).
        hundred_terms: parts of `hundred` (n_terms, n_scenarios).
        scale: Λ.
    """
    inverse_means = np.array(
        [[_inverse_log_mean(h, c) for h, c in zip(hundred.tolist(), run, strict=True)] for run in costs.tolist()]
    )
    shares = (hundred_terms[:, np.newaxis] - terms) * inverse_means
    return np.array([100.0 * mean(share) / scale for share in shares])


def _inverse_log_mean(hundred: float, cost: float) -> float:
    """Return 1 / L(J_100 + J0, J + J0)."""
    ratio = (hundred - cost) / (cost + COST_OFFSET)
    return (math.log1p(ratio) / ratio if ratio else 1.0) / (cost + COST_OFFSET)
