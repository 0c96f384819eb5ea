"""The environment on a plant with limits: the same bits alone and beside others, and results that say so."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from wtg_gym import GFMWTGEnv, GFMWTGVectorEnv, evaluate
from wtg_gym.evaluation.recompute import departures
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.plant import DEAD_BAND_PU, plant_settings
from wtg_gym.physics.scenario import Scenario

N_STEPS = 40


def test_a_lane_of_the_extended_plant_equals_the_single_environment() -> None:
    batch = GFMWTGVectorEnv(num_envs=20, physics="extended", suite="gust")
    single = GFMWTGEnv(physics="extended", suite="gust")
    paper = GFMWTGEnv(suite="gust")
    rng = np.random.default_rng(5)
    # Full actions on k that turn round every 0.8 s: the converters of some lanes reach their current limit.
    actions = np.where(rng.random((N_STEPS, 20, 1)) < 0.5, -1.0, 1.0) * np.ones(4)
    actions = np.repeat(actions[::8], 8, axis=0)[:N_STEPS].astype(np.float32)
    seen, _ = batch.reset(seed=[9000 + lane for lane in range(20)])
    courses = [seen]
    rewards = []
    for action in actions:
        seen, reward, *_ = batch.step(action)
        courses.append(seen)
        rewards.append(reward)
    differs = False
    for lane in (0, 7, 19):
        own, _ = single.reset(seed=9000 + lane)
        other, _ = paper.reset(seed=9000 + lane)
        assert (own == courses[0][lane]).all()
        for step, action in enumerate(actions):
            own, reward, terminated, truncated, _ = single.step(action[lane])
            assert (own == courses[step + 1][lane]).all() and reward == rewards[step][lane]
            assert not terminated and not truncated
            other, *_ = paper.step(action[lane])
        differs = differs or bool((own != other).any())
    assert differs


def test_a_governor_keeps_its_own_dead_band_and_a_case_must_be_one() -> None:
    case = modified_ieee14()
    own = tuple(
        dataclasses.replace(m, governor=dataclasses.replace(m.governor, dead_band_pu=0.002)) if m.governor else m
        for m in case.machines
    )
    settings = plant_settings("extended", case=dataclasses.replace(case, machines=own))
    assert {m.governor.dead_band_pu for m in settings.case.machines if m.governor} == {0.002}
    assert {m.governor.dead_band_pu for m in plant_settings("extended").case.machines if m.governor} == {DEAD_BAND_PU}
    with pytest.raises(ValueError, match="case must be a NetworkCase, got 'x'"):
        plant_settings("extended", case="x")


def test_a_chosen_scenario_below_the_under_speed_trip_is_refused_and_a_drawn_one_ends() -> None:
    slow = Scenario(name="slow", wind_speed=np.array([[8.0], [4.5]]))
    refused = r"cannot start: the rotor of WTG group 1 .* 4.5 m/s, below the under-speed trip at 0.5 p.u."
    with pytest.raises(ValueError, match=refused):
        GFMWTGEnv(physics="extended", scenario=slow, version="v0")
    # Single turbines: the wind of one varies more than the mean of ten.
    singles = [{"bus": 2, "n_turbines": 1.0}] * 2
    env = GFMWTGEnv(physics="extended", suite="low-wind", groups=singles)
    batch = GFMWTGVectorEnv(num_envs=2, physics="extended", suite="low-wind", groups=singles)
    with pytest.raises(ValueError, match=refused):
        env.reset(options={"scenario": slow})
    with pytest.raises(ValueError, match=refused):
        batch.reset(options={"scenarios": [dataclasses.replace(slow, wind_speed=np.array([[8.0], [8.0]])), slow]})
    # Seed 220 draws 4.9 m/s for the second turbine.
    env.reset(seed=220)
    *_, terminated, _, info = env.step(np.zeros(4, dtype=np.float32))
    assert terminated and info["termination_reason"] == "under-speed"
    batch.reset(seed=[220, 0])
    *_, ended, _, infos = batch.step(np.zeros((2, 4), dtype=np.float32))
    assert ended.tolist() == [True, False] and infos["termination_reason"][0] == "under-speed"


def test_results_of_another_physics_depart_from_the_benchmark() -> None:
    results = evaluate([], "standard", "test", seeds=[20000], duration_s=2.0, physics="extended")
    assert any(text.startswith("physics is extended") for text in departures(results))
