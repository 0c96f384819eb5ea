"""Facts about the noise, the filters and the errors of sensors, by themselves."""

import math

import numpy as np
import pytest

from wtg_gym.physics import sensors as sensing
from wtg_gym.physics.layout import Layout
from wtg_gym.systems.elementary import noise
from wtg_gym.systems.programs import build_table, in_one_table
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import Kind, system

N_CHANNELS = len(sensing.Noise._fields)
N = 4 * N_CHANNELS
EXACT = sensing.Measurement(frequency=1.0, rocof=0.0, rotor_speed=1.1, power=0.7, wind=9.0)


DRAWS = Kind(name="draws", rows={"seed": float, "step": float, "channel": float}, scratch={"number": float})
(PROGRAM,) = in_one_table(DRAW=(system(DRAWS, "number")(lambda seed, step, channel: noise(seed, step, channel)),))
ROUTINE = Routine(PROGRAM)


def numbers_of(seeds: np.ndarray, steps: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """The machine code's numbers of pairs of seed and step (n,), for each channel (n, n_channels)."""
    layout = Layout({DRAWS: channels.size}, {})
    tables = build_table((PROGRAM,), layout)
    block, scratch = np.zeros((layout.n_rows, 16)), np.zeros((layout.n_scratch, 16))
    block[layout.first_rows(DRAWS, "channel")] = channels[:, np.newaxis]
    found = []
    for first in range(0, seeds.size, 16):
        n = min(16, seeds.size - first)
        block[layout.first_rows(DRAWS, "seed"), :n] = seeds[first : first + n]
        block[layout.first_rows(DRAWS, "step"), :n] = steps[first : first + n]
        ROUTINE((block, scratch), tables)
        found.append(scratch[layout.first_rows(DRAWS, "number"), :n].T.copy())
    return np.concatenate(found)


def drawn(n_seeds: int, n_steps: int, n_channels: int = N, first_seed: int = 0) -> np.ndarray:
    """The noise of neighbouring seeds (n_seeds, n_steps, n_channels)."""
    seeds, steps = np.meshgrid(first_seed + np.arange(n_seeds), np.arange(n_steps), indexing="ij")
    found = numbers_of(seeds.ravel(), steps.ravel(), np.arange(n_channels))
    return found.reshape(n_seeds, n_steps, n_channels)


def test_noise_is_the_same_in_plain_python_and_compiled():
    pairs = [(seed, step) for seed in (0, 1, 12345, 2**31 - 1) for step in (0, 1, 599, 86_399)]
    channels = (0, 1, N - 1, 5119)
    fast = numbers_of(*np.array(pairs, dtype=float).T, np.array(channels))
    slow = [[noise(seed, step, channel) for channel in channels] for seed, step in pairs]
    assert fast.tolist() == slow
    assert len(set(fast.ravel().tolist())) == fast.size


def test_noise_has_mean_0_variance_1_the_shape_of_four_uniform_numbers_and_their_bound():
    numbers = drawn(60, 600).ravel()
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


def advance(
    sensors: sensing.Sensors, exact: list[sensing.Measurement], control_dt: float = 0.1
) -> tuple[list[sensing.Measurement], np.ndarray]:
    given = sensing.sensor_input(sensors, control_dt, 50.0)
    seen, states, state = [], [], sensing.sensors_started(exact[0], sensing.Noise(0.0, 0.0, 0.0, 0.0, 0.0))
    for numbers, now in zip(drawn(1, len(exact), N_CHANNELS, sensors.seed)[0].tolist(), exact, strict=True):
        errors = sensing.Noise(*numbers)
        state = sensing.sensors_advanced(state, now, errors, given) if states else sensing.sensors_started(now, errors)
        states.append(tuple(state))
        seen.append(sensing.measured(state, now, sensors.wind_bias[0], errors, given))
    return seen, np.array(states)


@pytest.mark.parametrize(("time_constant_s", "control_dt"), [(0.02, 0.05), (0.1, 0.1), (2.0, 0.5)])
def test_filters_answer_a_step_as_a_first_order_lag_does(time_constant_s, control_dt):
    sensors = sensing.Sensors(
        seed=1, wind_bias=(0.0,), frequency_filter_s=time_constant_s, rocof_filter_s=2 * time_constant_s
    )
    after = EXACT._replace(frequency=1.01, rocof=0.4)
    seen, _ = advance(sensors, [EXACT, *[after] * 30], control_dt)
    time_s = control_dt * np.arange(31)
    assert [m.frequency for m in seen] == pytest.approx((1.01 - 0.01 * np.exp(-time_s / time_constant_s)).tolist())
    assert [m.rocof for m in seen] == pytest.approx((0.4 - 0.4 * np.exp(-0.5 * time_s / time_constant_s)).tolist())
    assert {m[2:] for m in seen} == {EXACT[2:]}


def test_errors_of_the_wind_add_up_and_never_take_more_than_nine_tenths_of_it():
    sensors = sensing.Sensors(seed=1, wind_bias=(0.2,), wind_noise=0.1)
    seen, states = advance(sensors, [EXACT] * 50)
    assert [m.wind for m in seen] == pytest.approx((9.0 * (1.2 + 0.1 * states[:, 2])).tolist())
    assert max(abs(states[:, 2])) > 1.0
    worst = sensing.Sensors(seed=1, wind_bias=(-0.5,), wind_noise=0.3, wind_noise_correlation_s=0.1)
    seen, states = advance(worst, [EXACT] * 400)
    winds = np.array([m.wind for m in seen])
    assert (0.5 + 0.3 * states[:, 2]).min() < 0.1, "the bound is reached"
    assert winds.min() == pytest.approx(0.9)
