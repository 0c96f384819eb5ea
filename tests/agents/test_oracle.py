"""The searches for headroom: what they play, and what they say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cma")

from agents.oracle import N_KNOTS, POPULATION, Rollouts, knots, linear_feedback, main
from wtg_gym.envs.task import N_LOCAL
from wtg_gym.evaluation import Entry, evaluate

SEEDS = [10_000, 10_001, 10_002]


@pytest.fixture(scope="module")
def rollouts() -> Rollouts:
    return Rollouts("standard", "validation", SEEDS, POPULATION, duration_s=12.0)


def test_reference_costs_what_the_evaluator_says(rollouts: Rollouts) -> None:
    results = evaluate(
        [Entry(name="coordinated-piecewise", strategy="coordinated-piecewise")],
        "standard",
        "validation",
        seeds=SEEDS,
        duration_s=12.0,
    )
    costs = [e.metrics["cost"] for e in results.episodes if e.entry == "coordinated-piecewise"]
    assert rollouts.reference().sum(axis=-1) == pytest.approx(costs, rel=1e-12)


def test_no_gain_and_no_course_is_the_reference(rollouts: Rollouts) -> None:
    gains = np.zeros((POPULATION, rollouts.n_action, N_LOCAL + 1))
    course = np.zeros((len(SEEDS), POPULATION, N_KNOTS, 2, rollouts.n_action))
    reference = np.repeat(rollouts.reference()[:, None], POPULATION, axis=1)
    assert (rollouts.play(linear_feedback(gains)) == reference).all()
    assert (rollouts.play(knots(course, rollouts.n_steps)) == reference).all()


def test_candidates_do_not_disturb_each_other(rollouts: Rollouts) -> None:
    gains = np.random.default_rng(0).normal(0.0, 0.3, (POPULATION, rollouts.n_action, N_LOCAL + 1))
    together = rollouts.play(linear_feedback(gains))
    alone = Rollouts("standard", "validation", SEEDS, 1, duration_s=12.0).play(linear_feedback(gains[5:6]))
    assert together[:, 5] == pytest.approx(alone[:, 0], rel=1e-9)
    assert np.unique(together.sum(axis=-1)).size == together[..., 0].size


def test_knots_are_met_and_joined_by_straight_lines() -> None:
    values = np.arange(4.0).reshape(1, 1, 4, 1, 1) ** 2
    act = knots(values, 7)
    assert [float(act(step, np.empty(0)).item()) for step in range(7)] == [0.0, 0.5, 1.0, 2.5, 4.0, 6.5, 9.0]


def test_both_searches_run_as_commands(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    gains = tmp_path / "linear.json"
    common = ["--suite", "paper", "--generations", "2", "--action-mode", "k"]
    assert main(["linear", *common, "--scenarios", "2", "--output", str(gains)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert np.array(found["gains"]).shape == (1, N_LOCAL + 1) and json.loads(gains.read_text()) == found
    assert main(["foresight", *common, "--scenarios", "1", "--gains", str(gains)]) == 0
    oracle = json.loads(capsys.readouterr().out)
    assert oracle["seeds"] == [0] and oracle["oracle"][0] <= oracle["reference"][0]
    assert set(oracle["mean_by_form"]) == {"course", "course and feedback"}


@pytest.mark.parametrize("option", ["--scenarios", "--generations"])
def test_impossible_numbers_are_refused(option: str) -> None:
    with pytest.raises(SystemExit, match=f"{option} = 0 is outside the allowed range 1 … 100000"):
        main(["linear", option, "0"])
