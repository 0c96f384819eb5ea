"""The summary of an entry: its row in a ranking."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wtg_gym.evaluation import adjusted, statistics
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.score import cost_offsets, failure_cost, gains, gains_by_term
from wtg_gym.evaluation.statistics import Bootstrap, Floats, Groups, Interval
from wtg_gym.scenarios.suite import Suite

#: The episodes of an entry, a sequence for each training seed.
Runs = Sequence[Sequence[Episode]]
#: The cost's terms that the points of a score are counted by; the others, and the cost of failures, are "rest".
POINTS: Mapping[str, tuple[str, ...]] = {
    "frequency_rocof": ("frequency", "rocof"),
    "duty": ("duty",),
    "overload": ("overload",),
}
REST = "rest"
#: Largest deviation that the grid of Continental Europe is designed for, 0.8 Hz; a run beyond it counts with the lost.
DESIGN_DEVIATION_MHZ = 800.0
#: Chance of so many more bad runs than the hundred's below which an entry has no mark.
_SIGNIFICANT = 0.05


@dataclass(frozen=True, kw_only=True)
class EntrySummary:
    """One row of a ranking, over all scenarios and training seeds of an entry."""

    name: str  # of the entry
    kind: str  # "law", "feedback" or "learned"
    privileged: bool  # whether it sees the state of the grid, which no turbine measures
    version: str  # of the benchmark
    n_runs: int  # number of training seeds, 1 for a law
    n_episodes: int
    n_lost: int  # number of episodes that failed
    failures_percent: float  # episodes that failed [%]
    #: Episodes that failed, or whose largest deviation was beyond :data:`DESIGN_DEVIATION_MHZ` [%].
    lost_or_beyond_percent: float
    #: That minus the hundred's [percentage points].
    lost_or_beyond_to_hundred: Interval
    #: Whether neither these nor the failures are significantly more than the hundred's, see :func:`sign_test`; in v0
    #: always.
    marked: bool
    mean_pinned_cost: float  # [-]
    worst_decile_cost: float  # mean pinned cost of the worst tenth of the scenarios of each training seed [-]
    worst_decile_to_hundred: Interval  # how much dearer that is than the hundred's [%]
    #: Median of the largest deviations from the nominal frequency, up or down, of the centre of inertia, and of the bus
    #: or unit that is farthest from it, which extended physics alone knows [mHz].
    median_deviation_mhz: float
    median_worst_deviation_mhz: float | None
    median_nadir_hz: float  # [Hz]
    mean_duty_error_percent: float  # [%]
    mean_energy_share_percent: float  # of the available energy [%]
    score: Interval | None = None  # 0 and 100 are those of the version's anchors
    strata: Mapping[str, Interval] = field(default_factory=dict)  # the score of each stratum, whose mean is the score
    #: Points above 100 by the cost terms they come from, by the names in :data:`POINTS` and :data:`REST`; they add up
    #: to the score minus 100, see :func:`points_by_term`.
    points_by_term: Mapping[str, float] = field(default_factory=dict)


def summaries(
    entries: Sequence[Mapping[str, Any]],
    runs: Mapping[str, Runs],
    costs: Mapping[str, Floats],
    suite: Suite,
    groups: Groups,
    scoring: Bootstrap | adjusted.Adjusted,
    *,
    with_scores: bool,
) -> list[EntrySummary]:
    """Return the row of every name; costs are pinned, (n_runs, n_scenarios), all on one order."""
    task, nominal_hz = suite.task, suite.nominal_hz
    failed = {name: lost(entry_runs) for name, entry_runs in runs.items()}
    bad = {name: lost_or_beyond(entry_runs, nominal_hz) for name, entry_runs in runs.items()}

    def score(name: str) -> dict[str, Any]:
        hundred, offsets = costs[task.hundred][0], cost_offsets(groups, task)
        gained = gains(costs[name], hundred, offsets)
        parts, parts_of_hundred = (parts_of_costs(runs[each], costs[each]) for each in (name, task.hundred))
        by_term = gains_by_term(costs[name], hundred, parts, parts_of_hundred[:, 0], offsets)
        points = dict(zip((*POINTS, REST), map(scoring.points, by_term), strict=True))
        return {"score": scoring.score(gained), "strata": scoring.strata(gained), "points_by_term": points}

    def row(name: str, entry: Mapping[str, Any]) -> EntrySummary:
        episodes, paid = runs[name], costs[name]
        reliable = (statistics.sign_test(event[name], event[task.hundred]) >= _SIGNIFICANT for event in (bad, failed))
        worst = float(np.median(_deviations(episodes, "worst_nadir_hz", "worst_zenith_hz", nominal_hz)))
        return EntrySummary(
            name=name,
            kind=str(entry["kind"]),
            privileged=entry["observation_mode"] == "privileged",
            version=task.version,
            n_runs=paid.shape[0],
            n_episodes=paid.size,
            n_lost=int(failed[name].sum()),
            failures_percent=statistics.share(failed[name], groups),
            lost_or_beyond_percent=statistics.share(bad[name], groups),
            lost_or_beyond_to_hundred=scoring.share_difference(bad[name], bad[task.hundred]),
            marked=not task.failure_costs_whole_episode or all(reliable),
            mean_pinned_cost=statistics.mean(paid),
            worst_decile_cost=statistics.mean(statistics.worst_tenth(paid)),
            worst_decile_to_hundred=scoring.worst_tenth_difference(paid, costs[task.hundred]),
            median_deviation_mhz=float(np.median(_deviations(episodes, "nadir_hz", "zenith_hz", nominal_hz))),
            median_worst_deviation_mhz=None if math.isnan(worst) else worst,
            median_nadir_hz=float(np.median(_values(episodes, "nadir_hz"))),
            mean_duty_error_percent=statistics.mean(_values(episodes, "duty_error_percent")),
            mean_energy_share_percent=statistics.mean(_values(episodes, "energy_share_percent")),
            **(score(name) if with_scores else {}),
        )

    return [row(name, entry) for name, entry in {entry["name"]: entry for entry in entries}.items()]


def place(row: EntrySummary) -> tuple[bool, float]:
    """Return what a row is ranked by, the least first: the mark, then the score; without a score the mean cost."""
    return (False, row.mean_pinned_cost) if row.score is None else (not row.marked, -row.score.value)


def ranked(rows: Iterable[EntrySummary]) -> list[EntrySummary]:
    """Return the rows in the order of the ranking, equal ones by name."""
    return sorted(rows, key=lambda row: (place(row), row.name))


def pinned_costs(runs: Runs, cap: float | None) -> Floats:
    """Return the pinned costs, (n_runs, n_scenarios), with the largest cost rate `cap` [1/s]; None: as charged."""
    costs = _values(runs, "cost")
    if cap is None:
        return costs
    durations_s = np.array([[episode.duration_s for episode in run] for run in runs])
    return np.where(lost(runs), failure_cost(durations_s, cap), costs)


def _values(runs: Runs, metric: str) -> Floats:
    return np.array([[episode.metrics[metric] for episode in run] for run in runs], dtype=np.float64)


def parts_of_costs(runs: Runs, costs: Floats) -> Floats:
    """Return the terms of :data:`POINTS` as paid, and the rest of the pinned costs, (n_terms, n_runs, n_scenarios)."""
    terms = np.array([sum(_values(runs, f"cost_{term}") for term in terms) for terms in POINTS.values()])
    return np.concatenate([terms, (costs - terms.sum(axis=0))[np.newaxis]])


def _deviations(runs: Runs, lowest: str, highest: str, nominal_hz: float) -> Floats:
    """Return the largest deviations up or down [mHz], (n_runs, n_scenarios); NaN where they are not known."""
    deviations: Floats = 1000.0 * np.maximum(nominal_hz - _values(runs, lowest), _values(runs, highest) - nominal_hz)
    return deviations


def lost(runs: Runs) -> Floats:
    """Return 1 where an episode failed, (n_runs, n_scenarios), else 0."""
    return np.array([[float(episode.failed) for episode in run] for run in runs])


def lost_or_beyond(runs: Runs, nominal_hz: float) -> Floats:
    """Return 1 where an episode failed or was beyond the design deviation, (n_runs, n_scenarios), else 0."""
    beyond = _deviations(runs, "nadir_hz", "zenith_hz", nominal_hz) > DESIGN_DEVIATION_MHZ
    return np.maximum(lost(runs), beyond)
