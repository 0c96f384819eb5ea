"""Planners: where nothing surprises, the imagined future is the real one; and what they estimate and write."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import planner
import pytest
from planner import Planning, WindObserver, results_with_planners

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Results
from wtg_gym.evaluation.recording import recorded
from wtg_gym.physics.scenario import LineTrip, LoadRamp, LoadStep, Scenario
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
SETTINGS = EnvSettings(suite=SUITE, observation_mode="privileged", duration_s=20.0)
QUICK = Planning(horizon_s=5.0, interval_s=5.0, population=8, generations=1)


def scenario(*events: Any, wind: Any = ((9.0,), (9.5,), (8.5,), (10.0,))) -> Scenario:
    own = get_suite(SUITE).scenario(10_000)
    steady = dataclasses.replace(own, wind_speed=np.asarray(wind, dtype=float), load_noise_mw=np.zeros(0))
    return dataclasses.replace(steady, duration_s=20.0, events=events, name="x")


def started(n_lanes: int, *scenarios: Scenario) -> TaskLanes:
    lanes = TaskLanes(SETTINGS, n_lanes, 1)
    if scenarios:
        lanes.start(range(n_lanes), list(scenarios))
    return lanes


def actions(lanes: TaskLanes, step: int) -> Any:
    one = np.random.default_rng(step).uniform(-0.4, 0.4, lanes.n_action)
    return np.tile(one, (lanes.n_lanes, 1))


def test_where_nothing_surprises_the_imagined_future_is_the_real_one_to_the_bit() -> None:
    # What has begun goes on: a ramp, an open line that closes again.
    begun = (
        LoadStep(time_s=1.0, bus=3, power_mw=20.0),
        LoadRamp(time_s=2.0, bus=4, power_mw=10.0, duration_s=6.0),
        LineTrip(time_s=3.0, from_bus=2, to_bus=4, recloses_after_s=4.0),
    )
    wind = 9.0 + 0.01 * np.arange(4 * 201).reshape(4, 201) % 2.0
    lanes, imagined = started(2, scenario(*begun, wind=wind), scenario(wind=wind)), started(3)
    for step in range(50):
        lanes.step(actions(lanes, step))
    source = np.array([1, 0, 0])
    ahead = np.repeat(wind[np.newaxis, :, 50:], 3, axis=0)
    imagined.imagine(lanes, source, ahead)
    assert (imagined.observations == lanes.observations[source]).all()
    for step in range(50, 200):
        lanes.step(actions(lanes, step))
        imagined.step(actions(imagined, step))
        assert (imagined.observations == lanes.observations[source]).all(), step
        assert (imagined.rewards == lanes.rewards[source]).all(), step
    assert (imagined.cost_sums() == lanes.cost_sums()[source]).all()
    assert imagined.ended()[1].all()


def test_what_has_not_struck_yet_is_forgotten_and_does_not_reach_the_real_episode() -> None:
    late = LoadStep(time_s=6.0, bus=3, power_mw=30.0)
    lanes, calm, imagined = started(1, scenario(late)), started(1, scenario()), started(2)
    for step in range(60):
        lanes.step(actions(lanes, step))
        calm.step(actions(calm, step))
    wind = np.repeat(lanes.simulator.wtg_values("wind")[:, :, np.newaxis], 2, axis=0)
    imagined.imagine(lanes, np.zeros(2, dtype=np.int64), wind)
    for step in range(60, 120):
        lanes.step(actions(lanes, step))
        calm.step(actions(calm, step))
        imagined.step(actions(imagined, step))
    coi = [own.simulator.lane_values("coi") for own in (lanes, calm, imagined)]
    assert coi[2] == pytest.approx(np.repeat(coi[1], 2), abs=1e-12)
    assert coi[0][0] < coi[1][0] - 1e-3


def test_lanes_of_another_plant_and_wrong_shapes_are_refused() -> None:
    lanes, wind = started(1, scenario()), np.full((2, 4, 3), 9.0)
    other = TaskLanes(EnvSettings(suite="low-share-v1", observation_mode="privileged", duration_s=20.0), 2, 1)
    with pytest.raises(ValueError, match="same settings"):
        other.imagine(lanes, np.zeros(2, dtype=np.int64), wind)
    imagined = started(2)
    with pytest.raises(ValueError, match=r"a lane for each of 2 lanes .* got shapes \(1,\) and \(2, 4, 3\)"):
        imagined.imagine(lanes, np.zeros(1, dtype=np.int64), wind)


def test_the_observer_finds_the_wind_behind_a_wrong_sensor() -> None:
    wrong = dataclasses.replace(
        get_suite(SUITE).scenario(10_000).sensors,  # type: ignore[type-var]
        wind_bias=(0.1, -0.1, 0.05, 0.0),
        wind_noise=0.0,
    )
    lanes = started(1, dataclasses.replace(scenario(), sensors=wrong))
    observer = WindObserver(lanes, Planning(knowledge="measured"))
    for _ in range(199):
        lanes.step(np.zeros((1, lanes.n_action)))
        observer.update()
    real = lanes.simulator.wtg_values("wind")[0]
    seen = observer._measured()[2][0]
    assert np.abs(seen / real - 1.0).max() > 0.09
    # After two of its time constants less than a fifth is left.
    assert np.abs(observer.now[0] / real - 1.0).max() < 0.025
    assert observer.expected(5).shape == (1, 4, 6)


def test_planners_are_rows_beside_the_anchors_and_play_the_same_twice(tmp_path: Path) -> None:
    seeds = [10_000, 10_003]
    runs = [results_with_planners(SUITE, "validation", seeds, [QUICK], n_threads=n) for n in (1, 2)]
    assert runs[0].pinned_costs["planner-exact"].tolist() == runs[1].pinned_costs["planner-exact"].tolist()
    runs[0].write(tmp_path)
    again = Results.read(tmp_path / f"{SUITE}-validation.json")
    assert again.scores["planner-exact"] == runs[0].scores["planner-exact"]
    assert again.scores["coordinated-tuned"].value == 100.0


def test_a_recorded_planner_plays_as_a_scored_one() -> None:
    settings = EnvSettings(suite=SUITE, split="validation", action_mode="k+tau", observation_mode="privileged")
    (episode,) = planner.played_by_planner(SUITE, "validation", [10_000], QUICK, 1)
    lanes = TaskLanes(settings, 1, 1)
    lanes.start([0], lanes.scenarios([10_000]))
    recording = recorded(lanes, planner.plan(lanes, QUICK, 1))
    assert recording.cost_terms.sum() == pytest.approx(episode.metrics["cost"], rel=1e-12)
    assert recording.time_s[-1] == 60.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"knowledge": "all"}, "unknown knowledge 'all'; choose one of exact, measured"),
        ({"interval_s": 31.0}, r"interval_s = 31 s is outside the allowed range 0.1 … 30 s"),
        ({"population": 2}, "population = 2 is outside"),
        ({"n_knots": 1}, "n_knots = 1 is outside"),
    ],
)
def test_impossible_efforts_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Planning(**change)


def test_a_suite_without_sensors_is_refused() -> None:
    with pytest.raises(ValueError, match="version v1"):
        planner.played_by_planner("standard", "validation", [10_000], QUICK)


@pytest.mark.parametrize("n", ["0", "-3", "201"])
def test_number_of_scenarios_is_checked(n: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert planner.main(["--scenarios", n, "--output", str(tmp_path)]) == 2
    assert f"--scenarios = {n} is outside the allowed range 1 … 200" in capsys.readouterr().err
