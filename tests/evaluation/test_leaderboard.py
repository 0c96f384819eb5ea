"""Facts about the ranking."""

from __future__ import annotations

import dataclasses
import itertools

import pytest

from wtg_gym.evaluation import Entry, Results, evaluate, leaderboard_rows, markdown_table, table_cells
from wtg_gym.evaluation.leaderboard import COLUMNS, SHORT_COLUMNS


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
