"""Facts about what policies see in version v1: delay, filters, noise, errors of the wind; and what is charged then."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.envs.rollouts import actions_of, calm
from wtg_gym import GFMWTGEnv, GroupTrip, LoadStep, Scenario, get_suite
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.sensors import Sensors
from wtg_gym.tasks.observation import WtgObservation
from wtg_gym.tasks.sensing import MeasuredObservation

N_WTG, N_ACTION = 4, 8
MEASURED, EXACT = MeasuredObservation._fields, WtgObservation._fields
ACTIONS = actions_of(1, 60, n_action=N_ACTION)[:, 0]
STILL = np.zeros((60, N_ACTION))
BAD = {
    "frequency_filter_s": 0.3,
    "frequency_noise_hz": 0.02,
    "rocof_filter_s": 0.5,
    "rocof_noise_hz_s": 0.1,
    "rotor_speed_noise_pu": 0.01,
    "power_noise_pu": 0.02,
    "wind_noise": 0.1,
    "wind_noise_correlation_s": 1.0,
}


def drawn(sensors: Sensors | None = None, duration_s: float = 6.0, events: tuple[Event, ...] | None = None) -> Scenario:
    scenario = get_suite("standard-v1").scenario(1_000_003, duration_s=duration_s)
    events = (LoadStep(time_s=0.525, bus=3, power_mw=25.0),) if events is None else events
    return dataclasses.replace(scenario, sensors=sensors, events=events)


def faulty(delay_s: float = 0.0, **changes: Any) -> Sensors:
    return Sensors(**{"seed": 7, "wind_bias": (0.05, -0.05, 0.1, 0.0), "delay_s": delay_s, **BAD, **changes})


@dataclasses.dataclass
class Run:
    env: GFMWTGEnv
    observations: np.ndarray  # (n_steps + 1, n_observation)
    rewards: np.ndarray
    infos: list[dict[str, Any]]

    def column(self, name: str) -> np.ndarray:
        """Return the course of an entry of the observation by its name without unit."""
        names = [entry.partition(" ")[0] for entry in self.env.observation_names]
        return self.observations[:, names.index(name)]

    def seen(self, owner: str, *names: str) -> np.ndarray:
        """Return what the groups measure ("wtg"), or what is exact ("exact"), (n_steps + 1, n_wtg, n_names)."""
        columns = [[self.column(f"{owner}{j}.{name}") for name in names or MEASURED] for j in range(N_WTG)]
        return np.stack(columns).transpose(2, 0, 1)


def play(scenario: Scenario | None, actions: np.ndarray = ACTIONS, seed: int = 0, **arguments: Any) -> Run:
    settings = {"version": "v1", "observation_mode": "privileged", "duration_s": 6.0, "control_dt": 0.1, **arguments}
    env = GFMWTGEnv(reward="cost", **settings)
    observation, _ = env.reset(seed=seed, options=None if scenario is None else {"scenario": scenario})
    seen, rewards, infos = [observation], [], []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(observation)
        rewards.append(reward)
        infos.append(info)
        if terminated or truncated:
            break
    return Run(env, np.array(seen), np.array(rewards), infos)


def test_exact_sensors_show_what_the_privileged_mode_calls_exact():
    for run in (
        play(None, seed=4, sensors="exact"),
        play(drawn(None)),
        play(drawn(Sensors(seed=7, wind_bias=(0.0,) * N_WTG))),
    ):
        assert len(run.rewards) == 60 and np.ptp(run.seen("exact")[:, :, 0]) > 0.05
        np.testing.assert_allclose(run.seen("wtg"), run.seen("exact"), rtol=1.2e-7, atol=1e-9)


@pytest.mark.parametrize(("control_dt", "delay_s"), [(0.1, 0.1), (0.1, 1.0), (0.05, 0.3), (0.2, 0.4)])
def test_delayed_measurements_are_those_of_before_bit_for_bit(control_dt, delay_s):
    steps = round(delay_s / control_dt)
    now, late = (play(drawn(faulty(d)), control_dt=control_dt) for d in (0.0, delay_s))
    assert len(now.rewards) > 2 * steps + 5
    places = np.maximum(np.arange(len(now.observations)) - steps, 0)
    assert late.seen("wtg").tobytes() == now.seen("wtg")[places].tobytes()
    assert (now.seen("wtg") != late.seen("wtg")).any()
    # Nothing else is late: the exact values, the last actions, the cost.
    assert late.seen("exact").tobytes() == now.seen("exact").tobytes() and (late.rewards == now.rewards).all()
    for j in range(N_WTG):
        assert late.column(f"wtg{j}.last_action_k")[1:].tolist() == pytest.approx(
            np.clip(ACTIONS[: len(late.rewards), 2 * j], -1.0, 1.0).tolist()
        )


def test_without_a_wind_sensor_wind_and_ratio_read_zero_and_all_else_is_as_with_one():
    blind, seeing = (play(drawn(faulty(wind_sensor=sensor))) for sensor in (False, True))
    needs_wind = ("wind", "tip_speed_ratio")
    others = [name for name in MEASURED if name not in needs_wind]
    assert blind.seen("wtg", *others).tobytes() == seeing.seen("wtg", *others).tobytes()
    assert blind.seen("exact").tobytes() == seeing.seen("exact").tobytes()
    for run in (blind, play(None, suite="no-wind-sensor")):
        assert not run.seen("wtg", *needs_wind).any()


@pytest.mark.parametrize(("time_s", "first_free"), [(2.0, 21), (2.025, 21)])
def test_group_that_an_event_takes_away_is_not_charged_from_that_step_on(time_s, first_free):
    # But for the event the run stays in its equilibrium.
    calms = calm(duration_s=6.0, n_wtg=N_WTG, events=(GroupTrip(time_s=time_s, group=2),))
    run = play(calms, STILL, strategy="mppt")
    duty = np.stack([run.column(f"exact{j}.mean_duty") for j in range(N_WTG)], axis=1)[1:].astype(np.float64)
    charged = np.arange(1, 61) < first_free
    assert ((duty[:, 2] != 0.0) == charged).all() and (duty[:, [0, 1, 3]] > 0.0).all()
    costs = np.array([info["cost_duty"] for info in run.infos])
    size, weight = np.abs(duty), run.env.settings.cost_weights().duty
    assert size.max() < 5.0
    huber = np.where(size < 1.0, size**2, 2.0 * size - 1.0)
    assert costs == pytest.approx(weight * 0.1 * huber.sum(axis=1) / N_WTG, rel=1e-5)


@pytest.mark.parametrize("suite", ["standard", "no-wind-sensor"])
def test_cost_is_that_of_the_plant_and_not_of_what_is_measured(suite):
    one, other = (play(None, suite=suite, seed=2, sensors=sensors) for sensors in (None, "exact"))
    assert one.rewards.tolist() == other.rewards.tolist()
    assert one.seen("exact").tobytes() == other.seen("exact").tobytes()
    assert one.seen("wtg").tobytes() != other.seen("wtg").tobytes()


def test_privileged_observation_is_the_local_one_and_then_the_exact_values():
    local, privileged = (play(drawn(faulty(0.2)), observation_mode=mode) for mode in ("local", "privileged"))
    n = local.observations.shape[1]
    assert local.observations.tobytes() == np.ascontiguousarray(privileged.observations[:, :n]).tobytes()
    names = privileged.env.observation_names
    assert names[:n] == local.env.observation_names and len(names) == privileged.observations.shape[1]
    assert len(set(names)) == len(names)
    assert sum(name.startswith("exact") for name in names) == N_WTG * (len(EXACT) + 1)
