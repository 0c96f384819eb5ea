"""Facts about the ranking."""

from __future__ import annotations

import dataclasses

from wtg_gym.evaluation import Entry, Results, evaluate, leaderboard_rows, markdown_table, table_cells


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
    assert lines[2].startswith("| 1 | coordinated-piecewise | law | 100.0 (100.0 … 100.0) | 100.0 | 0.50 |")
    assert "-0.0" not in markdown_table(leaderboard_rows(results)).replace("-0.0 …", "")


def test_table_says_who_sees_the_grid() -> None:
    entry = Entry(name="sees all", strategy="deloaded-10", observation_mode="privileged")
    rows = leaderboard_rows(evaluate([entry], "standard", seeds=(20_002, 20_000), duration_s=10.0))
    kinds = {cells[1]: cells[2] for cells in table_cells(rows)}
    assert kinds == {"coordinated-piecewise": "law", "mppt": "law", "sees all": "law, privileged"}
