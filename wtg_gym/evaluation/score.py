"""The score: from the costs of episodes to points.

- **Pinned cost** J of a scenario: the episode's total cost; in v0 that of a failed one is cap · (duration + 1 s), as if
  it had failed at once.
- **Gain**: g = ln((J_100 + J0) / (J + J0)), with the offset J0 of its stratum and J_100 of the law that scores 100. Up
  to J0 a cost counts almost as in a mean, beyond by its ratio, so that a few failures do not decide alone.
- **Score**: 100 + 100 / Λ · the mean over strata of their mean gains. A point is Λ per cent of J + J0 everywhere.

In v1 Λ is :attr:`Task.scale`, and mean gains are adjusted, see :mod:`wtg_gym.evaluation.adjusted`. v0 has no strata; Λ
is the mean of ln((J_0 + J0) / (J_100 + J0)) over the same scenarios, J_0 of the law that scores 0.

Arrays of one entry have the shape (n_runs, n_scenarios): one run per training seed, a single one for a law.
"""

import math
from typing import TypeVar

import numpy as np

from wtg_gym.evaluation.statistics import Floats, Groups, mean
from wtg_gym.tasks import Task

Duration = TypeVar("Duration", float, Floats)
# Those of `math`, because numpy's own logarithms differ between processors in the last bit.
_log, _log1p = (np.vectorize(function, otypes=[np.float64]) for function in (math.log, math.log1p))


class NoScaleError(ValueError):
    """No scores on these scenarios: the entry at 0 is not worse than the entry at 100."""


def cost_offsets(groups: Groups, task: Task) -> Floats:
    """Return J0 of every scenario, (n_scenarios,)."""
    offsets = np.empty(sum(group.size for group in groups.values()))
    for name, group in groups.items():
        offsets[group] = task.cost_offsets[name]
    return offsets


def failure_cost(duration_s: Duration, rate: float) -> Duration:
    """Return what an episode of a length [s] costs that fails at once, at the largest cost rate [1/s]."""
    return rate * (duration_s + 1.0)


def gains(costs: Floats, hundred: Floats, offsets: Floats) -> Floats:
    """Return ln((J_100 + J0) / (J + J0)) of pinned costs (n_runs, n_scenarios); J_100 and J0 are (n_scenarios,).

    A ValueError says that a cost is negative or not finite.
    """
    for values in (costs, hundred):
        if not np.isfinite(values).all() or (values < 0.0).any():
            raise ValueError(f"costs must be finite and not negative, got {values.min():g} … {values.max():g}")
    gained: Floats = _log(hundred + offsets) - _log(costs + offsets)
    return gained


def score_scale(zero: Floats, hundred: Floats, task: Task, groups: Groups) -> float:
    """Return Λ: the task's, or else from the anchors' pinned costs (n_scenarios,); a NoScaleError if not positive."""
    if task.scale is not None:
        return task.scale
    scale = -mean(gains(zero[np.newaxis], hundred, cost_offsets(groups, task)))
    if not scale > 0.0:
        raise NoScaleError(
            f"on these {zero.size} scenarios {task.zero} (mean cost {mean(zero):.4g}) is not worse than {task.hundred} "
            f"(mean cost {mean(hundred):.4g}): Λ = {scale:.3g} must be positive to score with"
        )
    return scale


def gains_by_term(costs: Floats, hundred: Floats, terms: Floats, hundred_terms: Floats, offsets: Floats) -> Floats:
    """Return the part of each term of the cost in the gains, (n_terms, n_runs, n_scenarios).

    With the logarithmic mean L, ln(A / B) = (A - B) / L(A, B), each term has the part (J_100,term - J_term) / L(J_100 +
    J0, J + J0) of its scenario. Parts of terms (n_terms, n_runs, n_scenarios), those of the hundred (n_terms,
    n_scenarios), that add up to the pinned costs add up to the gains.

    Source: the logarithmic mean Divisia index (LMDI) of B. W. Ang, Energy Policy 32 (2004) 1131-1139 and 33 (2005)
    867-871.
    """
    ratios = (hundred - costs) / (costs + offsets)
    per_ratio = np.divide(_log1p(ratios), ratios, out=np.ones_like(ratios), where=ratios != 0.0)
    parts: Floats = (hundred_terms[:, np.newaxis] - terms) * (per_ratio / (costs + offsets))
    return parts
