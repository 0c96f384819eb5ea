"""The leaderboard's page: its numbers are those of the results."""

import dataclasses
import functools
import html
import json
import re
from typing import Any

import pytest

from tests.evaluation.test_leaderboard import without_scale
from wtg_gym.evaluation import Results, evaluate, leaderboard_rows, load_entries, table_cells
from wtg_gym.evaluation.table import columns_of
from wtg_gym.plotting.page import leaderboard_page
from wtg_gym.tasks import V1

pytest.importorskip("bokeh")

OWN: dict[str, Any] = {"split": "validation", "seeds": range(10_000, 10_009), "duration_s": 60.0}


@functools.cache
def all_results() -> tuple[Results, ...]:
    """Results of both versions; of v0 without a scale too."""
    laws, droop = ["mppt", "deloaded-10"], load_entries("fast-droop", task=V1)
    return (
        evaluate(laws, "standard", **OWN, version="v0"),
        evaluate([*laws, *droop], "standard-v1", **OWN),
        without_scale(evaluate("deloaded-10", "paper", "validation")),
    )


def sources(page: str) -> list[dict[str, list[Any]]]:
    """Return the columns of every table's data in a page."""
    (text,) = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.DOTALL)
    found: list[dict[str, list[Any]]] = []
    stack = [json.loads(html.unescape(text))]
    while stack:
        item = stack.pop()
        if isinstance(item, dict):
            if item.get("name") == "ColumnDataSource":
                found.append(dict(item["attributes"]["data"]["entries"]))
            stack += item.values()
        elif isinstance(item, list):
            stack += item
    return found


def test_the_numbers_are_those_of_the_results():
    results = all_results()
    shown = sources(leaderboard_page(results))
    ranked = [each for each in results if each.has_scale]
    for each in ranked:
        rows = leaderboard_rows(each)
        (own,) = [data for data in shown if data.get("score_value") == [row.score.value for row in rows]]
        for head, cells in zip(columns_of("whole", rows), zip(*table_cells(rows), strict=True), strict=True):
            assert own[head] == list(cells), head
        assert own["lost_or_beyond"] == [row.lost_or_beyond_percent for row in rows]
        assert own["deviation"] == [row.median_deviation_mhz for row in rows]
    assert len([data for data in shown if "score_value" in data]) == len(ranked) == 2


def test_what_cannot_be_ranked_and_what_is_given_twice_is_refused():
    of_v0, own, without_scale = all_results()
    for results in ([], [without_scale]):
        with pytest.raises(ValueError, match="results with a score"):
            leaderboard_page(results)
    changed = dataclasses.replace(own, suite_hash="0" * 64)
    with pytest.raises(ValueError, match=f"'standard-v1' with the hash {'0' * 12}.* is {own.suite_hash[:12]} here"):
        leaderboard_page([of_v0, changed])
    with pytest.raises(ValueError, match="standard-v1-validation"):
        leaderboard_page([own, own])
