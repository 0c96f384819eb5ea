"""Facts about the ranking."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from wtg_gym.evaluation import Entry, Results, evaluate, leaderboard_rows, markdown_table, table_cells
from wtg_gym.evaluation.leaderboard import COLUMNS, SHORT_COLUMNS, columns_of, short_columns_of
from wtg_gym.evaluation.score import pinned


def test_rows_are_sorted_by_score(results: Results) -> None:
    rows = leaderboard_rows(results)
    assert [row.score.value for row in rows] == sorted((row.score.value for row in rows), reverse=True)
    assert rows[0].name == "coordinated-piecewise"


def test_equal_scores_are_sorted_by_name(results: Results) -> None:
    rows = leaderboard_rows(results)
    equal = [dataclasses.replace(rows[0], name=name) for name in ("b", "c", "a")]
    results = dataclasses.replace(results)
    results.__dict__["summaries"] = equal
    assert [row.name for row in leaderboard_rows(results)] == ["a", "b", "c"]


def test_equal_scores_share_a_rank(results: Results) -> None:
    first, second, third = leaderboard_rows(results)
    rows = [first, dataclasses.replace(first, name="other"), second, third]
    assert [cells[0] for cells in table_cells(rows)] == ["1", "1", "3", "4"]


def test_table_has_a_row_per_entry_and_a_cell_per_column(results: Results) -> None:
    lines = markdown_table(leaderboard_rows(results)).split("\n")
    assert len(lines) == 2 + 3
    assert len({line.count("|") for line in lines}) == 1
    assert [head.strip() for head in lines[0].strip("|").split("|")] == list(SHORT_COLUMNS)
    assert lines[2].startswith("| 1 | coordinated-piecewise | 100.0 | 0.0 | 0.0 | 0.0 | 0.0 | 0.0 | 49.")
    assert "-0.0" not in markdown_table(leaderboard_rows(results))
    assert {len(cells) for cells in table_cells(leaderboard_rows(results))} == {len(COLUMNS)}


def test_every_entry_but_the_first_is_compared_with_the_one_above(results: Results) -> None:
    rows = leaderboard_rows(results)
    assert rows[0].difference_to_above is None
    for above, row in itertools.pairwise(rows):
        difference = row.difference_to_above
        assert difference is not None and difference.low <= difference.value <= difference.high
        assert difference.value == pytest.approx(row.score.value - above.score.value, abs=1e-9)


def test_points_by_term_add_up_to_the_score_with_failures_too(results: Results) -> None:
    episodes = [
        dataclasses.replace(e, failure="stall") if e.entry == "deloaded-10" and e.seed == 20_000 else e
        for e in results.episodes
    ]
    failed = dataclasses.replace(results, episodes=tuple(episodes))
    for row in (*results.summaries, *failed.summaries):
        assert sum(row.points_by_term.values()) == pytest.approx(row.score.value - 100.0, abs=1e-9)
    before, after = (next(s for s in r.summaries if s.name == "deloaded-10") for r in (results, failed))
    assert after.points_by_term["rest"] < before.points_by_term["rest"] - 10.0
    reference = next(s for s in results.summaries if s.name == "coordinated-piecewise")
    assert set(reference.points_by_term.values()) == {0.0}


def test_table_says_who_sees_the_grid() -> None:
    entry = Entry(name="sees all", strategy="deloaded-10", observation_mode="privileged")
    rows = leaderboard_rows(evaluate([entry], "standard", "test", seeds=(20_002, 20_000), duration_s=10.0))
    kinds = dict(table_cells(rows, ("entry", "kind")))
    assert kinds == {"coordinated-piecewise": "law", "mppt": "law", "sees all": "law, privileged"}


def test_table_of_v1_shows_failures_by_kind_the_worst_tenth_and_deviations(results_v1: Results) -> None:
    reasons = ("stall", "frequency limit", "under-speed", "loss of synchronism")
    episodes = [
        dataclasses.replace(e, failure=reasons[e.seed - 10_000])
        if e.entry == "fast-droop" and e.seed < 10_000 + len(reasons)
        else dataclasses.replace(e, failure="")
        for e in results_v1.episodes
    ]
    failed = dataclasses.replace(results_v1, episodes=tuple(episodes))
    row = next(row for row in failed.summaries if row.name == "fast-droop")
    assert row.failures_percent_by_kind == pytest.approx({"frequency": 100 / 12, "rotor": 200 / 12, "other": 100 / 12})
    own = failed.episodes_of("fast-droop")
    worst = sorted(pinned(episode, failed.settings["weights"]["cap"]) for episode in own)[-2:]
    assert row.worst_decile_cost == pytest.approx(np.mean(worst)) and worst[0] == 15.0 * 31.0
    deviations = [1e3 * max(50.0 - e.metrics["nadir_hz"], e.metrics["zenith_hz"] - 50.0) for e in own]
    assert row.median_deviation_mhz == pytest.approx(np.median(deviations))
    assert row.p95_deviation_mhz == pytest.approx(np.percentile(deviations, 95.0))
    cells = dict(zip(short_columns_of("v1"), table_cells([row], short_columns_of("v1"))[0], strict=True))
    assert cells["failures by kind [%]"] == "33.3 (f 8.3, ω 16.7)"
    assert cells["deviation [mHz]"] == f"{np.median(deviations):.0f}"


def test_each_version_has_its_own_columns(results_v1: Results) -> None:
    rows = leaderboard_rows(results_v1)
    head = markdown_table(rows).split("\n")[0]
    assert [name.strip() for name in head.strip("|").split("|")] == list(short_columns_of("v1"))
    points = [column for column in short_columns_of("v1") if column.endswith("[points]")]
    assert points[0] == "frequency, RoCoF [points]"
    assert {len(cells) for cells in table_cells(rows)} == {len(columns_of("v1"))}
    assert columns_of("v0") == COLUMNS and not {"worst decile", "deviation [mHz]"} & set(COLUMNS)
    for row in rows:
        assert sum(row.points_by_term.values()) == pytest.approx(row.score.value - 100.0, abs=1e-9)
