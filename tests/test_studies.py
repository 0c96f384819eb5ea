"""What docs/studies tunes and plans with: candidates play as entries do."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cma")

from gradient_law import LawLoss
from oracle import V1, find_oracle
from planner import Planning, WindObserver, plan, results_with_planners
from policies import FEEDBACKS, law_of, tune_feedback, write_feedback
from rollouts import Rollouts, course, history_feedback, linear_feedback

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import evaluate, load_entries
from wtg_gym.evaluation.recording import recorded
from wtg_gym.physics.tracking_law import coordinated_piecewise, coordinated_tuned
from wtg_gym.scenarios import get_suite

SUITE, SEEDS = "standard-v1", [10_000, 10_001, 10_002]
QUICK = Planning(horizon_s=5.0, interval_s=5.0, population=8, generations=1)
LINEAR, LINEAR_V1, HISTORY_V1 = FEEDBACKS


@pytest.fixture(scope="module")
def rollouts() -> Rollouts:
    return Rollouts("standard", "validation", SEEDS, 4, duration_s=12.0)


def test_no_gain_and_no_course_cost_what_the_evaluator_says_of_the_reference(rollouts: Rollouts) -> None:
    results = evaluate([], "standard", "validation", seeds=SEEDS, duration_s=12.0)
    reference = rollouts.reference()
    assert rollouts.pinned(reference) == pytest.approx(results.pinned_costs["coordinated-piecewise"][0], rel=1e-12)
    every = np.repeat(reference[:, None], 4, axis=1)
    assert (rollouts.play(linear_feedback(np.zeros((4, 2, rollouts.n_local + 1)))) == every).all()
    assert (rollouts.play(course(np.zeros((3, 4, 16, 2, 2)), rollouts.n_steps)) == every).all()
    paper = coordinated_piecewise()
    assert rollouts.play(laws=[paper] * 4) == pytest.approx(every, rel=1e-12)


@pytest.mark.parametrize("how", [LINEAR, HISTORY_V1], ids=lambda how: how.folder)
def test_a_feedback_costs_the_same_in_the_search_and_as_a_file(how: object, tmp_path: Path) -> None:
    quick = dataclasses.replace(how, n_scenarios=2, generations=1, population=4)  # type: ignore[type-var]
    gains, n_wtg = tune_feedback(quick)
    gains = np.random.default_rng(0).normal(0.0, 0.2, gains.shape)
    write_feedback(quick, gains, n_wtg, tmp_path / "entry")
    (entry,) = load_entries(tmp_path / "entry")
    own = Rollouts(quick.suite, "validation", SEEDS, 1, strategy=quick.strategy, duration_s=12.0)
    act = history_feedback(gains, own.lanes.settings.control_dt) if quick.history else linear_feedback(gains)
    played = evaluate([entry], quick.suite, "validation", seeds=SEEDS, duration_s=12.0).pinned_costs[entry.name][0]
    # The file counts in single precision.
    assert own.pinned(own.play(act))[:, 0] == pytest.approx(played, rel=1e-3)
    assert played != pytest.approx(own.pinned(own.reference()), rel=1e-2)


def test_the_origin_is_the_papers_law_and_the_tuned_law_is_a_point() -> None:
    paper, origin, tuned = coordinated_piecewise(), law_of(np.zeros(4)), coordinated_tuned()
    assert dataclasses.replace(origin, name=paper.name) == paper
    span = paper.k_min - paper.k_max
    point = [(tuned.k_min - paper.k_min) / span, (tuned.k_nominal - paper.k_nominal) / span]
    point += [(paper.k_max - tuned.k_max) / span, math.log(tuned.damping_time_constant_s / 0.8)]
    again = law_of(np.array(point))
    for key in ("k_min", "k_nominal", "k_max", "damping_time_constant_s"):
        assert getattr(again, key) == pytest.approx(getattr(tuned, key))


def test_an_oracle_is_the_least_of_all_it_knows_and_finished_chunks_stay(tmp_path: Path) -> None:
    effort = dataclasses.replace(V1, suite="paper-v1", n_scenarios=1, generations=1)
    costs = find_oracle(effort, ("coordinated-tuned",), tmp_path)
    assert costs.oracle == tuple(map(min, costs.reference, *costs.found.values()))
    parts = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert len(parts) == 2 and find_oracle(effort, ("coordinated-tuned",), tmp_path).found == costs.found
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == parts


def test_the_observer_finds_the_wind_behind_a_wrong_sensor() -> None:
    lanes = TaskLanes(EnvSettings(suite=SUITE, observation_mode="privileged", duration_s=20.0), 1)
    scenario = get_suite(SUITE).scenario(10_000)
    wrong = dataclasses.replace(scenario.sensors, wind_bias=(0.1, -0.1, 0.05, 0.0), wind_noise=0.0)  # type: ignore[type-var]
    wind = np.array([[9.0], [9.5], [8.5], [10.0]])
    calm = {"events": (), "load_noise_mw": np.zeros(0), "wind_speed": wind, "duration_s": 20.0}
    lanes.start([0], [dataclasses.replace(scenario, sensors=wrong, **calm)])
    observer = WindObserver(lanes, Planning(knowledge="measured"))
    for _ in range(199):
        lanes.step(np.zeros((1, lanes.n_action)))
        observer.update()
    assert np.abs(observer._measured()[2][0] / wind[:, 0] - 1.0).max() > 0.09
    # After two of its time constants less than a fifth is left.
    assert np.abs(observer.now[0] / wind[:, 0] - 1.0).max() < 0.025


def test_a_planner_is_a_row_beside_the_anchors_and_its_recording_is_what_is_scored() -> None:
    results = results_with_planners(SUITE, "validation", SEEDS[:1], [QUICK])
    assert results.scores["coordinated-tuned"].value == 100.0
    (episode,) = results.episodes_of("planner-exact")
    settings = EnvSettings(suite=SUITE, split="validation", action_mode="k+tau", observation_mode="privileged")
    lanes = TaskLanes(settings, 1)
    lanes.start([0], lanes.scenarios(SEEDS[:1]))
    assert recorded(lanes, plan(lanes, QUICK)).cost_terms.sum() == pytest.approx(episode.metrics["cost"], rel=1e-12)


def test_the_gradient_of_laws_is_that_of_other_laws_with_their_own_starts() -> None:
    loss = LawLoss("standard", 2)
    points = np.array([[1.0, 0.68, 0.55, -0.3], [1.05, 0.66, 0.5, 0.1]])
    seeds = [1_000_000, 1_000_001]
    _, gradient = loss(points, seeds)
    scenarios = loss.tape.lanes.scenarios(seeds)
    for place in np.ndindex(points.shape):
        step = np.zeros_like(points)
        step[place] = 1e-5
        ends = [loss._loss(loss.laws(points + sign * step), scenarios) for sign in (1.0, -1.0)]
        assert gradient[place] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-5), place
