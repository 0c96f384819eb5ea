"""Every lane of a batch is a single environment of its own.

Lanes are compared with single environments while their neighbours have other actions, scenarios and ends: so no lane
depends on another.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import (
    MODES,
    actions_of,
    digest,
    eventful,
    n_resets,
    reasons,
    sagging,
    single_steps,
    vector_steps,
)
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv

ROOT = Path(__file__).resolve().parents[2]
SEED = 40
N_STEPS = 50


@cache
def singles(mode: AutoresetMode) -> list[list]:
    """The rollouts of 33 single environments with neighbouring seeds."""
    actions = actions_of(3, N_STEPS, 33)
    env = GFMWTGEnv(duration_s=2.0)
    return [single_steps(env, actions[:, lane], mode, seed=SEED + lane) for lane in range(33)]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("n_lanes", [1, 5, 33])
def test_lane_equals_the_single_environment_with_its_seed_through_resets(n_lanes: int, mode: AutoresetMode):
    env = GFMWTGVectorEnv(n_lanes, duration_s=2.0, autoreset_mode=mode)
    lanes = vector_steps(env, actions_of(3, N_STEPS, 33)[:, :n_lanes], seed=SEED)
    for lane, steps in enumerate(lanes):
        assert n_resets(steps) == 2
        assert steps == singles(mode)[lane], f"lane {lane} of {n_lanes}"


@pytest.mark.parametrize("mode", MODES)
def test_lane_equals_the_single_environment_where_lanes_end_at_different_times(mode: AutoresetMode):
    n, n_steps = 17, 420
    settings = {"strategy": "mppt", "scenario": sagging(7.6, 45.0).to_dict()}
    actions = np.repeat(np.linspace(-1.0, 1.0, n)[None, :, None], n_steps, axis=0).repeat(4, axis=2)
    env = GFMWTGVectorEnv(n, autoreset_mode=mode, **settings)
    lanes = vector_steps(env, actions, seed=0)
    single = GFMWTGEnv(**settings)
    for lane, steps in enumerate(lanes):
        assert steps == single_steps(single, actions[:, lane], mode, seed=lane), f"lane {lane}"
    ends = {tuple(i for i, step in enumerate(steps) if step[2]) for steps in lanes}
    assert len(ends) > 5 and reasons(lanes[-1]) == {"stall"}


@pytest.mark.parametrize("settings", [{"observation_mode": "privileged"}, {"action_mode": "k"}, {"suite": "weak-grid"}])
def test_lane_equals_the_single_environment_in_other_settings(settings: dict):
    n_action = 2 if "action_mode" in settings else 4
    actions = actions_of(4, 30, 5, n_action)
    env = GFMWTGVectorEnv(5, duration_s=2.0, **settings)
    lanes = vector_steps(env, actions, seed=1)
    for lane, steps in enumerate(lanes):
        single = GFMWTGEnv(duration_s=2.0, **settings)
        assert steps == single_steps(single, actions[:, lane], AutoresetMode.NEXT_STEP, seed=1 + lane)


@pytest.mark.parametrize("mode", MODES)
def test_lane_plays_its_own_scenario_and_then_draws(mode: AutoresetMode):
    n = 5
    actions = actions_of(6, 70, n)
    scenarios = [eventful(7.0 + lane, duration_s=2.0 + 0.5 * lane) for lane in range(n)]
    env = GFMWTGVectorEnv(n, duration_s=4.0, autoreset_mode=mode)
    lanes = vector_steps(env, actions, seed=9, start={"scenarios": scenarios})
    for lane, steps in enumerate(lanes):
        single, start = GFMWTGEnv(duration_s=4.0), {"scenario": scenarios[lane].to_dict()}
        assert steps == single_steps(single, actions[:, lane], mode, seed=9 + lane, start=start)
        assert n_resets(steps) >= 1


def test_results_do_not_depend_on_the_number_of_threads():
    assert len({digest(200, n_threads=n_threads) for n_threads in (1, 3, None)}) == 1


def test_another_process_finds_the_same_bits():
    code = "from tests.envs.rollouts import digest; print(digest(17), digest(1))"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == [digest(17), digest(1)]


def test_one_seed_per_lane_is_the_same_as_the_seed_they_count_from():
    one, each = (GFMWTGVectorEnv(3, duration_s=2.0) for _ in range(2))
    assert one.reset(seed=5)[0].tobytes() == each.reset(seed=[5, 6, 7])[0].tobytes()
    assert one.reset(seed=5)[0].tobytes() == each.reset(seed=np.array([5, 6, 7]))[0].tobytes()


def test_reset_mask_restarts_only_its_lanes():
    env, twin = (GFMWTGVectorEnv(5, duration_s=3.0, autoreset_mode="Disabled") for _ in range(2))
    actions = actions_of(11, 20, 5)
    vector_steps(env, actions, seed=1), vector_steps(twin, actions, seed=1)
    mask = np.array([False, True, False, False, True])
    _, infos = env.reset(options={"reset_mask": mask})
    assert infos["_time_s"].tolist() == mask.tolist()
    assert (infos["time_s"][mask] == 0.0).all() and (infos["time_s"][~mask] == 2.0).all()
    after, other = vector_steps(env, actions[:9]), vector_steps(twin, actions[:9])
    for lane in np.flatnonzero(~mask):
        assert after[lane] == other[lane]
    for lane in np.flatnonzero(mask):
        assert after[lane] != other[lane]


def test_returned_arrays_are_not_overwritten_by_later_steps():
    env = GFMWTGVectorEnv(3, duration_s=2.0, autoreset_mode="SameStep")
    first = env.reset(seed=0)
    kept = [first, *(env.step(action) for action in actions_of(12, 25, 3))]
    copies = repr(kept)
    for action in actions_of(13, 25, 3):
        env.step(action)
    assert repr(kept) == copies
    env = GFMWTGEnv(duration_s=2.0)
    observation, info = env.reset(seed=0)
    before = observation.tobytes(), dict(info)
    env.step(np.ones(4))
    assert (observation.tobytes(), info) == before


def test_ended_lane_waits_one_step_in_next_step_mode():
    env = GFMWTGVectorEnv(2, duration_s=3.0)
    env.reset(seed=0, options={"scenarios": [eventful(duration_s=1.0), eventful(duration_s=2.0)]})
    for _ in range(10):
        _, _, terminated, truncated, infos = env.step(np.zeros((2, 4)))
    assert truncated.tolist() == [True, False] and not terminated.any()
    _, rewards, terminated, truncated, infos = env.step(np.ones((2, 4)))
    assert rewards[0] == 0.0 and rewards[1] < 0.0 and not truncated.any() and not terminated.any()
    assert infos["time_s"][0] == 0.0 and infos["time_s"][1] == pytest.approx(1.1)


def test_scenarios_of_lanes_that_go_on_are_not_looked_at():
    env = GFMWTGVectorEnv(2, duration_s=3.0, autoreset_mode="Disabled")
    env.reset(seed=0)
    fits = env.lanes.scenarios([1_000_001])[0]
    misfit = dataclasses.replace(fits, wind_speed=np.full((3, 1), 8.0))
    env.reset(options={"reset_mask": np.array([True, False]), "scenarios": [fits, misfit]})
    with pytest.raises(ValueError, match="wind for 3 WTG groups"):
        env.reset(options={"reset_mask": np.array([False, True]), "scenarios": [fits, misfit]})
