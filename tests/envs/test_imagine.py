"""Facts about imagined lanes: where nothing surprises, the imagined future is the real one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.scenario import LineTrip, LoadRamp, LoadStep, Scenario
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
SETTINGS = EnvSettings(suite=SUITE, observation_mode="privileged", duration_s=20.0)


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
