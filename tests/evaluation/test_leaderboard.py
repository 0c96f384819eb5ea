"""Facts about the ranking."""

import dataclasses

import numpy as np
import pytest

from wtg_gym import evaluation, get_suite
from wtg_gym.evaluation import summary
from wtg_gym.evaluation.adjusted import Adjusted, known_means
from wtg_gym.evaluation.results import markdown_section
from wtg_gym.evaluation.table import columns_of
from wtg_gym.tasks import V0, V1


def test_table_has_the_best_first_and_equal_scores_share_a_rank(results):
    first, second, third = rows = evaluation.leaderboard_rows(results)
    assert first.score.value > second.score.value > third.score.value
    equal = [first, dataclasses.replace(first, name="other"), second, third]
    assert [cells[0] for cells in evaluation.table_cells(equal)] == ["1", "1", "3", "4"]
    lines = evaluation.markdown_table(rows).split("\n")
    assert len(lines) == 2 + 3
    assert [head.strip() for head in lines[0].strip("|").split("|")] == columns_of("v0", rows)
    assert lines[2].startswith("| 1 | coordinated-piecewise | 100.0 | 0.0 | 0.0 | 0.0 | 0.0 | 0.0 | 49.")
    assert "-0.0" not in "".join(lines)


def changed(results: evaluation.Results, changes):
    """Return results in which fast-droop fails only as `changes` of its episodes say, and its row."""
    episodes = tuple(
        dataclasses.replace(e, **{"failure": "", **changes.get(e.seed - 10_000, {})}) if e.entry == "fast-droop" else e
        for e in results.episodes
    )
    found = dataclasses.replace(results, episodes=episodes)
    return found, next(row for row in found.summaries if row.name == "fast-droop")


def without_scale(results: evaluation.Results) -> evaluation.Results:
    """Return results of v0 in which the anchors have changed places."""
    other = {V0.zero: V0.hundred, V0.hundred: V0.zero}
    metrics = {(e.entry, e.seed): e.metrics for e in results.episodes}
    episodes = [dataclasses.replace(e, metrics=metrics[other.get(e.entry, e.entry), e.seed]) for e in results.episodes]
    return dataclasses.replace(results, episodes=tuple(episodes))


def test_table_shows_failures_the_worst_tenth_and_deviations(results_v1):
    reasons = ("stall", "frequency limit", "under-speed", "loss of synchronism")
    failed, row = changed(results_v1, {i: {"failure": reason} for i, reason in enumerate(reasons)})
    own = failed.episodes_of("fast-droop")
    assert row.worst_decile_cost == pytest.approx(np.mean(sorted(e.metrics["cost"] for e in own)[-2:]))
    deviations = [1e3 * max(50.0 - e.metrics["nadir_hz"], e.metrics["zenith_hz"] - 50.0) for e in own]
    assert row.median_deviation_mhz == pytest.approx(np.median(deviations))
    local = [1e3 * max(50.0 - e.metrics["worst_nadir_hz"], e.metrics["worst_zenith_hz"] - 50.0) for e in own]
    assert row.median_worst_deviation_mhz == pytest.approx(np.median(local))
    assert all(worst > own for worst, own in zip(local, deviations, strict=True))
    for table, column, text in (
        ("details", "failures [%]", "33.3"),
        ("v1", "median deviation [mHz]", f"{np.median(deviations):.0f}"),
    ):
        columns = columns_of(table, [row])
        assert evaluation.table_cells([row], columns)[0][columns.index(column)] == text


def test_runs_beyond_0_8_hz_count_with_the_lost_and_a_run_counts_once(results_v1):
    extremes = [(49.2, 50.0), (49.199, 50.0), (49.1, 50.0), (49.9, 50.801), *[(49.9, 50.0)] * 8]
    changes = {
        i: {"metrics": {**e.metrics, "nadir_hz": low, "zenith_hz": high}}
        for i, (e, (low, high)) in enumerate(zip(results_v1.episodes_of("fast-droop"), extremes, strict=True))
    }
    for lost in (2, 4):
        changes[lost]["failure"] = "stall"
    _, row = changed(results_v1, changes)
    # 49.199 and 50.801 Hz, the lost one at 49.1 Hz, and the other lost one.
    assert row.n_lost == 2 and row.lost_or_beyond_percent == pytest.approx(100.0 * 4 / 12)


def test_entries_that_leave_0_8_hz_more_often_than_the_anchor_rank_behind_it(results_v1):
    groups = {"ample": np.arange(0, 12, 2), "short": np.arange(1, 12, 2)}
    quiet = [
        dataclasses.replace(e, failure="", metrics={**e.metrics, "nadir_hz": 49.9, "zenith_hz": 50.1})
        for e in results_v1.episodes_of(V1.hundred)
    ]

    def wild(n_lost: int):
        return [*(dataclasses.replace(e, failure="frequency limit") for e in quiet[:n_lost]), *quiet[n_lost:]]

    # Four scenarios of four may be chance, p = 1 / 16; five are not.
    runs = {V1.zero: [quiet], V1.hundred: [quiet], "wild": [wild(5)], "fine": [wild(4)]}
    base = np.arange(10.0, 22.0)
    factors = {V1.zero: 2.0, V1.hundred: 1.0, "wild": 0.5, "fine": 1.1}
    costs = {name: base[np.newaxis] * factor for name, factor in factors.items()}
    entries = [{"name": name, "kind": "law", "observation_mode": "measured"} for name in runs]
    offsets = np.where(np.arange(12) % 2, *(dict(V1.cost_offsets)[name] for name in ("short", "ample")))
    arguments = entries, runs, costs, get_suite("standard-v1"), groups, Adjusted(0.3, groups)
    rows = summary.ranked(summary.summaries(*arguments, with_scores=True))
    assert [row.name for row in rows] == [V1.hundred, "fine", V1.zero, "wild"]
    assert [row.marked for row in rows] == [True, True, True, False]
    logs = {name: np.log(own[0] + offsets) for name, own in costs.items()}
    for row in rows:
        gained = logs[V1.hundred] - logs[row.name]
        expected = [100.0 + 100.0 / 0.3 * gained[at].mean() for at in groups.values()]
        assert row.score.value == pytest.approx(np.mean(expected))
        assert {name: own.value for name, own in row.strata.items()} == pytest.approx(
            dict(zip(groups, expected, strict=True))
        )
        assert sum(row.points_by_term.values()) == pytest.approx(row.score.value - 100.0)
    anchor, fine, _, last = rows
    nought = evaluation.Interval(0.0, 0.0, 0.0)
    assert anchor.lost_or_beyond_to_hundred == anchor.worst_decile_to_hundred == nought
    assert fine.worst_decile_to_hundred.value == pytest.approx(10.0)
    assert last.lost_or_beyond_to_hundred.value == pytest.approx(100.0 * 5 / 12)
    heads = columns_of("details", rows)
    assert heads[2:5] == ["score", *groups]
    text = evaluation.markdown_table(rows, heads)
    assert "| 0.0 ✓ | 0.0 | 0.0 |" in text and "| 41.7 | +41.7 (+2.2 … +81.2)" in text
    assert [cells[0] for cells in evaluation.table_cells(rows)] == ["1", "2", "3", "4"]


def test_entries_that_lose_grids_that_the_anchor_only_bends_have_no_mark(results_v1):
    low = {"nadir_hz": 49.1, "zenith_hz": 50.1}
    bent = [
        dataclasses.replace(e, failure="", metrics={**e.metrics, **low}) for e in results_v1.episodes_of(V1.hundred)
    ]
    lost = [dataclasses.replace(e, failure="frequency limit") for e in bent]
    runs = {V1.hundred: [bent], "loses": [lost], "loses one": [[*lost[:1], *bent[1:]]]}
    costs = {name: np.full((1, 12), 10.0) for name in runs}
    entries = [{"name": name, "kind": "law", "observation_mode": "measured"} for name in runs]
    groups = {"ordinary": np.arange(6), "large": np.arange(6, 12)}
    arguments = entries, runs, costs, get_suite("standard-v1"), groups, Adjusted(0.3, groups)
    rows = summary.summaries(*arguments, with_scores=False)
    assert [row.lost_or_beyond_to_hundred.value for row in rows] == [0.0, 0.0, 0.0]
    assert [row.marked for row in rows] == [True, False, True]


def test_scores_that_are_not_adjusted_say_why(results_v1):
    few = evaluation.evaluate("fast-droop", "standard-v1", seeds=[10_000, 10_002], duration_s=1.0)
    assert "their mean gains are not known for this suite with these settings" in few.unadjusted
    assert list(few.summaries[0].strata) == ["ample", "tight"] and not few.no_score
    whole = get_suite("standard-v1").duration_s
    own = dataclasses.replace(results_v1, settings={**results_v1.settings, "duration_s": whole})
    assert "they need 30 scenarios of each stratum" in own.unadjusted
    assert f"{own.unadjusted[0].upper()}{own.unadjusted[1:]}." in markdown_section(own)
    assert own.unadjusted in own._repr_markdown_()


def test_scores_of_many_scenarios_are_adjusted(results_v1):
    """Results of the same episodes over and over, as if they were of 96 scenarios of whole length."""
    seeds = range(10_000, 10_096)
    episodes = [
        dataclasses.replace(e, seed=seed)
        for entry in results_v1.entries
        for i, seed in enumerate(seeds)
        for e in [results_v1.episodes_of(entry["name"])[i % 12]]
    ]
    settings = {**results_v1.settings, "duration_s": get_suite("standard-v1").duration_s}
    many = dataclasses.replace(results_v1, seeds=tuple(seeds), episodes=tuple(episodes), settings=settings)
    assert many.unadjusted == "" and many.scores[V1.hundred] == evaluation.Interval(100.0, 100.0, 100.0)
    # A control variate has its known score, and the interval of that.
    known = known_means("standard-v1", many.suite_hash, settings, V1.variates)
    for i, name in enumerate(V1.variates):
        score = many.scores[name]
        assert score.value == pytest.approx(
            100.0 + 100.0 / V1.scale * np.mean([each.mean[i] for each in known.values()])
        )
        error = np.sqrt(sum(each.covariance[i][i] / each.n for each in known.values())) / len(known)
        assert score.high - score.value == pytest.approx(1.96 * 100.0 / V1.scale * error, rel=1e-3)


def test_without_a_score_the_mean_pinned_cost_ranks(tmp_path):
    results = without_scale(evaluation.evaluate("deloaded-10", "paper", "test"))
    rows = results.ranking
    columns = columns_of("terminal", rows)
    assert results.no_score and len(rows) == 3
    with pytest.raises(evaluation.NoScaleError, match=r"mppt \(mean cost .*\) is not worse than coordinated-piecewise"):
        evaluation.leaderboard_rows(results)
    assert evaluation.Results.read(results.write(tmp_path)[0]) == results
    costs = {name: float(np.mean(costs)) for name, costs in results.pinned_costs.items()}
    assert [row.name for row in rows] == sorted(costs, key=lambda name: costs[name])
    cells = [dict(zip(columns, each, strict=True)) for each in evaluation.table_cells(rows, columns)]
    assert [each["rank"] for each in cells] == ["1", "2", "3"] and {each["score"] for each in cells} == {"none"}
    assert [each["mean cost"] for each in cells] == [f"{costs[row.name]:.1f}" for row in rows]
    for text in (markdown_section(results), results._repr_markdown_()):
        assert "anked by mean cost, as there is no score: on these 2 scenarios mppt" in text
        assert "[points]" not in text and f"{costs[rows[0].name]:.1f}" in text
    assert results.to_dict()["summary"]["deloaded-10"]["mean_pinned_cost"] == pytest.approx(costs["deloaded-10"])
