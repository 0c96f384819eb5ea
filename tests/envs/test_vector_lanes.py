"""Every lane of a batch is a single environment of its own."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.envs import rollouts
from wtg_gym import GFMWTGEnv, GFMWTGVectorEnv, GroupTrip, LoadStep
from wtg_gym.scenarios import SUITES
from wtg_gym.scenarios.draws import SensorDistribution

ROOT = Path(__file__).resolve().parents[2]


SUITES_V1 = [name for name, suite in SUITES.items() if suite.task.version == "v1"]


@pytest.mark.parametrize("suite", SUITES_V1)
def test_lane_of_version_v1_equals_the_single_environment_in_every_suite_and_mode(suite):
    for seed, action_mode in enumerate(rollouts.ACTION_MODES):
        observation_mode = rollouts.OBSERVATION_MODES[seed % 2]
        mode = rollouts.MODES[seed % 3]
        settings = {"suite": suite, "action_mode": action_mode, "observation_mode": observation_mode}
        env = GFMWTGVectorEnv(17, duration_s=2.5, autoreset_mode=mode, n_threads=1 + seed % 2, **settings)
        actions = rollouts.actions_of(seed, 60, 17, env.single_action_space.shape[0])
        lanes = rollouts.vector_steps(env, actions, seed=seed)
        env.close()
        single = GFMWTGEnv(duration_s=2.5, **settings)
        for lane in (0, 11, 16):
            assert lanes[lane] == rollouts.single_steps(single, actions[:, lane], mode, seed=seed + lane)
            assert rollouts.n_resets(lanes[lane]) >= 2


def failing(version: str):
    if version == "v0":
        return {"version": "v0", "strategy": "mppt", "scenario": rollouts.sagging(7.6, 45.0).to_dict()}
    events = (GroupTrip(time_s=1.025, group=2), LoadStep(time_s=2.0, bus=3, power_mw=40.0))
    sensors = SensorDistribution().draw_many("x", [1], 4)[0]
    course = rollouts.calm(8.0, 30.0, 4, events=events, sensors=sensors, inertia_scale=0.3, governor_droop=0.08)
    settings = {"version": "v1", "control_dt": 0.1, "strategy": "mppt", "on_failure": "terminate"}
    return {**settings, "scenario": course.to_dict()}


@pytest.mark.parametrize(("version", "n_steps", "reason"), [("v0", 420, "stall"), ("v1", 200, "under-speed")])
@pytest.mark.parametrize("mode", rollouts.MODES)
def test_lane_equals_the_single_environment_where_lanes_end_at_different_times(mode, version, n_steps, reason):
    settings, n_lanes = failing(version), 17
    actions = np.repeat(np.linspace(-1.0, 1.0, n_lanes)[None, :, None], n_steps, axis=0).repeat(
        2 * rollouts.N_WTG[version], 2
    )
    lanes = rollouts.vector_steps(GFMWTGVectorEnv(n_lanes, autoreset_mode=mode, **settings), actions, seed=0)
    single = GFMWTGEnv(**settings)
    for lane, steps in enumerate(lanes):
        assert steps == rollouts.single_steps(single, actions[:, lane], mode, seed=lane), f"lane {lane}"
    ends = {tuple(i for i, step in enumerate(steps) if step[2]) for steps in lanes}
    assert len(ends) > 5 and rollouts.reasons(lanes[-1]) == {reason}


@pytest.mark.parametrize("version", rollouts.VERSIONS)
@pytest.mark.parametrize("mode", rollouts.MODES)
def test_lane_plays_its_own_scenario_and_then_draws(mode, version):
    n, n_wtg = 5, rollouts.N_WTG[version]
    actions = rollouts.actions_of(6, 70, n, 2 * n_wtg)
    scenarios = [rollouts.eventful(7.0 + lane, duration_s=2.0 + 0.5 * lane, n_wtg=n_wtg) for lane in range(n)]
    env = GFMWTGVectorEnv(n, version=version, duration_s=4.0, autoreset_mode=mode)
    lanes = rollouts.vector_steps(env, actions, seed=9, start={"scenarios": scenarios})
    for lane, steps in enumerate(lanes):
        single, start = GFMWTGEnv(version=version, duration_s=4.0), {"scenario": scenarios[lane]}
        assert steps == rollouts.single_steps(single, actions[:, lane], mode, seed=9 + lane, start=start)
        assert rollouts.n_resets(steps) >= 1


def test_another_process_finds_the_same_bits():
    calls = "digest(17), digest(1), digest(17, version='v1')"
    code = f"from tests.envs.rollouts import digest; print({calls})"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == [rollouts.digest(17), rollouts.digest(1), rollouts.digest(17, version="v1")]


def test_returned_arrays_are_not_overwritten_by_later_steps():
    env = GFMWTGVectorEnv(3, duration_s=2.0, autoreset_mode="SameStep", version="v0")
    first = env.reset(seed=0)
    kept = [first, *(env.step(action) for action in rollouts.actions_of(12, 25, 3))]
    copies = repr(kept)
    for action in rollouts.actions_of(13, 25, 3):
        env.step(action)
    assert repr(kept) == copies
    env = GFMWTGEnv(duration_s=2.0, version="v0")
    observation, info = env.reset(seed=0)
    before = observation.tobytes(), dict(info)
    env.step(np.ones(4))
    assert (observation.tobytes(), info) == before
