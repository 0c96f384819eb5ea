"""Facts about the ends of episodes: stall, over-speed, frequency limit and the end of time."""

from __future__ import annotations

import numpy as np
import pytest

from tests.envs.rollouts import calm, episode, eventful, rising, sagging
from wtg_gym.envs import CostWeights, GFMWTGEnv
from wtg_gym.physics.layout import WtgRow
from wtg_gym.physics.scenario import LoadStep, Scenario

GONE = calm(duration_s=20.0, inertia_scale=0.05, events=(LoadStep(time_s=1.025, bus=2, power_mw=1000.0),))


def play(scenario: Scenario, action=0.0, **settings):
    """Return the rewards, the last step and the environment of an episode."""
    env = GFMWTGEnv(scenario=scenario.to_dict(), **settings)
    steps = list(episode(env, action, seed=0))
    return np.array([step[0] for step in steps]), steps[-1], env


def test_low_wind_with_maximum_power_tracking_ends_in_a_stall():
    rewards, (_, terminated, truncated, info), _ = play(sagging(), strategy="mppt")
    assert terminated and not truncated and info["termination_reason"] == "stall"
    assert 10.0 < info["time_s"] < 60.0 and info["cost"] == 1.0
    assert info["cost_failure"] > 0.0 and info["time_s"] == pytest.approx(0.1 * rewards.size)


def test_same_run_survives_with_the_reference():
    rewards, (_, terminated, truncated, info), _ = play(sagging())
    assert truncated and not terminated and info["termination_reason"] == "" and rewards.size == 600


def test_harm_can_be_done_on_purpose():
    early, (*_, info), _ = play(sagging(), 1.0, strategy="deloaded-5")
    idle, *_ = play(sagging(), 0.0, strategy="deloaded-5")
    saved, (*_, truncated, _), _ = play(sagging(), [-1.0, 0.0, -1.0, 0.0], strategy="deloaded-5")
    assert info["termination_reason"] == "stall" and early.size < idle.size < saved.size and truncated
    assert early.sum() < idle.sum() < saved.sum()


@pytest.mark.parametrize("weights", [None, {"cap": 2.0}, {"cap": 1e-3}, {"rotor": 1e6}])
def test_stall_costs_more_than_any_way_of_living_on(weights: dict | None):
    settings = {"strategy": "mppt", "weights": weights}
    rewards, (*_, info), _ = play(sagging(), **settings)
    assert info["termination_reason"] == "stall"
    cap = (weights or {}).get("cap", CostWeights().cap)
    living_on = cap * (60.0 - 0.1 * (rewards.size - 1))
    assert -rewards[-1] > living_on
    tripped, (*_, truncated, _), _ = play(sagging(), on_failure="trip", **settings)
    assert truncated and tripped.size == 600 and tripped.min() >= -0.1 * cap * (1 + 1e-12)
    assert rewards.sum() < tripped.sum()


def test_earlier_stall_costs_more():
    late, *_ = play(sagging(), strategy="mppt")
    early, *_ = play(sagging(), 1.0, strategy="mppt")
    assert early.size < late.size and early[-1] < late[-1] and early.sum() < late.sum()


def test_stall_in_the_very_last_step_still_costs():
    n_steps = play(sagging(), strategy="mppt")[0].size
    rewards, (_, terminated, truncated, info), _ = play(sagging(duration_s=round(0.1 * n_steps, 1)), strategy="mppt")
    assert terminated and not truncated and info["termination_reason"] == "stall"
    assert rewards[-1] < -CostWeights().cap


def test_trip_disconnects_the_group_and_goes_on():
    rewards, (_, terminated, truncated, info), env = play(sagging(), strategy="mppt", on_failure="trip")
    assert truncated and not terminated and rewards.size == 600 and info["termination_reason"] == ""
    assert env.lanes.simulator.wtg_values(WtgRow.CONNECTED).tolist() == [[0.0, 0.0]]
    assert np.isfinite(rewards).all() and np.isfinite(env.lanes.observations).all()
    assert rewards[-1] < -0.1 * CostWeights().duty, "a group that captures nothing is charged for it"


def test_one_tripped_group_leaves_the_other_running():
    wind = np.array([[8.0], [12.0]])
    scenario = Scenario(name="half", wind_speed=wind, duration_s=60.0, events=sagging().events)
    _, (*_, truncated, _), env = play(scenario, strategy=["mppt", "coordinated-piecewise"], on_failure="trip")
    assert truncated and env.lanes.simulator.wtg_values(WtgRow.CONNECTED).tolist() == [[0.0, 1.0]]
    assert env.lanes.simulator.wtg_values(WtgRow.POWER)[0].tolist()[0] == pytest.approx(0.0, abs=1e-12)


def test_rising_wind_ends_in_an_over_speed():
    _, (_, terminated, truncated, info), _ = play(rising(), -1.0)
    assert terminated and not truncated and info["termination_reason"] == "over-speed"
    _, (_, terminated, truncated, info), _ = play(rising(), -1.0, on_failure="trip")
    assert truncated and not terminated and info["termination_reason"] == ""


@pytest.mark.parametrize("on_failure", ["terminate", "trip"])
def test_lost_frequency_ends_the_episode_either_way(on_failure: str):
    rewards, (_, terminated, truncated, info), _ = play(GONE, on_failure=on_failure)
    assert terminated and not truncated and info["termination_reason"] == "frequency limit"
    assert info["frequency_hz"] < 47.5 and rewards[-1] < -CostWeights().cap * (20.0 - 0.1 * rewards.size)


def test_scenario_shorter_than_the_episode_is_cut_at_its_end():
    env = GFMWTGEnv(duration_s=5.0)
    steps = list(episode(env, seed=0, options={"scenario": eventful(duration_s=2.0)}))
    assert len(steps) == 20 and steps[-1][2] and steps[-1][3]["time_s"] == pytest.approx(2.0)
    assert len(list(episode(env))) == 50


@pytest.mark.parametrize(("control_dt", "simulation_dt"), [(0.02, 0.02), (0.1, 0.01), (0.2, 0.02), (1.0, 0.02)])
def test_episode_has_as_many_steps_as_its_length_asks(control_dt: float, simulation_dt: float):
    env = GFMWTGEnv(duration_s=3.0, control_dt=control_dt, simulation_dt=simulation_dt)
    steps = list(episode(env, seed=0))
    assert len(steps) == round(3.0 / control_dt) and steps[-1][2]
    assert steps[0][3]["time_s"] == pytest.approx(control_dt) and steps[-1][3]["time_s"] == pytest.approx(3.0)


def test_events_act_in_the_step_that_covers_them():
    plain, moved = (GFMWTGEnv(scenario=s.to_dict()) for s in (calm(), calm(events=eventful().events)))
    plain.reset(seed=0), moved.reset(seed=0)
    equal = []
    for _ in range(10):
        equal.append(plain.step(np.zeros(4))[-1]["frequency_hz"] == moved.step(np.zeros(4))[-1]["frequency_hz"])
    assert equal == [True] * 5 + [False] * 5, "the first event is at 0.52 s"


@pytest.mark.parametrize(("control_dt", "simulation_dt"), [(0.2, 0.04), (0.12, 0.03), (0.1, 0.0125)])
def test_integration_step_that_is_accepted_plays_every_draw_of_a_suite(control_dt: float, simulation_dt: float):
    try:
        env = GFMWTGEnv(control_dt=control_dt, simulation_dt=simulation_dt, duration_s=6.0)
    except ValueError as error:
        assert "simulation_dt" in str(error)
        return
    for seed in range(20):
        env.reset(seed=seed)
