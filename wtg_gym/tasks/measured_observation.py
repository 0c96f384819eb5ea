"""The sensors: measurements are taken after every control interval, kept for a while, and shown some intervals late.

The equations of the sensors stand in :mod:`wtg_gym.physics.sensors`.
"""

from typing import Annotated, NamedTuple

from wtg_gym.physics import sensors as equations
from wtg_gym.physics.sensors import Noise, SensorInput, SensorState
from wtg_gym.physics.units import ENV
from wtg_gym.physics.wind_turbine import Turbine, WtgOutput, WtgState
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.elementary import select
from wtg_gym.systems.systems import Kind, each, system
from wtg_gym.tasks.episode import ACTING, TASK, GroupRows, TaskConstants
from wtg_gym.tasks.observation import bounded, exact_measurement, shown


class MeasuredObservation(NamedTuple):
    """Measurements of the sensors of a WTG group."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the converter, minus nominal; in v1 filtered"]
    rocof: Annotated[float, "Hz/s", "its rate of change; in v1 filtered"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr", "speed of the blade tips over wind speed"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u.", "rotor speed"]
    power: Annotated[float, "p.u.", "power into the grid"]
    wind: Annotated[float, "5 m/s from 10 m/s", "rotor-effective wind, in v1 an estimate"]


#: The sensors that all WTG groups of an environment have.
SENSORS = Kind(name="sensors", rows={"sensor_input": SensorInput})
#: The sensors of a WTG group.
SENSED = Kind(
    name="sensed groups",
    rows={"sensors": SensorState, "wind_bias": float},
    scratch={
        "noise": Noise,
        "seen": MeasuredObservation,  # what is measured now
        "shown": MeasuredObservation,  # the newest measurement that has arrived
    },
    constants={"group_number": float},
    sees={"acting": ACTING, "group": GROUPS, "sensors": SENSORS, "task": TASK, "env": ENV},
)
#: The latest measurements of every group, the oldest first, one group after the other.
KEPT = Kind(name="kept measurements", rows={"measurement": MeasuredObservation}, sees={"sensed": SENSED})
#: Neighbours among those of a group: each takes the place of the one before it.
KEPT_SHIFTS = Kind(
    name="shifts of measurements",
    constants={"age": float},  # of the one before [control intervals]
    sees={"this_": KEPT, "next_": KEPT, "sensed": SENSED, "sensors": SENSORS, "task": TASK},
)
#: The newest of each group.
NEWEST = Kind(name="newest measurements", sees={"kept": KEPT, "sensed": SENSED, "sensors": SENSORS})


@system(SENSED, "noise")
def draw_noise(sensor_input: SensorInput, interval: float, group_number: float) -> Noise:
    return equations.drawn(sensor_input.seed, interval, group_number)


@system(SENSED, "sensors")
def start_sensors(state: WtgState, output: WtgOutput, group: GroupRows, noise: Noise) -> SensorState:
    """Begin a run with what is measured first."""
    return equations.sensors_started(exact_measurement(state, output, group), noise)


@system(SENSED, "sensors")
def advance_sensors(
    sensors: SensorState, state: WtgState, output: WtgOutput, group: GroupRows, noise: Noise, sensor_input: SensorInput
) -> SensorState:
    return equations.sensors_advanced(sensors, exact_measurement(state, output, group), noise, sensor_input)


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
    task: TaskConstants,
) -> MeasuredObservation:
    """Take the measurement of a WTG group; without a wind sensor, wind and ratio are 0."""
    exact, has_wind = exact_measurement(state, output, group), sensor_input.wind_sensor
    measured = equations.measured(sensors, exact, wind_bias, noise, sensor_input)
    frequency, rocof, ratio, speed, power, wind = shown(measured, turbine.rotor, task)
    return bounded(MeasuredObservation(frequency, rocof, has_wind * ratio, speed, power, has_wind * wind))


@system(KEPT, "measurement", "shown")
def start_measurements(seen: MeasuredObservation) -> tuple[MeasuredObservation, MeasuredObservation]:
    """Begin a run as if the first measurement had always been taken."""
    return seen, seen


def _either(condition: bool, new: MeasuredObservation, old: MeasuredObservation) -> MeasuredObservation:
    selected: MeasuredObservation = each(lambda a, b: select(condition, a, b), new, old)
    return selected


@system(KEPT_SHIFTS, "this_measurement", "shown")
def shift_measurements(
    this_measurement: MeasuredObservation,
    next_measurement: MeasuredObservation,
    shown: MeasuredObservation,
    age: float,
    delay: float,
    begins: float,
) -> tuple[MeasuredObservation, MeasuredObservation]:
    """Move the measurements on where an interval begins; else the newest is replaced."""
    moved = _either(begins > 0.5, next_measurement, this_measurement)
    return moved, _either(age == delay, moved, shown)


@system(NEWEST, "measurement", "shown")
def keep_measurement(
    seen: MeasuredObservation, shown: MeasuredObservation, delay: float
) -> tuple[MeasuredObservation, MeasuredObservation]:
    return seen, _either(delay == 0.0, seen, shown)
