"""The score: from the costs of episodes to points.

Pinned cost of scenario i: J_i is the episode's total cost; in v0 that of a failed episode is cap · (duration + 1 s), as
if it had failed at once, which is the worst any episode can cost.

Gain of scenario i: ln((J_100,i + J0) / (J_i + J0)), where J0 is the offset of its stratum. Up to J0 a cost counts
almost as in a mean, beyond by its ratio, so that a few failures do not decide alone. J_100 and J_0 are the pinned costs
of the two anchors of the benchmark's version, the hundred and the zero. Λ, the scale, is the mean over the scenarios of
ln((J_0,i + J0) / (J_100,i + J0)).

Score: 100 · (1 + mean gain / Λ), so that on the same scenarios the zero has 0 and the hundred 100. Where the suite
draws strata, each has a score with a Λ of its own, and their mean is the score.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.statistics import Floats, Groups, mean, mean_over_groups
from wtg_gym.tasks import Task


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


def pinned(episode: Episode, cap: float | None) -> float:
    """Return the pinned cost of an episode, with the largest cost rate `cap` [1/s]; None: as charged."""
    cost = episode.metrics["cost"]
    assert cost is not None
    return cost if cap is None else pinned_cost(cost, failed=episode.failed, duration_s=episode.duration_s, cap=cap)


def cost_offsets(groups: Groups, task: Task) -> Floats:
    """Return J0 of every scenario, (n_scenarios,)."""
    found = np.empty(sum(group.size for group in groups.values()))
    for name, group in groups.items():
        found[group] = dict(task.cost_offsets)[name]
    return found


def gains(costs: Floats, hundred: Floats, offsets: Floats) -> Floats:
    """Return ln((J_100 + J0) / (J + J0)), shape (n_runs, n_scenarios).

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        hundred: pinned costs of the hundred (n_scenarios,).
        offsets: J0 of each scenario (n_scenarios,).

    Raises:
        ValueError: a cost is negative or not finite.
    """
    for values in (costs, hundred):
        if not np.isfinite(values).all() or (values < 0.0).any():
            raise ValueError(f"costs must be finite and not negative, got {values.min():g} … {values.max():g}")

    # math.log, because numpy's own logarithm differs between processors in the last bit.
    def logarithms(row: Floats) -> Floats:
        return np.array([math.log(each) for each in (row + offsets).tolist()])

    base = logarithms(hundred)
    return np.array([base - logarithms(run) for run in costs])


def score_scales(zero: Floats, hundred: Floats, task: Task, groups: Groups) -> list[float]:
    """Return Λ of every group of scenarios, from the pinned costs of the two anchors, each of shape (n_scenarios,).

    Raises:
        NoScaleError: a Λ is not positive, so that there is no scale to score on.
    """
    lost = gains(zero[np.newaxis], hundred, cost_offsets(groups, task))[0]
    scales = [-mean(lost[group]) for group in groups.values()]
    for (name, group), scale in zip(groups.items(), scales, strict=True):
        if not scale > 0.0:
            stratum = f" of the stratum {name!r}" if name else ""
            raise NoScaleError(
                f"on these {group.size} scenarios{stratum} {task.zero} (mean cost {mean(zero[group]):.4g}) is not "
                f"worse than {task.hundred} (mean cost {mean(hundred[group]):.4g}): Λ = {scale:.3g} must be "
                "positive to score with"
            )
    return scales


def mean_score(own: Floats, scales: Sequence[float], groups: Groups) -> float:
    """Return the score from the :func:`gains` and every Λ; exactly 0 for the zero and 100 for the hundred."""
    return mean_over_groups(
        100.0 * (1.0 + mean(own[:, group]) / scale) for group, scale in zip(groups.values(), scales, strict=True)
    )


def points_by_term(
    costs: Floats,
    hundred: Floats,
    terms: Floats,
    hundred_terms: Floats,
    scales: Sequence[float],
    groups: Groups,
    offsets: Floats,
) -> Floats:
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
        scales: Λ of every group.
        groups: of the scenarios.
        offsets: J0 of each scenario (n_scenarios,).
    """
    shares = hundred_terms[:, np.newaxis] - terms
    shares *= [
        [_inverse_log_mean(*each) for each in zip(hundred.tolist(), run, offsets.tolist(), strict=True)]
        for run in costs.tolist()
    ]
    each = list(zip(groups.values(), scales, strict=True))
    return np.array(
        [mean_over_groups(100.0 * mean(share[:, group]) / scale for group, scale in each) for share in shares]
    )


def _inverse_log_mean(hundred: float, cost: float, offset: float) -> float:
    """Return 1 / L(J_100 + J0, J + J0)."""
    ratio = (hundred - cost) / (cost + offset)
    return (math.log1p(ratio) / ratio if ratio else 1.0) / (cost + offset)
