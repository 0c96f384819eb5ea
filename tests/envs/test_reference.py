"""Facts about zero action, which is the strategy itself, and about the number of groups."""

import itertools

import numpy as np
import pytest

from tests.envs.rollouts import ACTION_MODES, calm, eventful
from wtg_gym.envs import GFMWTGEnv
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


@pytest.mark.parametrize("scenario", [EVENTFUL, LOW_WIND, eventful()], ids=lambda scenario: scenario.name)
def test_zero_action_is_the_strategy_to_the_last_bit(scenario):
    strategies = [*((name, name) for name in STRATEGIES), ("mppt", "deloaded-10")]
    for names, action_mode in zip(strategies, itertools.cycle(ACTION_MODES), strict=False):
        frequency, speed, coefficient = follow(scenario, strategy=list(names), action_mode=action_mode)
        run = simulate(scenario, names)
        assert frequency.tobytes() == run.frequency_hz.tobytes(), names
        assert speed.tobytes() == run.rotor_speed_pu.tobytes()
        assert coefficient.tobytes() == run.coefficient_pu.tobytes()


def test_action_on_k_moves_power_up_and_on_tau_only_the_transient():
    for mode, value in (("k", 1.0), ("k", -1.0), ("tau", 1.0), ("tau", -1.0)):
        env = GFMWTGEnv(scenario=calm().to_dict(), action_mode=mode, version="v0")
        env.reset(seed=0)
        before = env.lanes.simulator.wtg_values("power")[0]
        env.step(np.full(2, value))
        change = env.lanes.simulator.wtg_values("power")[0] - before
        assert (value * change > 1e-4).all() if mode == "k" else np.abs(change).max() < 1e-9


def test_groups_at_a_shared_bus_in_the_same_wind_behave_alike():
    # Bus 2 holds its voltage with the groups alone: two turbines could not. The number is a constant of the compiled
    # code, without a limit of its own there: more than three groups would take half a minute to compile.
    groups = [{"bus": bus, "n_turbines": 10.0 if bus == 2 else 1.0} for bus in (2, 9, 9)]
    env = GFMWTGEnv(groups=groups, scenario=calm(n_wtg=3, duration_s=2.0).to_dict(), version="v0")
    observation, _ = env.reset(seed=0)
    n = observation.size // 3
    assert env.action_space.shape == (6,) and observation.size == len(env.observation_names) == 3 * n
    for _ in range(20):
        observation, _, terminated, truncated, _ = env.step(np.array([0.4, -0.2] * 3))
        assert env.observation_space.contains(observation)
    assert truncated and not terminated
    assert observation[n : 2 * n] == pytest.approx(observation[2 * n :].tolist(), abs=1e-6)
    assert observation[:n] != pytest.approx(observation[n : 2 * n].tolist(), abs=1e-3)
