"""The score: from the costs of episodes to points.

Pinned cost of scenario i: J_i is the total cost of the episode. In v0 a failed episode has cap · (duration + 1 s), the
largest cost, as if it had failed at once.

Gain of scenario i: g_i = ln((J_100,i + J0) / (J_i + J0)), with the offset J0 of its stratum and the pinned cost J_100
of the law that scores 100. Below J0 costs count almost as in a mean, beyond it by their ratio, so that a few failures
do not decide alone.

Score: 100 + 100 / Λ · the mean over strata of the mean gain of each, over training seeds and scenarios. So a point is
the same share of the cost, Λ per cent of J + J0, in every stratum and suite.

- v1: the scale Λ is a number, :attr:`Task.scale`. The mean gain of a stratum is adjusted by control variates, laws
  whose mean gain over the whole distribution is known: mean(g) - β · (mean(x) - μ), see
  :mod:`wtg_gym.evaluation.adjusted`, which has the intervals too.
- v0 has no strata. Λ is the mean over the same scenarios of ln((J_0,i + J0) / (J_100,i + J0)), J_0 being the cost of
  the law that scores 0, so that this one has exactly 0. Intervals are those of a bootstrap, see
  :class:`wtg_gym.evaluation.statistics.Bootstrap`.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law.
"""

from __future__ import annotations

import math

import numpy as np

from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.statistics import Floats, Groups, mean
from wtg_gym.tasks import Task


class NoScaleError(ValueError):
    """The entry at 0 is not worse than the entry at 100 on these scenarios: there is no scale for scores."""


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
    """Return Λ of every stratum: the task's, or without strata from the anchors' pinned costs, (n_scenarios,) each.

    Raises:
        NoScaleError: a Λ is not positive, so that there is no scale to score on.
    """
    if task.scale is not None:
        return [task.scale] * len(groups)
    scale = -mean(gains(zero[np.newaxis], hundred, cost_offsets(groups, task)))
    if not scale > 0.0:
        raise NoScaleError(
            f"on these {zero.size} scenarios {task.zero} (mean cost {mean(zero):.4g}) is not worse than {task.hundred} "
            f"(mean cost {mean(hundred):.4g}): Λ = {scale:.3g} must be positive to score with"
        )
    return [scale]


def gains_by_term(costs: Floats, hundred: Floats, terms: Floats, hundred_terms: Floats, offsets: Floats) -> Floats:
    """Return the part of each term of the cost in the gains, (n_terms, n_runs, n_scenarios).

    A logarithm of a ratio is a difference divided by its logarithmic mean, ln(A / B) = (A - B) / L(A, B), and the
    difference of two costs is the sum of the differences of their terms. So each term has the part
    (J_100,term - J_term) / L(J_100 + J0, J + J0) of its scenario. Parts of terms that add up to the pinned costs add up
    to the gains, without a remainder.

    Source: the logarithmic mean Divisia index (LMDI) of B. W. Ang, Energy Policy 32 (2004) 1131-1139 and 33 (2005)
    867-871.

    Args:
        costs: pinned costs (n_runs, n_scenarios).
        hundred: pinned costs of the hundred (n_scenarios,).
        terms: parts of `costs` (n_terms, n_runs, n_scenarios).
        hundred_terms: parts of `hundred` (n_terms, n_scenarios).
        offsets: J0 of each scenario (n_scenarios,).
    """
    parts = hundred_terms[:, np.newaxis] - terms
    parts *= [
        [_inverse_log_mean(*each) for each in zip(hundred.tolist(), run, offsets.tolist(), strict=True)]
        for run in costs.tolist()
    ]
    return parts


def _inverse_log_mean(hundred: float, cost: float, offset: float) -> float:
    """Return 1 / L(J_100 + J0, J + J0)."""
    ratio = (hundred - cost) / (cost + offset)
    return (math.log1p(ratio) / ratio if ratio else 1.0) / (cost + offset)
