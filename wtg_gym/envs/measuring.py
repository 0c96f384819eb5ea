"""The sensors' loops: measurements are taken after every control interval, kept in a ring, and shown some steps late.

The equations stand in :mod:`wtg_gym.physics.sensors` and :mod:`wtg_gym.envs.observation`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.observation import OBSERVATION_BOUND, bounded_measured, observe_measured, store_measured
from wtg_gym.envs.task_records import (
    N_GROUP_ROWS,
    N_MEASURED,
    N_SENSED_ROWS,
    N_SENSOR_INPUT,
    TASK,
    SensedRows,
    Task,
    load_group,
    load_sensed,
    load_sensor_input,
    parts_of,
    store_sensed,
)
from wtg_gym.systems.compiled import inlined
from wtg_gym.physics.layout import WTG, Floats, Lanes, load_wtg_output, load_wtg_state, read_turbine, wtg_row
from wtg_gym.physics.sensors import (
    N_CHANNELS,
    Measurement,
    SensorInput,
    measured,
    noise_key,
    sensors_advanced,
    sensors_started,
)
from wtg_gym.physics.wind_turbine import Turbine


@inlined
def start_sensors(block: Floats, x: int, c: Any, task: Task, numbers: Floats, lanes: Lanes) -> None:
    """Set up the sensors of a freshly started lane, and take its first measurement.

    `numbers` are those of :func:`~wtg_gym.envs.task.start_tasks`.
    """
    width, parts, n_wtg = len(lanes), parts_of(c, task), c["share"].shape[0]
    turbine = read_turbine(c["turbine"])
    for row in range(N_SENSOR_INPUT):
        block[(parts.sensor_input + row) * width + x] = numbers[row]
    given = load_sensor_input(block, parts.sensor_input * width + x, width)
    key = noise_key(int(given.seed), 0)
    for j in range(n_wtg):
        exact = _exact(block, x, j, c, task, width)
        bias, leaves_at = numbers[N_SENSOR_INPUT + j], numbers[N_SENSOR_INPUT + n_wtg + j]
        own = SensedRows(sensors_started(exact, key, j * N_CHANNELS), bias, leaves_at, 0.0)
        _keep(block, x, j, own, exact, key, given, turbine, c, task, width)


@inlined
def measure(block: Floats, c: Any, task: Task, keys: npt.NDArray[np.int64], lanes: Lanes) -> None:
    """Take the measurements at the end of a control interval, for all lanes of a block; `keys` (width) is scratch."""
    width, parts = len(lanes), parts_of(c, task)
    turbine = read_turbine(c["turbine"])
    interval, seed = (parts.lane + TASK.interval) * width, parts.sensor_input * width
    for x in range(width):
        keys[x] = noise_key(int(block[seed + x]), int(block[interval + x]))
    for j in range(c["share"].shape[0]):
        at = (parts.sensed + j * N_SENSED_ROWS) * width
        for x in range(width):
            given = load_sensor_input(block, parts.sensor_input * width + x, width)
            own, exact = load_sensed(block, at + x, width), _exact(block, x, j, c, task, width)
            state = sensors_advanced(own.sensors, exact, keys[x], j * N_CHANNELS, given)
            own = SensedRows(state, own.wind_bias, own.leaves_at, own.mean_duty)
            _keep(block, x, j, own, exact, keys[x], given, turbine, c, task, width)


@inlined
def _exact(block: Floats, x: int, j: int, c: Any, task: Task, width: int) -> Measurement:
    """Return what WTG group j of a lane would measure without errors."""
    o = wtg_row(c, j) * width + x
    state, output = load_wtg_state(block, o, width), load_wtg_output(block, o + WTG.output * width, width)
    group = load_group(block, (parts_of(c, task).groups + j * N_GROUP_ROWS) * width + x, width)
    return Measurement(state.converter.speed, group.rocof, state.rotor_speed, output.power, output.wind)


@inlined
def _keep(
    block: Floats,
    x: int,
    j: int,
    own: SensedRows,
    exact: Measurement,
    key: int,
    given: SensorInput,
    turbine: Turbine,
    c: Any,
    task: Task,
    width: int,
) -> None:
    """Keep the sensors of WTG group j of a lane, and what they measure now."""
    store_sensed(own, block, (parts_of(c, task).sensed + j * N_SENSED_ROWS) * width + x, width)
    value = measured(own.sensors, exact, own.wind_bias, key, j * N_CHANNELS, given)
    seen = bounded_measured(observe_measured(value, given.wind_sensor, turbine, task), OBSERVATION_BOUND)
    store_measured(seen, block, newest_row(block, x, j, c, task, width) * width + x, width)


@inlined
def newest_row(block: Floats, x: int, j: int, c: Any, task: Task, width: int) -> int:
    """Return where in the ring the measurement of WTG group j at the lane's present interval begins.

    The ring turns by a place per interval; lanes stand at different intervals.
    """
    parts = parts_of(c, task)
    place = int(block[(parts.lane + TASK.interval) * width + x]) % task.n_delayed
    row: int = parts.delayed + (place * c["share"].shape[0] + j) * N_MEASURED
    return row


@inlined
def arrived_row(block: Floats, x: int, j: int, c: Any, task: Task, width: int) -> int:
    """Return where in the ring the newest of the measurements of WTG group j that have arrived begins."""
    parts = parts_of(c, task)
    interval = block[(parts.lane + TASK.interval) * width + x]
    delay = load_sensor_input(block, parts.sensor_input * width + x, width).delay
    place = int(max(interval - delay, 0.0)) % max(task.n_delayed, 1)
    row: int = parts.delayed + (place * c["share"].shape[0] + j) * N_MEASURED
    return row


@inlined
def show_delayed(block: Floats, j: int, c: Any, task: Task, row: int, lanes: Lanes) -> None:
    """Copy the newest measurement of WTG group j that has arrived to where the observation begins."""
    width = len(lanes)
    for x in range(width):
        first = arrived_row(block, x, j, c, task, width)
        for k in range(N_MEASURED):
            block[(row + k) * width + x] = block[(first + k) * width + x]
