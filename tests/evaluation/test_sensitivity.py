"""Facts about how the ranking depends on the weights."""

from __future__ import annotations

import dataclasses
import math

import pytest

from wtg_gym.evaluation import Entry, evaluate, leaderboard_rows
from wtg_gym.evaluation.sensitivity import WEIGHTS, Sensitivity, compared, study_sensitivity
from wtg_gym.scenarios.benchmark import V0

ENTRIES = [Entry(name=name, strategy=name) for name in ("deloaded-5", "coordinated-linear")]


@pytest.fixture
def study() -> Sensitivity:
    """One made by hand."""
    before = {"a": 110.0, "coordinated-piecewise": 100.0, "b": 90.0, "mppt": 0.0}
    variants = (
        compared(
            "duty", 0.0, before, {"b": 111.0, "a": 108.0, "coordinated-piecewise": 100.0, "mppt": 0.0}, V0.anchors
        ),
        compared("duty", 2.0, before, {"a": 110.9, "coordinated-piecewise": 100.0, "b": 89.1, "mppt": 0.0}, V0.anchors),
        compared(
            "effort", 0.0, before, {"a": 110.0, "coordinated-piecewise": 100.0, "b": 90.9, "mppt": 0.0}, V0.anchors
        ),
        compared("rotor", 0.0, before, {}, V0.anchors),
    )
    return Sensitivity(
        suite="standard",
        split="validation",
        suite_hash="0" * 64,
        n_scenarios=7,
        weights={"duty": 2.0},
        scores=before,
        variants=variants,
    )


def test_changes_ranks_and_idle_weights_are_those_counted_by_hand(study: Sensitivity) -> None:
    without, twice, _, rotor = study.variants
    assert without.changes == {"b": 21.0, "a": -2.0}
    assert twice.changes == {"a": pytest.approx(0.9), "b": pytest.approx(-0.9)}
    assert without.ranks == {"b": (3, 1), "a": (1, 2), "coordinated-piecewise": (2, 3)}
    assert twice.ranks == {}
    assert [variant.matters for variant in study.variants] == [True, False, False, True]
    assert rotor.changes == {} and rotor.ranks == {}
    assert study.idle == ["effort"]
    # With twice the duty nothing moves, but without it the order does; without rotor there is nothing to order by.
    assert study.ordering == ["duty", "rotor"]
    assert dataclasses.replace(study, variants=study.variants[1:3]).describe() == (
        "No weight changes the order. Weights that change neither the order nor a score by a point: duty, effort."
    )


def test_table_says_it_in_words(study: Sensitivity) -> None:
    assert [variant.cells() for variant in study.variants] == [
        ["duty", "0", "changes: b 3 → 1, a 1 → 2, coordinated-piecewise 2 → 3", "b +21.0, a -2.0"],
        ["duty", "2", "same", "none"],
        ["effort", "0", "same", "none"],
        ["rotor", "0", "no score: the entry at 0 is not worse than that at 100", ""],
    ]
    all_matter = dataclasses.replace(study, variants=study.variants[:1])
    assert all_matter.describe_idle() == "Every weight changes the order or a score by a point, or leaves no score."
    assert study.describe_idle() == "Weights that change neither the order nor a score by a point: effort."
    page = study.page()
    assert page.startswith("Scores on 7 validation scenarios of `standard` with the usual weights: a 110.0, ")
    assert (
        page.endswith(f"\n\nWeights that change the order: duty, rotor. {study.describe_idle()}")
        and "| duty | 2 | same | none |" in page
    )


def test_variants_are_evaluations_with_that_weight() -> None:
    told: list[tuple[int, int]] = []
    study = study_sensitivity(
        ENTRIES,
        "standard",
        n_scenarios=3,
        weights=["duty", "overload"],
        factors=[0.5],
        on_progress=lambda _name, done, total: told.append((done, total)),
    )
    seeds = range(10_000, 10_003)
    for scores, weights in (
        (study.scores, {}),
        (study.variants[0].scores, {"duty": 1.0}),
        (study.variants[1].scores, {"overload": 5.0}),
    ):
        rows = leaderboard_rows(evaluate(ENTRIES, "standard", "validation", seeds=seeds, weights=weights))
        assert list(scores.items()) == [(row.name, row.score.value) for row in rows]
    assert study.idle == ["overload"] and study.variants[0].matters
    # Four entries on three scenarios, three times.
    assert told == [(3 * n, 36) for n in range(1, 13)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"weights": ["mass"]}, "weights must be different ones out of frequency, rocof"),
        ({"weights": ["cap"]}, "weights must be different ones"),
        ({"weights": ["duty", "duty"]}, "weights must be different ones"),
        ({"weights": []}, "weights must be different ones"),
        ({"factors": [1.0]}, "factors must be different numbers other than 1"),
        ({"factors": [2.0, 2.0]}, "factors must be different numbers"),
        ({"factors": []}, "factors must be different numbers"),
        ({"factors": [-1.0]}, "a factor = -1 is outside the allowed range 0 … 1000"),
        ({"factors": [math.nan]}, "a factor"),
        ({"n_scenarios": 0}, "scenarios = 0 is outside the allowed range 1 … 100"),
        ({"n_scenarios": 101}, "scenarios = 101 is outside the allowed range 1 … 100"),
        ({"suite": "storm"}, "unknown suite 'storm'"),
    ],
)
def test_impossible_arguments_are_refused(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        study_sensitivity(ENTRIES, **{"suite": "standard", **arguments})  # type: ignore[arg-type]


def test_all_weights_but_the_cap_are_varied() -> None:
    assert WEIGHTS == ("frequency", "rocof", "duty", "rotor", "overload", "effort")


def test_weights_as_they_are_are_those_of_the_version() -> None:
    study = study_sensitivity([], "standard-v1", n_scenarios=12, weights=("frequency",), factors=(2.0,))
    assert (study.weights["rotor"], study.weights["cap"]) == (20.0, 15.0)
    assert set(study.scores) == {"coordinated-piecewise", "coordinated-tuned"} and study.variants[0].changes == {}
