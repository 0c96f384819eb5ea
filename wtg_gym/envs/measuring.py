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


@system(SENSED, "noise")
def draw_noise(sensor_input: SensorInput, interval: float, group_number: float) -> Noise:
    """Draw the random numbers of the present interval's measurements."""
    return drawn(sensor_input.seed, interval, group_number)


@system(SENSED, "sensors")
def start_sensors(state: WtgState, output: WtgOutput, group: GroupRows, noise: Noise) -> SensorState:
    """Begin a run with what is measured first."""
    return sensors_started(_exact(state, output, group), noise)


@system(SENSED, "sensors")
def advance_sensors(
    sensors: SensorState, state: WtgState, output: WtgOutput, group: GroupRows, noise: Noise, sensor_input: SensorInput
) -> SensorState:
    """Move filters and slow errors on to the end of a control interval."""
    return sensors_advanced(sensors, _exact(state, output, group), noise, sensor_input)


@system(SENSED, "seen")
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
) -> MeasuredObservation:
    """Take the measurement of a WTG group."""
    value = measured(sensors, _exact(state, output, group), wind_bias, noise, sensor_input)
    return observe_measured(value, sensor_input.wind_sensor, turbine, task)


#: Measurements are shown late.
SHOW = Delay(SENSED, "seen", "shown", RING, "measurement", turn="interval", delay="delay")

START_SENSORS = (draw_noise, start_sensors, measure_group, SHOW)
MEASURE = (draw_noise, advance_sensors, measure_group, SHOW)
