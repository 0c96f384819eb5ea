"""Where the parts of the task begin among the rows of a lane."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.envs.observation import N_MEASURED
from wtg_gym.envs.task_records import N_GROUP_ROWS, N_SENSED_ROWS, N_SENSOR_INPUT, N_TASK_ROWS, Task
from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.layout import rows_of
from wtg_gym.physics.sensors import DELAY_MAX_S

#: Window of the rate of change of frequency [s].
ROCOF_WINDOW_S = 0.5


class TaskParts(NamedTuple):
    """First row of each part of the task's rows."""

    lane: int
    history: int
    groups: int
    sensor_input: int
    sensed: int  # of each WTG group
    delayed: int  # the latest measurements of all groups, one after the other in a ring
    observation: int


def n_extra_rows(n_wtg: int, control_dt: float, n_observation: int, *, sensed: bool) -> int:
    """Return how many rows the task needs per lane."""
    rows = N_TASK_ROWS + rocof_window(control_dt) + 1 + n_wtg * N_GROUP_ROWS + n_observation
    if sensed:
        rows += N_SENSOR_INPUT + n_wtg * (N_SENSED_ROWS + n_delayed(control_dt) * N_MEASURED)
    return rows


def rocof_window(control_dt: float) -> int:
    """Return the RoCoF window in control intervals, at least one."""
    return max(1, round(ROCOF_WINDOW_S / control_dt))


def n_delayed(control_dt: float) -> int:
    """Return how many measurements a lane keeps for the longest delay."""
    return math.ceil(DELAY_MAX_S / control_dt - 1e-9) + 1


@inlined
def parts_of(c: Any, task: Task) -> TaskParts:
    """Return where the parts begin."""
    # Without a sign: the compiler then knows that no row counts from the end, and loops over lanes become vectors.
    n_window: Any = np.uint32(task.n_window)
    n_delayed: Any = np.uint32(task.n_delayed)
    lane = rows_of(c).extra
    history = lane + N_TASK_ROWS
    groups = history + n_window + 1
    n_wtg, with_sensors = c["share"].shape[0], min(n_delayed, np.uint32(1))
    sensor_input = groups + n_wtg * N_GROUP_ROWS
    sensed = sensor_input + with_sensors * N_SENSOR_INPUT
    delayed = sensed + with_sensors * n_wtg * N_SENSED_ROWS
    return TaskParts(lane, history, groups, sensor_input, sensed, delayed, delayed + n_delayed * n_wtg * N_MEASURED)
