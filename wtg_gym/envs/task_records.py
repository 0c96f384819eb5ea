"""Records of the task: its constants, what it keeps per lane and WTG group, and where that lies among a lane's rows."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from wtg_gym.systems.compiled import inlined
from wtg_gym.physics.layout import rows_of
from wtg_gym.systems.records import loader, offsets, reader, size, storer
from wtg_gym.physics.sensors import DELAY_MAX_S, SensorInput, SensorState


class Weights(NamedTuple):
    """Weights of the cost's terms and the cap on their sum [1/s]; see :class:`~wtg_gym.envs.settings.CostWeights`."""

    frequency: float
    rocof: float
    duty: float
    rotor: float
    overload: float
    effort: float
    cap: float


class Task(NamedTuple):
    """Constants of the task."""

    modulates_k: bool
    modulates_tau: bool
    privileged: bool
    k_authority: float  # offset on k at full action [p.u.]
    k_low: float  # K_pr
    k_span: float  # K_opt - K_pr
    share_min: float  # share of the usable power to capture at ω_min, ω_st, ω_max
    share_nominal: float
    share_max: float
    weights: Weights
    control_dt: float  # [s]
    nominal_hz: float
    n_window: int  # of the RoCoF, in control intervals
    n_delayed: int  # measurements that a lane keeps, 0 without sensors
    duty_gain: float  # of the filter that the duty is charged behind, 1 - exp(-Δt / T) [-]


class CostTerms(NamedTuple):
    """Terms of the cost."""

    frequency: float
    rocof: float
    duty: float
    rotor: float
    overload: float
    effort: float
    failure: float


class TaskRows(NamedTuple):
    """Rows of the task per lane; the frequency's history and the groups' rows follow."""

    was_active: float  # before the last step
    end_step: float  # simulation step at which the episode is over
    interval: float  # control interval of the newest frequency in the history
    begins: float  # 1 where that interval is a new one
    rocof: float  # over the window [Hz/s]
    largest_rocof: float
    terms: CostTerms  # of the last step
    sums: CostTerms  # over the episode
    cost: float  # of the last step
    constraint: float  # 1 where the last step violated a constraint
    constraint_sum: float
    available_energy: float  # of all groups [p.u. s of the system base]
    duty_error: float  # ∫ |captured - prescribed| / available dt, mean over groups [s]
    rates: CostTerms  # of the step that is being charged [1/s]
    elapsed: float  # how long that step lasted [s]
    violated: float  # 1 where it violated a constraint
    error: float  # its duty error, mean over groups [-]


class GroupRows(NamedTuple):
    """Rows of the task per WTG group."""

    base_inv_tau: float  # of its law [1/s]
    last_speed: float  # its frequency at the last observation [p.u.]
    rocof: float  # of its own frequency over the last control interval [Hz/s]
    last_action_k: float
    last_action_tau: float
    action_k: float  # that acts now
    action_tau: float


class SensedRows(NamedTuple):
    """Further rows per WTG group of a task with sensors."""

    sensors: SensorState
    wind_bias: float
    leaves_at: float  # simulation step at which an event disconnects it
    mean_duty: float  # signed duty error behind its filter, 0.05 of the available power


class MeasuredObservation(NamedTuple):
    """Measurements of the sensors of a WTG group."""

    frequency_deviation: Annotated[float, "0.5 Hz", "filtered frequency of the converter minus the nominal one"]
    rocof: Annotated[float, "Hz/s", "rate of change of the frequency, filtered"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr", "measured speed of the blade tips over measured wind"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u.", "rotor speed; the nominal one is 1 p.u."]
    power: Annotated[float, "p.u.", "power into the grid, of the group's rating"]
    wind: Annotated[float, "5 m/s from 10 m/s", "wind, with a constant and a slow error"]


class Info(NamedTuple):
    """The numbers of `info`, with their units and meanings."""

    time_s: Annotated[float, "s", "time since the start of the episode"]
    frequency_hz: Annotated[float, "Hz", "frequency of the centre of inertia"]
    rocof_hz_s: Annotated[float, "Hz/s", "rate of change of the frequency of the centre of inertia over 0.5 s"]
    cost: Annotated[
        float,
        "-",
        "1 for a step with a failure, an overload, a frequency beyond 50 ± 0.8 Hz or a tip-speed ratio outside its "
        "range, else 0: the cost of safe reinforcement learning",
    ]
    cost_frequency: Annotated[float, "-", "terms of the cost of this step: frequency deviation"]
    cost_rocof: Annotated[float, "-", "rate of change of frequency"]
    cost_duty: Annotated[float, "-", "captured power away from the prescribed power; in v1 filtered with 15 s"]
    cost_rotor: Annotated[float, "-", "tip-speed ratio outside its range"]
    cost_overload: Annotated[float, "-", "power above 1.05 p.u., in v0 1.1 p.u."]
    cost_effort: Annotated[float, "-", "actions and their changes"]
    cost_failure: Annotated[float, "-", "what a failure costs at the end"]


#: Window of the rate of change of frequency [s].
ROCOF_WINDOW_S = 0.5
COST_TERMS = CostTerms._fields
TASK, GROUP, SENSED = offsets(TaskRows), offsets(GroupRows), offsets(SensedRows)
N_TASK_ROWS, N_GROUP_ROWS = size(TaskRows), size(GroupRows)
N_SENSED_ROWS, N_SENSOR_INPUT, N_MEASURED = size(SensedRows), size(SensorInput), size(MeasuredObservation)

read_task = reader(Task)
load_terms, store_terms = loader(CostTerms), storer(CostTerms)
store_info = storer(Info)
load_group, store_group = loader(GroupRows), storer(GroupRows)
load_sensed, store_sensed = loader(SensedRows), storer(SensedRows)
load_sensor_input = loader(SensorInput)


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
