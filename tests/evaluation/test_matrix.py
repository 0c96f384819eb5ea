"""Facts about the matrix of suites and sensors."""

from __future__ import annotations

import json

import pytest

from wtg_gym.evaluation import Entry, Results, evaluate, leaderboard_rows, load_entries
from wtg_gym.evaluation.matrix import PERTURBATIONS, changed_sensors, matrix_of, score_text
from wtg_gym.scenarios import get_suite

SEEDS = range(10_000, 10_012)
SHORT = {"split": "validation", "seeds": SEEDS, "duration_s": 30.0}
OWN = get_suite("standard-v1").sensors
assert OWN is not None


@pytest.fixture(scope="module")
def entries() -> list[Entry]:
    return [Entry(name="deloaded-5", strategy="deloaded-5"), *load_entries("fast-droop")]


@pytest.fixture(scope="module")
def usual(entries: list[Entry]) -> Results:
    return evaluate(entries, "standard-v1", **SHORT)


@pytest.fixture(scope="module")
def perturbed(entries: list[Entry]) -> dict[str, Results]:
    return {
        name: evaluate(entries, "standard-v1", **SHORT, sensors=change(OWN)) for name, change in PERTURBATIONS.items()
    }


def test_sensors_reach_policies_and_no_law_so_that_one_scale_does_for_all(
    usual: Results, perturbed: dict[str, Results]
) -> None:
    for results in perturbed.values():
        for law in ("deloaded-5", *usual.benchmark.anchors):
            assert results.episodes_of(law) == usual.episodes_of(law)
    for name in ("delay-plus-1", "delay-plus-2"):
        assert perturbed[name].episodes_of("fast-droop") != usual.episodes_of("fast-droop")
    # The droop does not look at the wind.
    assert perturbed["wind-bias-times-2"].episodes_of("fast-droop") == usual.episodes_of("fast-droop")


def test_columns_are_in_the_order_of_suites_with_changed_sensors_last(
    usual: Results, perturbed: dict[str, Results]
) -> None:
    other = evaluate([], "low-share-v1", **SHORT)
    matrix = matrix_of([*reversed(perturbed.values()), other, usual])
    assert matrix.header()[1:3] == ["standard", "low-share"]
    assert sorted(matrix.header()[3:]) == [
        "standard, delay +0.1 s",
        "standard, delay +0.2 s",
        "standard, wind bias × 2",
    ]
    # Where the other suite was played without them, entries have no cell.
    (droop,) = [row for row in matrix.rows if row.name == "fast-droop"]
    assert droop.cells[1] is None and matrix.texts(score_text)[matrix.rows.index(droop)][2] == ""


def test_cells_are_the_scores_and_worst_deciles_of_the_results(usual: Results, perturbed: dict[str, Results]) -> None:
    results = [usual, *perturbed.values()]
    matrix = matrix_of(results)
    assert [row.name for row in matrix.rows] == [row.name for row in leaderboard_rows(usual)]
    for place, each in enumerate(results):
        for summary in leaderboard_rows(each):
            (row,) = [row for row in matrix.rows if row.name == summary.name]
            cell = row.cells[place]
            assert cell is not None
            assert (cell.score, cell.worst_decile_cost) == (summary.score, summary.worst_decile_cost)
    data = json.loads(json.dumps(matrix.to_dict()))
    assert data["version"] == "v1" and data["columns"][1]["change"] == "delay +0.1 s"
    page = matrix.page()
    assert page.startswith("Scores on 12 validation scenarios per column. Sensors do not affect the laws that")
    assert page.count("| entry | standard | standard, delay +0.1 s |") == 1


def test_scenarios_without_a_scale_have_costs_and_no_scores(usual: Results) -> None:
    paper = evaluate([], "paper-v1", "validation")
    assert usual.has_scale and not paper.has_scale
    matrix = matrix_of([usual, paper])
    for row in matrix.rows:
        cell = row.cells[1]
        if row.name in paper.benchmark.anchors:
            assert cell is not None and cell.score is None
            assert cell.worst_decile_cost == paper.pinned_costs[row.name].max()
    assert matrix.describe() == (
        "12 validation scenarios per column; 2 validation scenarios on paper. "
        "No score on paper, where coordinated-tuned (100) is no better than coordinated-piecewise (0)."
    )


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        (None, ""),
        ({}, ""),
        ("exact", "exact sensors"),
        ({"delay_s": (0.1, 0.5)}, "delay 0.1 … 0.5 s"),
        ({"delay_s": (0.0, 0.2)}, "delay -0.1 s"),
        ({"wind_sensor": False}, "wind sensor False"),
        ({"wind_noise": 0.04, "power_noise_pu": 0.02}, "power noise pu × 2, wind noise × 0.5"),
    ],
)
def test_other_sensors_are_said_in_words(sensors: object, said: str) -> None:
    results = evaluate([], "standard-v1", "validation", seeds=SEEDS[:1], duration_s=1.0, sensors=sensors)
    assert changed_sensors(results) == said


def test_results_that_make_no_matrix_are_refused(usual: Results) -> None:
    with pytest.raises(ValueError, match="one version of the benchmark, got none"):
        matrix_of([])
    with pytest.raises(ValueError, match="given twice: standard"):
        matrix_of([usual, usual])
    with pytest.raises(ValueError, match="one version of the benchmark, got v0, v1"):
        matrix_of([usual, evaluate([], "paper", "test")])
