"""Facts about sensors: noise, filters, delay and errors; what policies see in version v1, and what is charged then."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from tests.envs.rollouts import actions_of, calm
from tests.machine_code import run_routine
from wtg_gym import GFMWTGEnv, GroupTrip, LoadStep, Scenario, get_suite
from wtg_gym.physics import sensors as sensing
from wtg_gym.physics.layout import Layout
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.sensors import Measurement, Sensors
from wtg_gym.systems.elementary import noise
from wtg_gym.systems.programs import link, numbered
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import Kind, system
from wtg_gym.tasks.measured_observation import MeasuredObservation
from wtg_gym.tasks.observation import WtgObservation

N_WTG, N_ACTION = 4, 8
MEASURED, EXACT = MeasuredObservation._fields, WtgObservation._fields
ACTIONS = actions_of(1, 60, n_action=N_ACTION)[:, 0]
STILL = np.zeros((60, N_ACTION))
BAD = {
    **{"frequency_filter_s": 0.3, "frequency_noise_hz": 0.02, "rocof_filter_s": 0.5, "rocof_noise_hz_s": 0.1},
    **{"rotor_speed_noise_pu": 0.01, "power_noise_pu": 0.02, "wind_noise": 0.1, "wind_noise_correlation_s": 1.0},
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
    faultless = Sensors(seed=7, wind_bias=(0.0,) * N_WTG)
    for run in (play(None, seed=4, sensors="exact"), play(drawn(None)), play(drawn(faultless))):
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
    taken = np.clip(ACTIONS[: len(late.rewards)], -1.0, 1.0)
    for j in range(N_WTG):
        assert late.column(f"wtg{j}.last_action_k")[1:].tolist() == pytest.approx(taken[:, 2 * j].tolist())


def test_without_a_wind_sensor_wind_and_ratio_read_zero_and_all_else_is_as_with_one():
    blind, seeing = (play(drawn(faulty(wind_sensor=sensor))) for sensor in (False, True))
    needs_wind = ("wind", "tip_speed_ratio")
    others = [name for name in MEASURED if name not in needs_wind]
    assert blind.seen("wtg", *others).tobytes() == seeing.seen("wtg", *others).tobytes()
    assert blind.seen("exact").tobytes() == seeing.seen("exact").tobytes()
    assert not any(run.seen("wtg", *needs_wind).any() for run in (blind, play(None, suite="no-wind-sensor")))


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


def test_privileged_observation_is_the_local_one_and_then_the_exact_values():
    local, privileged = (play(drawn(faulty(0.2)), observation_mode=mode) for mode in ("local", "privileged"))
    n = local.observations.shape[1]
    assert local.observations.tobytes() == np.ascontiguousarray(privileged.observations[:, :n]).tobytes()
    names = privileged.env.observation_names
    assert names[:n] == local.env.observation_names and len(names) == privileged.observations.shape[1]
    assert len(set(names)) == len(names)
    assert sum(name.startswith("exact") for name in names) == N_WTG * (len(EXACT) + 1)


N_CHANNELS = len(sensing.Noise._fields)
N = 4 * N_CHANNELS
MEASUREMENT = Measurement(frequency=1.0, rocof=0.0, rotor_speed=1.1, power=0.7, wind=9.0)

DRAWS = Kind(name="draws", rows={"seed": float, "step": float, "channel": float}, scratch={"number": float})
(PROGRAM,) = numbered(DRAW=(system(DRAWS, "number")(lambda seed, step, channel: noise(seed, step, channel)),))
ROUTINE = Routine(PROGRAM)


def numbers_of(seeds: np.ndarray, steps: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """The machine code's numbers of pairs of seed and step (n,), for each channel (n, n_channels)."""
    layout = Layout({DRAWS: channels.size}, {})
    code = link((PROGRAM,), layout)
    block, scratch = np.zeros((layout.n_rows, 16)), np.zeros((layout.n_scratch, 16))
    block[layout.first_rows(DRAWS, "channel")] = channels[:, np.newaxis]
    result = []
    for first in range(0, seeds.size, 16):
        n = min(16, seeds.size - first)
        block[layout.first_rows(DRAWS, "seed"), :n] = seeds[first : first + n]
        block[layout.first_rows(DRAWS, "step"), :n] = steps[first : first + n]
        run_routine(ROUTINE, (block, scratch), code)
        result.append(scratch[layout.first_rows(DRAWS, "number"), :n].T.copy())
    return np.concatenate(result)


def noise_of(n_seeds: int, n_steps: int, n_channels: int = N, first_seed: int = 0) -> np.ndarray:
    """The noise of neighbouring seeds (n_seeds, n_steps, n_channels)."""
    seeds, steps = np.meshgrid(first_seed + np.arange(n_seeds), np.arange(n_steps), indexing="ij")
    result = numbers_of(seeds.ravel(), steps.ravel(), np.arange(n_channels))
    return result.reshape(n_seeds, n_steps, n_channels)


def test_noise_is_the_same_in_plain_python_and_compiled():
    pairs = [(seed, step) for seed in (0, 1, 12345, 2**31 - 1) for step in (0, 1, 599, 86_399)]
    channels = (0, 1, N - 1, 5119)
    fast = numbers_of(*np.array(pairs, dtype=float).T, np.array(channels))
    slow = [[noise(seed, step, channel) for channel in channels] for seed, step in pairs]
    assert fast.tolist() == slow
    assert len(set(fast.ravel().tolist())) == fast.size


def test_noise_has_mean_0_variance_1_the_shape_of_four_uniform_numbers_and_their_bound():
    numbers = noise_of(60, 600).ravel()
    n = numbers.size
    # The sum of four uniform numbers has kurtosis 3 - 6/5/4, so the variance's standard error is √(1.7 / n).
    assert abs(numbers.mean()) < 4.0 / math.sqrt(n)
    assert numbers.var() == pytest.approx(1.0, abs=4.0 * math.sqrt(1.7 / n))
    assert (numbers**3).mean() == pytest.approx(0.0, abs=0.02)
    assert (numbers**4).mean() == pytest.approx(2.7, abs=0.03)
    bound = 131070.0 * math.sqrt(3.0 / (65536.0**2 - 1.0))
    # P(|ξ| > 2.9), by the density of the sum near its end: 2 · (4 u)^4 / 24, u the distance in widths of a uniform.
    u = (2.0 - 2.9 / math.sqrt(3.0)) ** 4 / 24.0
    assert np.abs(numbers).max() <= bound
    assert (np.abs(numbers) > 2.9).mean() == pytest.approx(2.0 * u, rel=0.1)


def advance(sensors: Sensors, exact: list[Measurement], control_dt: float = 0.1):
    given = sensing.sensor_input(sensors, control_dt, 50.0)
    seen, states, state = [], [], sensing.sensors_started(exact[0], sensing.Noise(0.0, 0.0, 0.0, 0.0, 0.0))
    for numbers, now in zip(noise_of(1, len(exact), N_CHANNELS, sensors.seed)[0].tolist(), exact, strict=True):
        errors = sensing.Noise(*numbers)
        state = sensing.sensors_advanced(state, now, errors, given) if states else sensing.sensors_started(now, errors)
        states.append(tuple(state))
        seen.append(sensing.measured(state, now, sensors.wind_bias[0], errors, given))
    return seen, np.array(states)


@pytest.mark.parametrize(("time_constant_s", "control_dt"), [(0.02, 0.05), (0.1, 0.1), (2.0, 0.5)])
def test_filters_answer_a_step_as_a_first_order_lag_does(time_constant_s, control_dt):
    filters = {"frequency_filter_s": time_constant_s, "rocof_filter_s": 2 * time_constant_s}
    sensors = sensing.Sensors(seed=1, wind_bias=(0.0,), **filters)
    after = MEASUREMENT._replace(frequency=1.01, rocof=0.4)
    seen, _ = advance(sensors, [MEASUREMENT, *[after] * 30], control_dt)
    time_s = control_dt * np.arange(31)
    assert [m.frequency for m in seen] == pytest.approx((1.01 - 0.01 * np.exp(-time_s / time_constant_s)).tolist())
    assert [m.rocof for m in seen] == pytest.approx((0.4 - 0.4 * np.exp(-0.5 * time_s / time_constant_s)).tolist())
    assert {m[2:] for m in seen} == {MEASUREMENT[2:]}


def test_errors_of_the_wind_add_up_and_never_take_more_than_nine_tenths_of_it():
    sensors = sensing.Sensors(seed=1, wind_bias=(0.2,), wind_noise=0.1)
    seen, states = advance(sensors, [MEASUREMENT] * 50)
    assert [m.wind for m in seen] == pytest.approx((9.0 * (1.2 + 0.1 * states[:, 2])).tolist())
    assert max(abs(states[:, 2])) > 1.0
    worst = sensing.Sensors(seed=1, wind_bias=(-0.5,), wind_noise=0.3, wind_noise_correlation_s=0.1)
    seen, states = advance(worst, [MEASUREMENT] * 400)
    winds = np.array([m.wind for m in seen])
    assert (0.5 + 0.3 * states[:, 2]).min() < 0.1, "the bound is reached"
    assert winds.min() == pytest.approx(0.9)


def test_sensors_of_an_environment_and_of_a_scenario_exclude_each_other():
    env = GFMWTGEnv(suite="standard-v1", sensors="exact", reward="cost")
    scenario = get_suite("standard-v1").scenario(10_000)
    with pytest.raises(ValueError, match="has sensors, and so has the environment: leave out its argument sensors"):
        env.reset(options={"scenario": scenario})
    env.reset(options={"scenario": dataclasses.replace(scenario, sensors=None)})
