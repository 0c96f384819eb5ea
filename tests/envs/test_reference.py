"""Facts about zero action, which is the strategy itself, and about the number of groups."""

from __future__ import annotations

import numpy as np
import pytest

from tests.envs.rollouts import ACTION_MODES, eventful
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.scenarios import get_suite

EVENTFUL = get_suite("standard").scenario(20_003)
LOW_WIND = get_suite("low-wind").scenario(20_001)


def follow(scenario: Scenario, **settings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequency, rotor speed and coefficient over an episode of zero actions (one of them minus zero)."""
    env = GFMWTGEnv(version="v0", scenario=scenario.to_dict(), **settings)
    _, info = env.reset(seed=0)
    simulator = env.lanes.simulator
    frequency, speed, coefficient = [], [], []
    over, zero = False, 0.0
    while True:
        frequency.append(info["frequency_hz"])
        speed.append(simulator.wtg_values("rotor_speed")[0])
        coefficient.append(simulator.wtg_values("coefficient")[0])
        if over:
            return np.array(frequency), np.array(speed), np.array(coefficient)
        zero = -zero
        _, _, terminated, truncated, info = env.step(np.full(env.action_space.shape, zero))
        over = terminated or truncated


@pytest.mark.parametrize("action_mode", ACTION_MODES)
@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("scenario", [EVENTFUL, LOW_WIND, eventful()], ids=lambda scenario: scenario.name)
def test_zero_action_is_the_strategy_to_the_last_bit(scenario: Scenario, strategy: str, action_mode: str):
    frequency, speed, coefficient = follow(scenario, strategy=strategy, action_mode=action_mode)
    run = simulate(scenario, STRATEGIES[strategy])
    assert frequency.tobytes() == run.frequency_hz.tobytes()
    assert speed.tobytes() == run.rotor_speed_pu.tobytes()
    assert coefficient.tobytes() == run.coefficient_pu.tobytes()


def test_each_group_follows_its_own_strategy():
    frequency, speed, _ = follow(EVENTFUL, strategy=["mppt", "deloaded-10"])
    run = simulate(EVENTFUL, (STRATEGIES["mppt"], STRATEGIES["deloaded-10"]))
    assert frequency.tobytes() == run.frequency_hz.tobytes() and speed.tobytes() == run.rotor_speed_pu.tobytes()


def test_every_lane_of_a_batch_follows_the_strategy_at_zero_action():
    env = GFMWTGVectorEnv(17, scenario=eventful().to_dict(), version="v0")
    env.reset(seed=0)
    run = simulate(eventful(), STRATEGIES["coordinated-piecewise"])
    for frequency in run.frequency_hz[1:]:
        *_, infos = env.step(np.zeros((17, 4)))
        assert infos["frequency_hz"].tolist() == [frequency] * 17


def test_action_on_k_moves_power_up_and_on_tau_only_the_transient():
    start = {}
    for mode, value in (("k", 1.0), ("k", -1.0), ("tau", 1.0), ("tau", -1.0)):
        env = GFMWTGEnv(
            scenario=eventful(events=(), load_noise_mw=np.zeros(0)).to_dict(), action_mode=mode, version="v0"
        )
        env.reset(seed=0)
        before = env.lanes.simulator.wtg_values("power")[0]
        env.step(np.full(2, value))
        start[mode, value] = env.lanes.simulator.wtg_values("power")[0] - before
    assert (start["k", 1.0] > 1e-4).all() and (start["k", -1.0] < -1e-4).all()
    assert np.abs(start["tau", 1.0]).max() < 1e-9 and np.abs(start["tau", -1.0]).max() < 1e-9


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
