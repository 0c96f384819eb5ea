"""Facts about starts and ends of episodes: what the protections see, when they look, and the end of time."""

import numpy as np
import pytest

from tests.envs.rollouts import N_WTG, VERSIONS, calm, episode, eventful, rising, sagging
from wtg_gym import GFMWTGEnv, LineTrip, LoadStep, Plant, Scenario, simulate
from wtg_gym.physics.parameters import ProtectionParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.units import ISLANDS, Spread
from wtg_gym.tasks.cost import CostWeights

GONE = calm(duration_s=20.0, events=(LoadStep(time_s=1.025, bus=2, power_mw=600.0),))
TORN = calm(
    duration_s=20.0,
    events=(
        LineTrip(time_s=1.0, from_bus=1, to_bus=2),
        LineTrip(time_s=1.2, from_bus=2, to_bus=5),
        LineTrip(time_s=1.2, from_bus=2, to_bus=4),
        LoadStep(time_s=2.0, bus=3, power_mw=75.0),
    ),
)
SAGGED = calm(duration_s=20.0, events=(LoadStep(time_s=1.0, bus=2, power_mw=0.0, reactive_mvar=800.0),))
FAILURES = [
    (GONE, "frequency limit", 0.0, 47.5),
    (TORN, "loss of synchronism", 49.0, 51.0),
    (SAGGED, "voltage collapse", 49.0, 51.0),
    (rising(), "over-speed", 49.0, 51.0),
]


def play(scenario: Scenario, action=0.0, **settings):
    arguments = {"version": "v0", "scenario": scenario.to_dict(), "control_dt": 0.1, "reward": "cost", **settings}
    env = GFMWTGEnv(**arguments)
    steps = list(episode(env, action, seed=0))
    return np.array([step[0] for step in steps]), steps[-1], env


@pytest.mark.parametrize("weights", [None, {"cap": 1e-3}, {"rotor": 1e6}])
def test_stall_costs_more_than_any_way_of_living_on(weights):
    settings = {"strategy": "mppt", "weights": weights}
    rewards, (*_, info), _ = play(sagging(), **settings)
    assert info["termination_reason"] == "stall"
    cap = (weights or {}).get("cap", CostWeights().cap)
    living_on = cap * (60.0 - 0.1 * (rewards.size - 1))
    assert -rewards[-1] > living_on
    tripped, (_, terminated, truncated, info), env = play(sagging(), on_failure="trip", **settings)
    assert truncated and not terminated and tripped.size == 600 and info["termination_reason"] == ""
    assert env.lanes.simulator.wtg_values("connected").tolist() == [[0.0, 0.0]]
    assert np.isfinite(env.lanes.observations).all() and tripped.min() >= -0.1 * cap * (1 + 1e-12)
    assert rewards.sum() < tripped.sum()
    assert tripped[-1] < -0.1 * min(cap, CostWeights().duty) * 0.999, "a group that captures nothing is charged for it"


@pytest.mark.parametrize("on_failure", ["terminate", "trip"])
@pytest.mark.parametrize(("scenario", "reason", "least_hz", "most_hz"), FAILURES)
def test_each_failure_ends_the_episode_under_its_own_name_and_a_tripped_group_does_not(
    scenario, reason, least_hz, most_hz, on_failure
):
    rewards, (_, terminated, truncated, info), _ = play(scenario, -1.0, on_failure=on_failure)
    if reason == "over-speed" and on_failure == "trip":
        assert truncated and not terminated and info["termination_reason"] == ""
        return
    assert terminated and not truncated and info["termination_reason"] == reason
    assert least_hz < info["frequency_hz"] < most_hz
    assert rewards[-1] < -CostWeights().cap * (20.0 - 0.1 * rewards.size)


def test_low_voltage_may_last_three_seconds():
    _, (*_, info), env = play(SAGGED)
    simulator = env.lanes.simulator
    spread = Spread(*simulator.scratches[0][simulator.layout.first_rows(ISLANDS, "spread")[0] :][:3, 0])
    assert spread.least_squared_voltage < 0.85**2
    assert info["time_s"] == pytest.approx(1.0 + 3.0 + 0.1)
    longer = Plant(protection=ProtectionParameters(low_voltage_time_s=10.0))
    assert simulate(SAGGED, "coordinated-piecewise", longer).time_s[-1] == pytest.approx(1.0 + 10.0 + 0.1)


@pytest.mark.parametrize(("scenario", "status"), [(sagging(), Status.STALL), (SAGGED, Status.VOLTAGE_COLLAPSE)])
def test_run_ends_when_it_does_whatever_the_control_interval(scenario, status):
    usual, *runs = (simulate(scenario, "mppt", Plant(control_dt=dt)) for dt in (0.1, 0.05, 0.5, 10.0))
    assert usual.status == status
    for run in runs:
        assert run.status == status
        assert run.time_s[-1] == pytest.approx(usual.time_s[-1], abs=0.051)
        assert run.tip_speed_ratio[-1] == pytest.approx(usual.tip_speed_ratio[-1], rel=1e-3)


@pytest.mark.parametrize("control_dt", [0.1, 10.0])
def test_no_run_costs_more_than_one_that_fails_at_once_even_if_it_ends_within_a_long_step(control_dt):
    for scenario in (GONE, TORN):
        rewards, (_, terminated, *_), env = play(scenario, 1.0, control_dt=control_dt, weights={"cap": 1e-3})
        assert terminated and -rewards.sum() <= 1e-3 * (20.0 + 1.0) * (1.0 + 1e-9)
        error = env.lanes.task_values("duty_error")[0]
        assert 0.0 < error < env.lanes.simulator.lane_values("step")[0] * 0.025


def test_version_v1_ends_at_its_frequency_limit_and_sheds_load_before_the_lower_one():
    def played(power_mw: float):
        step = LoadStep(time_s=1.0, bus=3, power_mw=power_mw)
        return play(calm(9.0, 20.0, N_WTG["v1"], inertia_scale=0.3, events=(step,)), version="v1")

    _, (_, terminated, _, info), _ = played(150.0)
    assert not terminated and info["shed_energy_mws"] > 100.0
    rewards, (_, terminated, truncated, info), _ = played(-150.0)
    assert terminated and not truncated and info["termination_reason"] == "frequency limit"
    assert 51.5 < info["frequency_hz"] < 51.6 and info["shed_energy_mws"] == 0.0
    assert -rewards.sum() == pytest.approx(250.0 * 21.0, rel=1e-9)


def test_stopped_rotor_of_version_v1_trips_its_group_which_is_charged_on_or_ends_the_episode():
    wind = np.full((N_WTG["v1"], 1), 9.0)
    wind[1] = 7.0
    step = LoadStep(time_s=2.0, bus=3, power_mw=45.0)
    sagging_v1 = Scenario(name="x", wind_speed=wind, duration_s=60, events=(step,))
    modes = {"version": "v1", "strategy": "mppt"}
    _, (_, terminated, _, info), _ = play(sagging_v1, on_failure="terminate", **modes)
    assert terminated and info["termination_reason"] == "under-speed"
    rewards, (_, _, _, info), env = play(sagging_v1, observation_mode="privileged", **modes)
    connected = env.lanes.simulator.wtg_values("connected")[0]
    assert connected[1] == 0.0 and rewards.size > info["time_s"] * 10.0 - 1.0
    # It failed of itself: no event took it away, and its duty error grows.
    at = env.observation_names.index("exact1.mean_duty [0.05 of the available power]")
    assert env.lanes.observations[0, at] < 0.0


@pytest.mark.parametrize("version", VERSIONS)
def test_scenario_shorter_than_the_episode_is_cut_at_its_end(version):
    env = GFMWTGEnv(version=version, duration_s=5.0)
    short = eventful(duration_s=2.0, n_wtg=N_WTG[version])
    steps = list(episode(env, seed=0, options={"scenario": short}))
    per_s = {"v0": 10, "v1": 2}[version]
    assert len(steps) == 2 * per_s and steps[-1][2] and steps[-1][3]["time_s"] == pytest.approx(2.0)
    assert len(list(episode(env))) == 5 * per_s
