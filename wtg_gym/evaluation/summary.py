"""What is said about an entry as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.task import COST_TERMS
from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.entries import ANCHORS
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.statistics import Interval

Floats = npt.NDArray[np.float64]


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
        probability_of_improvement: P(J < J_ref) + ½ P(J = J_ref) of the pinned costs [-].
        gap_closed_percent: (mean J_ref - mean J) / (mean J_ref - mean J_oracle) of the pinned costs, all means over the
            scenarios that have an oracle [%]; None where none has.
        n_oracle: number of scenarios that have an oracle.
        failures_percent: episodes that failed [%].
        mean_cost: mean pinned cost [-].
        mean_cost_terms: mean of every term of the cost as it was paid [-].
        median_nadir_hz: median of the lowest frequencies [Hz].
        p95_rocof_hz_s: 95th percentile of the largest rates of change of frequency [Hz/s].
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
    probability_of_improvement: Interval
    gap_closed_percent: Interval | None
    n_oracle: int
    failures_percent: float
    mean_cost: float
    mean_cost_terms: Mapping[str, float]
    median_nadir_hz: float
    p95_rocof_hz_s: float
    mean_duty_error_percent: float
    mean_energy_share_percent: float

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as JSON-ready data."""
        return asdict(self)


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
        ValueError: MPPT is not worse than the reference, so that there is no scale.
    """
    runs: dict[str, dict[int | None, list[Episode]]] = {}
    for episode in episodes:
        runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(episode)
    described = {entry["name"]: entry for entry in entries}
    mppt, reference = (_costs(list(runs[name].values()), cap)[0] for name in ANCHORS)
    scale = statistics.score_scale(mppt, reference)
    seeds = [episode.seed for episode in next(iter(runs[ANCHORS[1]].values()))]
    known = np.array([oracle.get(seed, np.nan) for seed in seeds])
    return [
        _summary(entry, list(runs[name].values()), reference, known, scale, cap) for name, entry in described.items()
    ]


def _costs(runs: Sequence[Sequence[Episode]], cap: float) -> Floats:
    """Pinned costs, shape (n_runs, n_scenarios)."""
    return np.array([[pinned(episode, cap) for episode in run] for run in runs])


def pinned(episode: Episode, cap: float) -> float:
    """Return the pinned cost of an episode, with the largest cost rate `cap` [1/s]."""
    cost = episode.metrics["cost"]
    assert cost is not None
    return statistics.pinned_cost(cost, failed=episode.failed, duration_s=episode.duration_s, cap=cap)


def _values(runs: Sequence[Sequence[Episode]], metric: str) -> Floats:
    return np.array([episode.metrics[metric] for run in runs for episode in run], dtype=np.float64)


def _summary(
    entry: Mapping[str, Any],
    runs: Sequence[Sequence[Episode]],
    reference: Floats,
    oracle: Floats,
    scale: float,
    cap: float,
) -> EntrySummary:
    costs = _costs(runs, cap)
    gains = statistics.log_gains(costs, reference)
    scores = statistics.scenario_scores(gains, scale)
    # The plain mean of the scores misses the anchors' 0 and 100 by a rounding.
    value = statistics.mean_score(gains, scale)
    low, high = statistics.bootstrap(scores, lambda samples: samples.mean(axis=-1))
    has = np.isfinite(oracle)
    return EntrySummary(
        name=entry["name"],
        kind=str(entry["kind"]),
        privileged=entry["observation_mode"] == "privileged",
        n_runs=costs.shape[0],
        n_episodes=costs.size,
        score=Interval(value, low, high),
        interquartile_mean=statistics.interquartile_interval(scores),
        difference=Interval(value - 100.0, low - 100.0, high - 100.0),
        probability_of_improvement=statistics.mean_interval(statistics.improvement(costs, reference)),
        gap_closed_percent=(statistics.gap_closed(costs[:, has], reference[has], oracle[has]) if has.any() else None),
        n_oracle=int(has.sum()),
        failures_percent=100.0 * float(np.mean([episode.failed for run in runs for episode in run])),
        mean_cost=statistics.mean(costs),
        mean_cost_terms={term: statistics.mean(_values(runs, f"cost_{term}")) for term in COST_TERMS},
        median_nadir_hz=float(np.median(_values(runs, "nadir_hz"))),
        p95_rocof_hz_s=float(np.percentile(_values(runs, "largest_rocof_hz_s"), 95.0)),
        mean_duty_error_percent=statistics.mean(_values(runs, "duty_error_percent")),
        mean_energy_share_percent=statistics.mean(_values(runs, "energy_share_percent")),
    )


__all__ = ["EntrySummary", "pinned", "summarise"]
