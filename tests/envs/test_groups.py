"""Facts about the number and the place of the WTG groups."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.envs import GFMWTGEnv
from wtg_gym.scenarios import get_suite


def test_any_number_of_groups_starts_and_steps_where_buses_are_shared():
    # Bus 2 holds its voltage with the groups alone: two turbines could not. The number is a constant of the compiled
    # code, without a limit of its own there: more than three groups would take half a minute to compile.
    groups = [{"bus": bus, "n_turbines": 10.0 if bus == 2 else 1.0} for bus in (2, 9, 9)]
    env = GFMWTGEnv(groups=groups, duration_s=2.0, observation_mode="privileged", version="v0")
    observation, _ = env.reset(seed=0)
    assert env.action_space.shape == (6,) and observation.size == len(env.observation_names)
    for step in range(20):
        action = np.random.default_rng(step).uniform(-1.0, 1.0, 6)
        observation, reward, terminated, truncated, _ = env.step(action)
        assert env.observation_space.contains(observation) and np.isfinite(reward)
    assert truncated and not terminated


def test_groups_of_the_same_plant_and_wind_behave_alike():
    scenario = get_suite("paper").scenario(0, n_wtg=2, duration_s=4.0).to_dict()
    scenario["wind_speed"] = [[9.0], [9.0]]
    env = GFMWTGEnv(scenario=scenario, groups=2, version="v0")
    env.reset(seed=0)
    for _ in range(40):
        observation, *_ = env.step(np.array([0.4, -0.2, 0.4, -0.2]))
    assert observation[:10] == pytest.approx(observation[10:].tolist(), abs=1e-6)


def test_two_default_groups_are_the_same_as_writing_them_out():
    spelled = GFMWTGEnv(groups=[{"bus": 2, "n_turbines": 10.0}, {"bus": 2}], duration_s=2.0, version="v0")
    short = GFMWTGEnv(duration_s=2.0, version="v0")
    assert spelled.reset(seed=1)[0].tobytes() == short.reset(seed=1)[0].tobytes()
    assert spelled.step(np.ones(4))[0].tobytes() == short.step(np.ones(4))[0].tobytes()


def test_place_of_a_group_matters():
    near, far = (GFMWTGEnv(groups=[{"bus": 2}, {"bus": bus}], duration_s=4.0, suite="weak-grid") for bus in (2, 14))
    (a, _), (b, _) = near.reset(seed=1), far.reset(seed=1)
    for _ in range(39):
        a, b = near.step(np.ones(4))[0], far.step(np.ones(4))[0]
    assert a.tobytes() != b.tobytes()
