"""What the controller of a WTG group measures: filters, noise, errors of the wind sensor, delay.

    f̂ += a_f (f - f̂),    a = 1 - exp(-Δt / T)         frequency and its rate of change pass a low-pass filter
    v̂ = v (1 + b + σ_v n),    n += (φ - 1) n + √(1 - φ²) ξ     the wind has a constant error b and a slow one

Each measurement has white noise σ ξ, drawn anew in every control interval, and reaches the controller some intervals
late. A number ξ is a function of the seed, the step and the channel alone: the sum of four uniform ones, so |ξ| < 3.47.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from wtg_gym.ranges import Checked, design, require_range, required, whole_steps
from wtg_gym.systems.elementary import noise

#: Longest delay [s].
DELAY_MAX_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Sensors(Checked):
    """Errors of the measurements of one run, the same sensors in every WTG group.

    `wind_bias` has the constant relative error of the wind speed of each group [-]; the metadata of the other fields
    say what they are, with unit and range.
    """

    seed: int = required("-", "design", "seed of the noise", 0, 2**31 - 1)
    wind_bias: tuple[float, ...]
    delay_s: float = design(0.0, "s", "age of the newest measurement, in whole control intervals", 0.0, DELAY_MAX_S)
    frequency_filter_s: float = design(0.0, "s", "time constant of the frequency's filter, 0 for none", 0.0, 10.0)
    frequency_noise_hz: float = design(0.0, "Hz", "its standard deviation", 0.0, 1.0)
    rocof_filter_s: float = design(0.0, "s", "time constant of the filter of its rate of change", 0.0, 10.0)
    rocof_noise_hz_s: float = design(0.0, "Hz/s", "standard deviation of that rate", 0.0, 10.0)
    rotor_speed_noise_pu: float = design(0.0, "p.u.", "standard deviation of the rotor speed", 0.0, 0.1)
    power_noise_pu: float = design(0.0, "p.u.", "standard deviation of the power", 0.0, 0.5)
    wind_noise: float = design(0.0, "-", "standard deviation of the wind's slow relative error", 0.0, 0.3)
    wind_noise_correlation_s: float = design(1.0, "s", "correlation time of that error", 0.1, 600.0)
    wind_sensor: bool = design(True, "-", "without it wind and tip-speed ratio read zero")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.wind_bias, (tuple, list)) or not self.wind_bias:
            raise ValueError(f"wind_bias must have one number per WTG group, got {self.wind_bias!r}")
        bias = tuple(require_range("wind_bias", value, -0.5, 0.5, "") for value in self.wind_bias)
        object.__setattr__(self, "wind_bias", bias)


class SensorInput(NamedTuple):
    """Constants of a run's sensors."""

    seed: float
    delay: float  # [control intervals]
    frequency_gain: float  # a of the filters [-]
    rocof_gain: float
    frequency_noise: float  # standard deviations [p.u.]
    rocof_noise: float  # [Hz/s]
    rotor_speed_noise: float  # [p.u.]
    power_noise: float  # [p.u.]
    wind_noise: float  # [-]
    wind_persistence: float  # φ
    wind_sensor: float  # 1, or 0 without


class Noise(NamedTuple):
    """Random numbers of a WTG group in one step: mean 0, variance 1, nearly normal."""

    frequency: float
    rocof: float
    rotor_speed: float
    power: float
    wind: float


#: Random numbers of a WTG group per step.
_N_CHANNELS = len(Noise._fields)


class SensorState(NamedTuple):
    frequency: float  # filtered [p.u.]
    rocof: float  # filtered [Hz/s]
    wind_error: float  # slow error of the wind, in standard deviations


class Measurement(NamedTuple):
    frequency: float  # [p.u.]
    rocof: float  # [Hz/s]
    rotor_speed: float  # [p.u.]
    power: float  # [p.u.]
    wind: float  # [m/s]


def delay_intervals(delay_s: float, interval_s: float) -> int:
    """Return a delay in control intervals; a ValueError if it is not a whole number of them."""
    return whole_steps("delay_s of the sensors", delay_s, interval_s, "control interval")


def sensor_input(sensors: Sensors | None, interval_s: float, nominal_hz: float) -> SensorInput:
    """Return the constants of a run's sensors; None gives exact measurements without delay.

    A ValueError says that the delay is not a whole number of control intervals.
    """
    if sensors is None:
        return SensorInput(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def gain(time_constant: float) -> float:
        return 1.0 if time_constant == 0.0 else -math.expm1(-interval_s / time_constant)

    return SensorInput(
        seed=float(sensors.seed),
        delay=float(delay_intervals(sensors.delay_s, interval_s)),
        frequency_gain=gain(sensors.frequency_filter_s),
        rocof_gain=gain(sensors.rocof_filter_s),
        frequency_noise=sensors.frequency_noise_hz / nominal_hz,
        rocof_noise=sensors.rocof_noise_hz_s,
        rotor_speed_noise=sensors.rotor_speed_noise_pu,
        power_noise=sensors.power_noise_pu,
        wind_noise=sensors.wind_noise,
        wind_persistence=math.exp(-interval_s / sensors.wind_noise_correlation_s),
        wind_sensor=float(sensors.wind_sensor),
    )


def drawn(seed: float, interval: float, group: float) -> Noise:
    """Return the random numbers of a group, counted from 0, in a control interval of a run."""
    return Noise(*(noise(seed, interval, _N_CHANNELS * group + channel) for channel in range(_N_CHANNELS)))


def sensors_started(exact: Measurement, noise: Noise) -> SensorState:
    """Return the states at the start of a run: filters at rest, the wind's error drawn."""
    return SensorState(exact.frequency, exact.rocof, noise.wind)


def sensors_advanced(s: SensorState, exact: Measurement, noise: Noise, u: SensorInput) -> SensorState:
    """Return the states one control interval later."""
    innovation = math.sqrt(1.0 - u.wind_persistence * u.wind_persistence)
    return SensorState(
        frequency=s.frequency + u.frequency_gain * (exact.frequency - s.frequency),
        rocof=s.rocof + u.rocof_gain * (exact.rocof - s.rocof),
        wind_error=u.wind_persistence * s.wind_error + innovation * noise.wind,
    )


def measured(s: SensorState, exact: Measurement, wind_bias: float, noise: Noise, u: SensorInput) -> Measurement:
    """Return a WTG group's present measurement of the `exact` values."""
    return Measurement(
        frequency=s.frequency + u.frequency_noise * noise.frequency,
        rocof=s.rocof + u.rocof_noise * noise.rocof,
        rotor_speed=exact.rotor_speed + u.rotor_speed_noise * noise.rotor_speed,
        power=exact.power + u.power_noise * noise.power,
        wind=exact.wind * max(1.0 + wind_bias + u.wind_noise * s.wind_error, 0.1),
    )
