"""Facts about the ranking and its place in a file."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from wtg_gym.evaluation import Results, leaderboard_rows, markdown_table, update_between_markers

START, END = "<!-- leaderboard:standard:start -->", "<!-- leaderboard:standard:end -->"


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


def test_table_has_a_row_per_entry_and_a_cell_per_column(results: Results) -> None:
    lines = markdown_table(leaderboard_rows(results)).split("\n")
    assert len(lines) == 2 + 3
    assert len({line.count("|") for line in lines}) == 1
    assert lines[2].startswith("| 1 | coordinated-piecewise | law | 100.0 (100.0 … 100.0) | 100.0 | 0.50 |")
    assert "-0.0" not in markdown_table(leaderboard_rows(results)).replace("-0.0 …", "")


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_what_is_between_the_markers_changes(tmp_path: Path, newline: str) -> None:
    path = tmp_path / "README.md"
    path.write_bytes(newline.join(["# Title ä", START, "old", "older", END, "end  "]).encode())
    assert update_between_markers(path, "| a |\n| b |")
    assert path.read_bytes() == newline.join(["# Title ä", START, "| a |", "| b |", END, "end  "]).encode()
    assert not update_between_markers(path, "| a |\n| b |")


@pytest.mark.parametrize("text", ["", START, END, f"{END}\n{START}", f"{START}\n{START}\n{END}"])
def test_missing_markers_are_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "README.md"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"README.md must have the markers <!-- leaderboard:standard:start --> and"):
        update_between_markers(path, "table")
    assert path.read_text() == text


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.md"):
        update_between_markers(tmp_path / "nowhere.md", "table")


def test_permissions_and_links_survive(tmp_path: Path) -> None:
    path, link = tmp_path / "README.md", tmp_path / "link.md"
    path.write_text(f"{START}\n{END}\n")
    path.chmod(0o640)
    link.symlink_to(path)
    update_between_markers(link, "table")
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o640
    assert "table" in path.read_text()
