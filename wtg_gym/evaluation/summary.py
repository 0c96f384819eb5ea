"""The summary of an entry: its row in a ranking, with a score or, where there is no scale, without."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.score import log_gains, pinned, points_by_term, score_scale
from wtg_gym.evaluation.statistics import Floats, Interval
from wtg_gym.scenarios.benchmark import Benchmark

#: The episodes of an entry, a sequence for each training seed.
Runs = Sequence[Sequence[Episode]]
#: The cost's terms that the points of a score are counted by; the others, and the cost of failures, are "rest".
POINTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"frequency_rocof": ("frequency", "rocof"), "duty": ("duty",), "overload": ("overload",)}
)
REST = "rest"
#: Share of the scenarios that count as the worst.
_WORST = 0.1
#: Largest deviation that the grid of Continental Europe is designed for, 0.8 Hz; a run beyond it counts with the lost.
DESIGN_DEVIATION_MHZ = 800.0


@dataclass(frozen=True, kw_only=True)
class EntrySummary:
    """One row of a ranking, over all scenarios and training seeds of an entry; without a scale there is no score."""

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
    mean_pinned_cost: float  # [-]
    worst_decile_cost: float  # mean pinned cost of the worst tenth of the scenarios of each training seed [-]
    #: Median and 95th percentile of the largest deviations of the frequency of the centre of inertia from the nominal
    #: one, up or down [mHz].
    median_deviation_mhz: float
    p95_deviation_mhz: float
    median_nadir_hz: float  # [Hz]
    p95_rocof_hz_s: float  # 95th percentile of the largest rates of change of frequency [Hz/s]
    mean_duty_error_percent: float  # [%]
    mean_energy_share_percent: float  # of the available energy [%]
    score: Interval | None = None  # mean of the scenarios' scores: 0 and 100 are those of the version's anchors
    #: The score minus that of the entry above in the ranking, on the same scenarios; None for the first.
    difference_to_above: Interval | None = None
    #: Points above 100 by the cost terms they come from, by the names in :data:`POINTS` and :data:`REST`; they add up
    #: to the score minus 100, see :func:`points_by_term`.
    points_by_term: Mapping[str, float] = field(default_factory=dict)


def measured(
    entries: Sequence[Mapping[str, Any]], runs: Mapping[str, Runs], costs: Mapping[str, Floats], benchmark: Benchmark
) -> list[EntrySummary]:
    """Return the row of every name without its score, in the order of the entries.

    All runs are on the same scenarios in the same order; costs are pinned, (n_runs, n_scenarios).
    """
    described = {entry["name"]: entry for entry in entries}
    return [_measured(each, runs[name], costs[name], benchmark) for name, each in described.items()]


def scored(
    rows: Sequence[EntrySummary], runs: Mapping[str, Runs], costs: Mapping[str, Floats], benchmark: Benchmark
) -> list[EntrySummary]:
    """Return the :func:`measured` rows with their scores; a NoScaleError if the zero is not worse than the hundred."""
    hundred = costs[benchmark.hundred][0]
    score_scale(costs[benchmark.zero][0], hundred, benchmark.anchors)
    gains = {name: log_gains(own, hundred) for name, own in costs.items()}
    zero = gains[benchmark.zero][0]
    terms = {row.name: parts_of_costs(runs[row.name], costs[row.name]) for row in rows}
    hundred_terms = terms[benchmark.hundred][:, 0]

    def with_score(row: EntrySummary) -> EntrySummary:
        points = points_by_term(costs[row.name], hundred, terms[row.name], hundred_terms, -statistics.mean(zero))
        return replace(
            row,
            score=statistics.score_interval(gains[row.name], zero),
            points_by_term=dict(zip((*POINTS, REST), points.tolist(), strict=True)),
        )

    rows = [with_score(row) for row in rows]
    above = {
        row.name: statistics.score_difference(gains[row.name], gains[better.name], zero)
        for better, row in itertools.pairwise(ranked(rows))
    }
    return [replace(row, difference_to_above=above.get(row.name)) for row in rows]


def place(row: EntrySummary) -> float:
    """Return what a row is ranked by, the least first: the score, or without one the mean pinned cost."""
    return row.mean_pinned_cost if row.score is None else -row.score.value


def ranked(rows: Iterable[EntrySummary]) -> list[EntrySummary]:
    """Return the rows in the order of the ranking, equal ones by name."""
    return sorted(rows, key=lambda row: (place(row), row.name))


def runs_by_name(episodes: Sequence[Episode]) -> dict[str, Runs]:
    """Return the episodes of every name, one list per training seed."""
    runs: dict[str, dict[int | None, list[Episode]]] = {}
    for episode in episodes:
        runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(episode)
    return {name: list(own.values()) for name, own in runs.items()}


def pinned_costs(runs: Runs, cap: float) -> Floats:
    """Return the pinned costs, (n_runs, n_scenarios), with the largest cost rate `cap` [1/s]."""
    return np.array([[pinned(episode, cap) for episode in run] for run in runs])


def _values(runs: Runs, metric: str) -> Floats:
    return np.array([episode.metrics[metric] for run in runs for episode in run], dtype=np.float64)


def parts_of_costs(runs: Runs, costs: Floats) -> Floats:
    """Return the terms of the cost as paid, in the order of :data:`POINTS`, and the rest of the pinned costs.

    The shape is (n_terms, n_runs, n_scenarios).
    """
    terms = np.array([sum(_values(runs, f"cost_{term}") for term in terms) for terms in POINTS.values()])
    terms = terms.reshape(len(POINTS), *costs.shape)
    return np.concatenate([terms, (costs - terms.sum(axis=0))[np.newaxis]])


def _measured(entry: Mapping[str, Any], runs: Runs, costs: Floats, benchmark: Benchmark) -> EntrySummary:
    lost = np.array([episode.failed for run in runs for episode in run])
    nadirs, zeniths = _values(runs, "nadir_hz"), _values(runs, "zenith_hz")
    deviations = 1000.0 * np.maximum(benchmark.nominal_hz - nadirs, zeniths - benchmark.nominal_hz)
    return EntrySummary(
        name=entry["name"],
        kind=str(entry["kind"]),
        privileged=entry["observation_mode"] == "privileged",
        version=benchmark.version,
        n_runs=costs.shape[0],
        n_episodes=costs.size,
        n_lost=int(lost.sum()),
        failures_percent=100.0 * float(np.mean(lost)),
        lost_or_beyond_percent=100.0 * float(np.mean(lost | (deviations > DESIGN_DEVIATION_MHZ))),
        mean_pinned_cost=statistics.mean(costs),
        worst_decile_cost=statistics.mean(np.sort(costs, axis=1)[:, -math.ceil(_WORST * costs.shape[1]) :]),
        median_deviation_mhz=float(np.median(deviations)),
        p95_deviation_mhz=float(np.percentile(deviations, 95.0)),
        median_nadir_hz=float(np.median(nadirs)),
        p95_rocof_hz_s=float(np.percentile(_values(runs, "largest_rocof_hz_s"), 95.0)),
        mean_duty_error_percent=statistics.mean(_values(runs, "duty_error_percent")),
        mean_energy_share_percent=statistics.mean(_values(runs, "energy_share_percent")),
    )
