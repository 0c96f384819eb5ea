"""The summary of an entry: its row in a ranking."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.score import log_gains, pinned, points_by_term, score_scale
from wtg_gym.evaluation.statistics import Floats, Interval
from wtg_gym.policies import ANCHORS

#: The cost's terms that the points of a score are counted by; the others, and the cost of failures, are "rest".
POINTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"frequency_rocof": ("frequency", "rocof"), "duty": ("duty",), "overload": ("overload",)}
)
REST = "rest"


@dataclass(frozen=True, kw_only=True)
class EntrySummary:
    """One row of a ranking, over all scenarios and training seeds of an entry.

    Args:
        name: name of the entry.
        kind: "law", "feedback" or "learned".
        privileged: whether it sees the state of the grid, which no turbine measures.
        n_runs: number of training seeds, 1 for a law.
        n_episodes: number of episodes.
        score: mean of the scenarios' scores: 0 is MPPT, 100 the reference.
        interquartile_mean: of the scenarios' scores.
        difference: mean of the scenarios' scores minus the reference's on the same scenario.
        difference_to_above: the same, minus that of the entry above in the ranking; None for the first.
        points_by_term: points above 100 by the cost terms they come from, by the names in :data:`POINTS` and
            :data:`REST`; they add up to the score minus 100, see :func:`points_by_term`.
        probability_of_improvement: P(J < J_ref) + ½ P(J = J_ref) of the pinned costs [-].
        gap_closed_percent: (mean J_ref - mean J) / (mean J_ref - mean J_oracle) of the pinned costs, all means over the
            scenarios that have an oracle [%]; None where none has, or the mean cost is not below the reference's.
        n_oracle: number of scenarios that have an oracle.
        failures_percent: episodes that failed [%].
        mean_cost: mean pinned cost [-].
        mean_cost_terms: mean of every term of the cost as it was paid [-].
        median_nadir_hz: median of the lowest frequencies [Hz].
        p95_rocof_hz_s: 95th percentile of the largest rates of change of frequency [Hz/s].
        p95_peak_power_pu: 95th percentile of the largest powers of any group [p.u.].
        p95_power_change_pu: 95th percentile of the largest changes of any group's power over 1 s [p.u.].
        mean_duty_error_percent: mean of the duty errors [%].
        mean_energy_share_percent: mean of the shares of the available energy [%].
    """

    name: str
    kind: str
    privileged: bool
    n_runs: int
    n_episodes: int
    score: Interval
    interquartile_mean: Interval
    difference: Interval
    difference_to_above: Interval | None
    points_by_term: Mapping[str, float]
    probability_of_improvement: Interval
    gap_closed_percent: Interval | None
    n_oracle: int
    failures_percent: float
    mean_cost: float
    mean_cost_terms: Mapping[str, float]
    median_nadir_hz: float
    p95_rocof_hz_s: float
    p95_peak_power_pu: float
    p95_power_change_pu: float
    mean_duty_error_percent: float
    mean_energy_share_percent: float


def summarise(
    entries: Sequence[Mapping[str, Any]], episodes: Sequence[Episode], cap: float, oracle: Mapping[int, float]
) -> list[EntrySummary]:
    """Return one summary per name, in the order of the entries.

    Args:
        entries: the entries' data, both anchors among them.
        episodes: their episodes, each entry on the same scenarios in the same order.
        cap: largest cost rate [1/s].
        oracle: the oracle's costs by the scenarios' seeds, of those that have one.

    Raises:
        NoScaleError: MPPT is not worse than the reference, so that there is no scale.
    """
    runs: dict[str, dict[int | None, list[Episode]]] = {}
    for episode in episodes:
        runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(episode)
    described = {entry["name"]: entry for entry in entries}
    mppt, reference = (_costs(list(runs[name].values()), cap)[0] for name in ANCHORS)
    score_scale(mppt, reference)
    anchor = next(iter(runs[ANCHORS[1]].values()))
    known = np.array([oracle.get(episode.seed, np.nan) for episode in anchor])
    gains = {name: log_gains(_costs(list(runs[name].values()), cap), reference) for name in described}
    against = _Anchors(gains[ANCHORS[0]][0], reference, _terms([anchor], reference[np.newaxis])[:, 0], known)
    rows = [_summary(entry, list(runs[name].values()), gains[name], against, cap) for name, entry in described.items()]
    order = ranked(rows)
    above = {
        row.name: statistics.score_difference(gains[row.name], gains[better.name], against.mppt_gains)
        for better, row in itertools.pairwise(order)
    }
    return [replace(row, difference_to_above=above.get(row.name)) for row in rows]


def ranked(rows: Iterable[EntrySummary]) -> list[EntrySummary]:
    """Return the rows in the order of the ranking: the best score first, equal ones by name."""
    return sorted(rows, key=lambda row: (-row.score.value, row.name))


def _costs(runs: Sequence[Sequence[Episode]], cap: float) -> Floats:
    """Pinned costs, shape (n_runs, n_scenarios)."""
    return np.array([[pinned(episode, cap) for episode in run] for run in runs])


def _values(runs: Sequence[Sequence[Episode]], metric: str) -> Floats:
    return np.array([episode.metrics[metric] for run in runs for episode in run], dtype=np.float64)


def _terms(runs: Sequence[Sequence[Episode]], costs: Floats) -> Floats:
    """Return the terms of the cost as paid, in the order of :data:`POINTS`, and the rest of the pinned costs.

    The shape is (n_terms, n_runs, n_scenarios).
    """
    terms = np.array([sum(_values(runs, f"cost_{term}") for term in terms) for terms in POINTS.values()])
    terms = terms.reshape(len(POINTS), *costs.shape)
    return np.concatenate([terms, (costs - terms.sum(axis=0))[np.newaxis]])


@dataclass(frozen=True)
class _Anchors:
    """The arrays over the scenarios that every entry is compared with."""

    mppt_gains: Floats
    reference: Floats
    reference_terms: Floats
    oracle: Floats


def _summary(
    entry: Mapping[str, Any], runs: Sequence[Sequence[Episode]], gains: Floats, against: _Anchors, cap: float
) -> EntrySummary:
    costs, reference, mppt = _costs(runs, cap), against.reference, against.mppt_gains
    score = statistics.score_interval(gains, mppt)
    points = points_by_term(costs, reference, _terms(runs, costs), against.reference_terms, -statistics.mean(mppt))
    has = np.isfinite(against.oracle)
    return EntrySummary(
        name=entry["name"],
        kind=str(entry["kind"]),
        privileged=entry["observation_mode"] == "privileged",
        n_runs=costs.shape[0],
        n_episodes=costs.size,
        score=score,
        interquartile_mean=statistics.interquartile_interval(gains, mppt),
        difference=Interval(score.value - 100.0, score.low - 100.0, score.high - 100.0),
        difference_to_above=None,
        points_by_term=dict(zip((*POINTS, REST), points.tolist(), strict=True)),
        probability_of_improvement=statistics.mean_interval(statistics.improvement(costs, reference)),
        gap_closed_percent=(
            statistics.gap_closed(costs[:, has], reference[has], against.oracle[has]) if has.any() else None
        ),
        n_oracle=int(has.sum()),
        failures_percent=100.0 * float(np.mean([episode.failed for run in runs for episode in run])),
        mean_cost=statistics.mean(costs),
        mean_cost_terms={term: statistics.mean(_values(runs, f"cost_{term}")) for term in COST_TERMS},
        median_nadir_hz=float(np.median(_values(runs, "nadir_hz"))),
        p95_rocof_hz_s=float(np.percentile(_values(runs, "largest_rocof_hz_s"), 95.0)),
        p95_peak_power_pu=float(np.percentile(_values(runs, "peak_power_pu"), 95.0)),
        p95_power_change_pu=float(np.percentile(_values(runs, "largest_power_change_pu"), 95.0)),
        mean_duty_error_percent=statistics.mean(_values(runs, "duty_error_percent")),
        mean_energy_share_percent=statistics.mean(_values(runs, "energy_share_percent")),
    )
