"""Facts about zero action: it is the strategy itself."""

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


def test_zero_action_without_a_strategy_is_the_reference():
    frequency, speed, _ = follow(EVENTFUL)
    run = simulate(EVENTFUL, STRATEGIES["coordinated-piecewise"])
    assert frequency.tobytes() == run.frequency_hz.tobytes()
    assert speed.tobytes() == run.rotor_speed_pu.tobytes()


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


def test_a_strategy_file_is_followed_as_the_built_in_one(tmp_path):
    law = STRATEGIES["coordinated-piecewise"]
    path = tmp_path / "mine.toml"
    path.write_text(
        f"k_min = {law.k_min!r}\nk_nominal = {law.k_nominal!r}\nk_max = {law.k_max!r}\n"
        f"tau_s = {law.damping_time_constant_s!r}\n"
    )
    mine, built_in = follow(EVENTFUL, strategy=str(path)), follow(EVENTFUL)
    assert [a.tobytes() for a in mine] == [b.tobytes() for b in built_in]


@pytest.mark.parametrize("at", range(4))
def test_every_single_action_changes_the_run(at: int):
    action = np.zeros(4)
    action[at] = 0.5
    env, twin = (GFMWTGEnv(scenario=eventful().to_dict(), version="v0") for _ in range(2))
    env.reset(seed=0), twin.reset(seed=0)
    for _ in range(30):
        env.step(action), twin.step(np.zeros(4))
    speed, other = (e.lanes.simulator.wtg_values("rotor_speed")[0] for e in (env, twin))
    change = np.abs(speed - other)
    assert change[at // 2] > 1e-7 and change[at // 2] > change[1 - at // 2]


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
