"""The sensors: measurements are taken after every control interval, kept in a ring, and shown some steps late.

The equations stand in :mod:`wtg_gym.physics.sensors` and :mod:`wtg_gym.envs.observation`.
"""

from __future__ import annotations

from wtg_gym.envs.observation import observe_measured
from wtg_gym.envs.task_records import GroupRows, MeasuredObservation, Task
from wtg_gym.envs.task_units import RING, SENSED
from wtg_gym.physics.sensors import (
    Measurement,
    Noise,
    SensorInput,
    SensorState,
    drawn,
    measured,
    sensors_advanced,
    sensors_started,
)
from wtg_gym.physics.wind_turbine import Turbine, WtgOutput, WtgState, frequency_of
from wtg_gym.systems.programs import Delay
from wtg_gym.systems.systems import system


def _exact(state: WtgState, output: WtgOutput, group: GroupRows) -> Measurement:
    """Return what a WTG group would measure without errors."""
    return Measurement(frequency_of(state, output), group.rocof, state.rotor_speed, output.power, output.wind)


def _seen(
    sensors: SensorState,
    exact: Measurement,
    wind_bias: float,
    noise: Noise,
    sensor_input: SensorInput,
    turbine: Turbine,
    task: Task,
) -> MeasuredObservation:
    value = measured(sensors, exact, wind_bias, noise, sensor_input)
    return observe_measured(value, sensor_input.wind_sensor, turbine, task)


@system(SENSED, "noise")
def draw_noise(sensor_input: SensorInput, interval: float, group_number: float) -> Noise:
    """Draw the random numbers of the present interval's measurements."""
    return drawn(sensor_input.seed, interval, group_number)


@system(SENSED, "sensors", "seen")
def start_sensors(
    state: WtgState,
    output: WtgOutput,
    group: GroupRows,
    wind_bias: float,
    noise: Noise,
    sensor_input: SensorInput,
    turbine: Turbine,
    task: Task,
) -> tuple[SensorState, MeasuredObservation]:
    """Take the first measurement of a run."""
    exact = _exact(state, output, group)
    sensors = sensors_started(exact, noise)
    return sensors, _seen(sensors, exact, wind_bias, noise, sensor_input, turbine, task)


@system(SENSED, "sensors", "seen")
def measure_group(
    sensors: SensorState,
    state: WtgState,
    output: WtgOutput,
    group: GroupRows,
    wind_bias: float,
    noise: Noise,
    sensor_input: SensorInput,
    turbine: Turbine,
    task: Task,
) -> tuple[SensorState, MeasuredObservation]:
    """Take the measurement at the end of a control interval."""
    exact = _exact(state, output, group)
    sensors = sensors_advanced(sensors, exact, noise, sensor_input)
    return sensors, _seen(sensors, exact, wind_bias, noise, sensor_input, turbine, task)


#: Measurements are shown late.
SHOW = Delay(SENSED, "seen", "shown", RING, "measurement", turn="interval", delay="delay")

START_SENSORS = (draw_noise, start_sensors, SHOW)
MEASURE = (draw_noise, measure_group, SHOW)
