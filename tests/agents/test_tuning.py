"""Tuning for version v1: laws, feedbacks with history, and the conditions of a good suite."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("cma")

from conditions import DROOPS_HZ, LAWS, gathered, judged, table
from conditions import main as conditions
from linear import linear_policy
from rollouts import HISTORY_COLUMNS, Rollouts, history_feedback
from tuned_law import law_of, tune_law

from wtg_gym.evaluation import Entry, OnnxPolicy, evaluate
from wtg_gym.physics.tracking_law import LARGEST_COEFFICIENT, coordinated_piecewise, coordinated_tuned
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
SEEDS = [10_000, 10_001, 10_002]


@given(st.lists(st.floats(-10.0, 10.0), min_size=4, max_size=4))
def test_every_point_is_a_monotone_law(x: list[float]) -> None:
    law = law_of(x)
    assert LARGEST_COEFFICIENT >= law.k_min >= law.k_nominal >= law.k_max > 0.0


def test_the_origin_is_the_papers_law_and_the_tuned_law_is_a_point() -> None:
    paper, origin = coordinated_piecewise(), law_of([0.0, 0.0, 0.0, 0.0])
    assert (origin.k_min, origin.k_nominal, origin.k_max) == (paper.k_min, paper.k_nominal, paper.k_max)
    assert origin.damping_time_constant_s == paper.damping_time_constant_s
    tuned, span = coordinated_tuned(), paper.k_min - paper.k_max
    shares = [(tuned.k_min - paper.k_min) / span, (tuned.k_nominal - paper.k_nominal) / span]
    below = (paper.k_max - tuned.k_max) / span
    again = law_of([*shares, below, math.log(tuned.damping_time_constant_s / paper.damping_time_constant_s)])
    assert (again.k_min, again.k_nominal) == pytest.approx((tuned.k_min, tuned.k_nominal))
    assert again.k_max == pytest.approx(tuned.k_max) and again.damping_time_constant_s == pytest.approx(0.6)


def test_tuning_a_law_is_repeatable_and_lowers_what_it_says() -> None:
    runs = []
    for _ in range(2):
        least: list[float] = []
        runs.append((tune_law(SUITE, 3, 3, 1, lambda done, cost, own=least: own.append(cost), 1)[0], least))
    assert runs[0] == runs[1]
    assert runs[0][1] == sorted(runs[0][1], reverse=True)


def test_a_feedback_with_history_is_the_same_in_the_search_and_as_a_file(tmp_path: Path) -> None:
    rollouts = Rollouts(SUITE, "validation", SEEDS, 1, 1)
    gains = np.random.default_rng(0).normal(0.0, 0.2, (2, rollouts.lanes.n_local + len(HISTORY_COLUMNS) + 1))
    dt = rollouts.lanes.settings.control_dt
    costs = rollouts.pinned(rollouts.play(history_feedback(gains, dt)))[:, 0]
    content = linear_policy(gains, rollouts.n_wtg, history_dt=dt)
    entry = Entry(name="x", policy=OnnxPolicy(content), environment=get_suite(SUITE).benchmark.env_id)
    played = evaluate([entry], SUITE, "validation", seeds=SEEDS).pinned_costs["x"][0]
    # The file counts in single precision.
    assert played == pytest.approx(costs, rel=1e-3)
    slow = gains.copy()
    slow[:, rollouts.lanes.n_local : -1] = 0.0
    assert costs != pytest.approx(rollouts.pinned(rollouts.play(history_feedback(slow, dt)))[:, 0], rel=1e-3)


def test_conditions_say_what_was_not_measured_and_judge_what_was(monkeypatch: pytest.MonkeyPatch) -> None:
    # One droop on each law: none of these conditions is about them.
    monkeypatch.setattr("conditions.DROOPS_HZ", DROOPS_HZ[:1])
    evidence = gathered(SUITE, feedbacks=[], agents=[], oracle=None, planners=None, n_simple=0)
    found = {condition.letter: condition for condition in judged(evidence)}
    assert list(found) == list("abcdefgh")
    assert [letter for letter, condition in found.items() if condition.met is None] == list("bcde")
    rows = {row.name: row for row in evidence.results.summaries}
    zero, hundred = rows["coordinated-piecewise"], rows["coordinated-tuned"]
    assert found["g"].measured == f"{hundred.failures_percent:.1f} %, {zero.failures_percent:.1f} %"
    ends = ("stall", "over-speed", "under-speed")
    lost = [sum(e.failure in ends for e in evidence.results.episodes_of(name)) for name in LAWS]
    assert lost[-1] > 0 and found["h"].met == (lost == sorted(lost))
    text = table(judged(evidence), evidence.results)
    assert "200 validation scenarios" in text and text.count("\n| (") == 8


def test_conditions_refuse_files_of_other_scenarios(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert conditions(["--oracle", "wtg_gym/evaluation/oracle_costs/standard-test.json"]) == 2
    assert "--oracle is of standard/test; standard-v1/validation is needed" in capsys.readouterr().err
    described, _ = evaluate([], SUITE, "validation", seeds=SEEDS).write(tmp_path)
    assert conditions(["--planners", str(described)]) == 2
    assert "--planners holds no planner" in capsys.readouterr().err
