"""What the agent does, sees and pays: action, observation, cost and their bookkeeping, written once.

The functions here run on the simulator's blocks, lane by lane, in the same compiled call that advances the physics.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import ACTION_MODES, EnvSettings
from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.integration import advance_interval
from wtg_gym.physics.layout import Floats, LaneData, LaneRow, Lanes, Plant, SyncRow, WtgRow, lane_row
from wtg_gym.physics.synchronous_machine import MachineConstant, SyncState
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law, tracking_coefficient
from wtg_gym.physics.wind_turbine import TurbineConstant, WtgState

Observations = npt.NDArray[np.float32]

#: Every entry of the observation is clipped to ± this.
OBSERVATION_BOUND = 5.0
#: Authority over k at full action, as a share of K_opt - K_pr: half the regulation range, beyond K_opt as well.
COEFFICIENT_AUTHORITY = 0.5
#: Full action multiplies or divides the damping time constant by this.
TIME_CONSTANT_RATIO = 4.0
#: Window of the rate of change of frequency [s].
ROCOF_WINDOW_S = 0.5
#: Frequency deviation beyond which the constraint cost counts [Hz]: ENTSO-E's steady-state limit is 0.2, its
#: instantaneous limit 0.8 Hz.
CONSTRAINT_FREQUENCY_HZ = 0.8

#: Per group: frequency, RoCoF, tip-speed ratio, rotor speed, power, wind, k, filter state.
N_LOCAL = 8
#: Per machine of the privileged observation: speed, power, voltage.
N_MACHINE = 3
#: Of the grid in the privileged observation: frequency, RoCoF, mechanical torque.
N_GRID = 3

COST_TERMS = ("frequency", "rocof", "duty", "rotor", "overload", "effort", "failure")


class TaskRow(IntEnum):
    """Rows of a lane that belong to the task; the history and the groups' rows follow."""

    ROCOF = 0  # over the window [Hz/s]
    LARGEST_ROCOF = 1
    COST = 2  # of the last step
    TERM = 3  # the last step's cost terms, in the order of COST_TERMS
    SUM = 10  # their sums over the episode
    CONSTRAINT = 17  # 1 where the last step violated a constraint
    CONSTRAINT_SUM = 18
    AVAILABLE_ENERGY = 19  # of all groups [p.u. s of the system base]
    DUTY_ERROR = 20  # ∫ |captured - prescribed| / available dt, mean over groups [s]
    END_STEP = 21  # simulation step at which the episode is over
    HISTORY = 22


#: Columns of the numbers that `info` holds: time, frequency, RoCoF, constraint cost, then the cost terms.
N_INFO = 4 + len(COST_TERMS)


class GroupRow(IntEnum):
    """Rows of a WTG group that belong to the task."""

    BASE_INV_TAU = 0
    LAST_SPEED = 1
    ROCOF = 2  # of its own frequency over the last control interval [Hz/s]
    ACTION = 3  # the last action on k, then on τ
    N_ROWS = 5


class Outputs(NamedTuple):
    """What the kernels leave for the caller, one row per lane."""

    observations: Observations  # (n_lanes, n_observation)
    rewards: Floats  # (n_lanes,), 0 for a lane that had ended
    infos: Floats  # (n_lanes, N_INFO)
    terminated: npt.NDArray[np.bool_]  # (n_lanes,)
    truncated: npt.NDArray[np.bool_]  # (n_lanes,)


class Task(NamedTuple):
    """Constants of the task for the kernels."""

    modulates_k: bool
    modulates_tau: bool
    privileged: bool
    k_authority: float  # [p.u.]
    k_low: float  # K_pr
    k_span: float  # K_opt - K_pr
    share_min: float  # share of the available power asked for at ω_min, ω_st, ω_max
    share_nominal: float
    share_max: float
    weights: Floats  # in the order of COST_TERMS without failure, then the cap
    control_dt: float
    nominal_hz: float
    n_window: int
    extra: int  # row at which the task's rows start


def n_extra_rows(n_wtg: int, control_dt: float) -> int:
    """Return how many rows the task needs per lane."""
    return TaskRow.HISTORY + rocof_window(control_dt) + 1 + n_wtg * GroupRow.N_ROWS


def rocof_window(control_dt: float) -> int:
    """Return the RoCoF window in control intervals, at least one."""
    return max(1, round(ROCOF_WINDOW_S / control_dt))


def build_task(settings: EnvSettings, nominal_hz: float, extra: int) -> Task:
    """Return the task's constants; `extra` is the row at which its rows start."""
    plant = settings.plant()
    reference = get_law(REFERENCE_STRATEGY, plant.turbine)
    weights = settings.cost_weights()
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    control = plant.control
    return Task(
        modulates_k=modulates_k,
        modulates_tau=modulates_tau,
        privileged=settings.observation_mode == "privileged",
        k_authority=COEFFICIENT_AUTHORITY * (reference.k_min - reference.k_max),
        k_low=reference.k_max,
        k_span=reference.k_min - reference.k_max,
        share_min=1.0,
        share_nominal=1.0 - control.deloading_nominal,
        share_max=1.0 - control.deloading_limit,
        weights=np.array([getattr(weights, name) for name in (*COST_TERMS[:-1], "cap")]),
        control_dt=settings.control_dt,
        nominal_hz=nominal_hz,
        n_window=rocof_window(settings.control_dt),
        extra=extra,
    )


@inlined
def _group_row(j: int, task: Task) -> int:
    return task.extra + TaskRow.HISTORY + task.n_window + 1 + j * GroupRow.N_ROWS


@compiled
def first_invalid_action(actions: Floats) -> int:
    """Return the index of the first row (lane) with an action that is not finite, or -1."""
    for lane in range(actions.shape[0]):
        for a in range(actions.shape[1]):
            if not math.isfinite(actions[lane, a]):
                return lane
    return -1


@compiled
def start_task(
    blocks: Floats,
    lane: int,
    plant: Plant,
    task: Task,
    end_step: float,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Reset the task's rows of a freshly started lane and write its first observation and information."""
    width = len(lanes)
    block, x = blocks[lane // width], lane % width
    for r in range(task.extra, block.shape[0] // width):
        block[r * width + x] = 0.0
    block[(task.extra + TaskRow.END_STEP) * width + x] = end_step
    for h in range(task.n_window + 1):
        block[(task.extra + TaskRow.HISTORY + h) * width + x] = 1.0
    for j in range(len(plant.wtgs)):
        o = len(plant.syncs) * SyncRow.N_ROWS + j * WtgRow.N_ROWS
        g = _group_row(j, task)
        block[(g + GroupRow.BASE_INV_TAU) * width + x] = block[(o + WtgRow.INV_TAU) * width + x]
        block[(g + GroupRow.LAST_SPEED) * width + x] = block[(o + WtgState.SPEED) * width + x]
    outputs.rewards[lane] = 0.0
    observe(block, x, plant, task, outputs.observations[lane], width)
    report(block, x, lane, plant, task, outputs, width)


@compiled
def step_blocks(
    blocks: Floats,
    first: int,
    last: int,
    plant: Plant,
    data: LaneData,
    task: Task,
    actions: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Apply actions, advance one control interval, observe and charge, for the lanes of blocks first … last - 1.

    Args:
        actions: (n_lanes, n_action), finite; clipped to [-1, 1] here.
        outputs: written for running lanes; the reward is 0 for those that had ended.
    """
    width = len(lanes)
    noise_y = np.empty(width)
    own = lane_row(plant)
    n_lanes = actions.shape[0]
    for b in range(first, last):
        block = blocks[b]
        count = min(width, n_lanes - b * width)
        for x in range(count):
            apply_action(block, x, plant, task, actions[b * width + x], width)
        was_active = np.empty(count)
        for x in range(count):
            was_active[x] = block[(own + LaneRow.ACTIVE) * width + x]
        advance_interval(block, b * width, plant, data, noise_y, lanes)
        for x in range(count):
            lane = b * width + x
            outputs.rewards[lane] = 0.0
            if was_active[x] > 0.5:
                outputs.rewards[lane] = -charge(block, x, plant, task, actions[lane], width)
                observe(block, x, plant, task, outputs.observations[lane], width)
                # A lane at its end stands still until it is started again.
                if block[(own + LaneRow.STEP) * width + x] >= block[(task.extra + TaskRow.END_STEP) * width + x] - 0.5:
                    block[(own + LaneRow.ACTIVE) * width + x] = 0.0
                report(block, x, lane, plant, task, outputs, width)


@inlined
def report(block: Floats, x: int, lane: int, plant: Plant, task: Task, outputs: Outputs, width: int) -> None:
    """Write the numbers of a lane's `info`, and whether its episode is over."""
    own, extra = lane_row(plant) * width + x, task.extra * width + x
    row = outputs.infos[lane]
    row[0] = block[own + LaneRow.STEP * width] * plant.simulation_dt
    row[1] = task.nominal_hz * block[own + LaneRow.COI * width]
    row[2] = block[extra + TaskRow.ROCOF * width]
    row[3] = block[extra + TaskRow.CONSTRAINT * width]
    for term in range(7):
        row[4 + term] = block[extra + (TaskRow.TERM + term) * width]
    failed = block[own + LaneRow.STATUS * width] != 0.0
    outputs.terminated[lane] = failed
    outputs.truncated[lane] = not failed and block[own + LaneRow.ACTIVE * width] < 0.5


@inlined
def apply_action(block: Floats, x: int, plant: Plant, task: Task, action: Floats, width: int) -> None:
    """Turn a lane's action into the offset on k and the scale on τ; zero action leaves the law to the last bit."""
    at = 0
    for j in range(len(plant.wtgs)):
        o = (len(plant.syncs) * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width + x
        g = _group_row(j, task) * width + x
        if task.modulates_k:
            block[o + WtgRow.K_OFFSET * width] = task.k_authority * min(max(action[at], -1.0), 1.0)
            at += 1
        if task.modulates_tau:
            scale = TIME_CONSTANT_RATIO ** -min(max(action[at], -1.0), 1.0)
            block[o + WtgRow.INV_TAU * width] = block[g + GroupRow.BASE_INV_TAU * width] * scale
            at += 1


@inlined
def charge(block: Floats, x: int, plant: Plant, task: Task, action: Floats, width: int) -> float:
    """Return a lane's cost of the last control interval, and keep its terms, sums and extremes."""
    own, extra = lane_row(plant) * width + x, task.extra * width + x
    # A run can end within the interval: the time after that is the failure's.
    unspent = -int(block[own + LaneRow.STEP * width]) % plant.n_substeps
    elapsed = task.control_dt - unspent * plant.simulation_dt
    terms = np.zeros(7)
    coi = block[own + LaneRow.COI * width]
    deviation = abs(coi - 1.0) * task.nominal_hz
    rocof = _update_rocof(block, x, plant, task, width)
    ratio = deviation / 0.2
    terms[0] = task.weights[0] * (ratio * ratio if ratio < 1.0 else 1.0 + 8.0 * (ratio - 1.0))
    terms[1] = task.weights[1] * (rocof / 0.2) ** 2
    violated = deviation > CONSTRAINT_FREQUENCY_HZ
    n_wtg = len(plant.wtgs)
    error, at = 0.0, 0
    for j in range(n_wtg):
        o = (len(plant.syncs) * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width + x
        duty, rotor, overload, share = _group_costs(block, o, plant.turbine, task, width)
        terms[2] += task.weights[2] * (duty * duty if duty < 1.0 else 2.0 * duty - 1.0) / n_wtg
        terms[3] += task.weights[3] * rotor * rotor / n_wtg
        terms[4] += task.weights[4] * overload * overload / n_wtg
        violated = violated or rotor > 0.0 or overload > 0.0
        error += 0.05 * duty / n_wtg
        block[extra + TaskRow.AVAILABLE_ENERGY * width] += plant.share[j] * share * elapsed
        g = _group_row(j, task) * width + x
        speed = block[o + WtgState.SPEED * width]
        change = (speed - block[g + GroupRow.LAST_SPEED * width]) / task.control_dt
        block[g + GroupRow.ROCOF * width] = change * task.nominal_hz
        block[g + GroupRow.LAST_SPEED * width] = speed
        at = _effort(block, g, at, task, action, terms, n_wtg, width)
    total = 0.0
    for term in range(6):
        total += terms[term]
    # The cap scales all terms alike, so that they still add up to the cost.
    factor = elapsed * (min(total, task.weights[6]) / total if total > 0.0 else 1.0)
    status = block[own + LaneRow.STATUS * width]
    if status != 0.0:
        left = block[extra + TaskRow.END_STEP * width] - block[own + LaneRow.STEP * width]
        terms[6] = task.weights[6] * (left * plant.simulation_dt + 1.0)
        violated = True
    cost = 0.0
    for term in range(7):
        value = terms[term] * (factor if term < 6 else 1.0)
        block[extra + (TaskRow.TERM + term) * width] = value
        block[extra + (TaskRow.SUM + term) * width] += value
        cost += value
    block[extra + TaskRow.COST * width] = cost
    block[extra + TaskRow.CONSTRAINT * width] = 1.0 if violated else 0.0
    block[extra + TaskRow.CONSTRAINT_SUM * width] += 1.0 if violated else 0.0
    block[extra + TaskRow.DUTY_ERROR * width] += error * elapsed
    return cost


@inlined
def _effort(block: Floats, g: int, at: int, task: Task, action: Floats, terms: Floats, n_wtg: int, width: int) -> int:
    """Charge one group's actions, remember them, and return the index of the next group's."""
    n_action = int(task.modulates_k) + int(task.modulates_tau)
    for a in range(n_action):
        value = min(max(action[at + a], -1.0), 1.0)
        change = value - block[g + (GroupRow.ACTION + a) * width]
        terms[5] += task.weights[5] * (value * value + 4.0 * change * change) / (n_wtg * n_action)
        block[g + (GroupRow.ACTION + a) * width] = value
    return at + n_action


@inlined
def _update_rocof(block: Floats, x: int, plant: Plant, task: Task, width: int) -> float:
    """Put the new frequency into the lane's history and return the rate of change over the window [Hz/s]."""
    own, extra = lane_row(plant) * width + x, task.extra * width + x
    interval = round(block[own + LaneRow.STEP * width] / plant.n_substeps)
    slot = int(interval) % (task.n_window + 1)
    oldest = int(interval + 1) % (task.n_window + 1)
    coi = block[own + LaneRow.COI * width]
    block[extra + (TaskRow.HISTORY + slot) * width] = coi
    change = (coi - block[extra + (TaskRow.HISTORY + oldest) * width]) * task.nominal_hz
    rocof = change / (task.n_window * task.control_dt)
    block[extra + TaskRow.ROCOF * width] = rocof
    largest = block[extra + TaskRow.LARGEST_ROCOF * width]
    block[extra + TaskRow.LARGEST_ROCOF * width] = max(largest, abs(rocof))
    return float(rocof)


@inlined
def _group_costs(block: Floats, o: int, t: Floats, task: Task, width: int) -> tuple[float, float, float, float]:
    """Return (duty error, rotor excursion, overload) in their units, and the available power [p.u.], of a group.

    The duty is a share of the usable power: the available one, up to what the pitch protection lets a rotor that holds
    its nominal reserve capture. A disconnected group captures nothing and is charged for it.
    """
    wind = block[o + WtgRow.WIND * width]
    speed = block[o + WtgState.SPEED * width]
    available = t[TurbineConstant.AVAILABLE_PER_CUBIC_WIND] * wind * wind * wind
    usable = min(available, t[TurbineConstant.POWER_LIMIT] / task.share_nominal)
    asked = usable * tracking_coefficient(
        speed,
        task.share_min,
        task.share_nominal,
        task.share_max,
        t[TurbineConstant.SPEED_MIN],
        t[TurbineConstant.SPEED_SETPOINT],
        t[TurbineConstant.SPEED_MAX],
    )
    duty = abs(block[o + WtgRow.CAPTURED * width] - asked) / (0.05 * available)
    ratio = t[TurbineConstant.TIP_SPEED] * block[o + WtgState.ROTOR_SPEED * width] / wind
    best = t[TurbineConstant.TIP_SPEED_RATIO_OPT]
    low, high = 0.9 * best - ratio, ratio - 1.1 * t[TurbineConstant.TIP_SPEED_RATIO_LIMIT]
    # Above rated the pitch, not the rotor, keeps the tip-speed ratio low.
    if block[o + WtgState.PITCH * width] > t[TurbineConstant.STALL_PITCH]:
        low = 0.0
    rotor = max(0.0, max(low, high)) / (0.1 * best)
    overload = max(0.0, block[o + WtgRow.POWER * width] - t[TurbineConstant.OVERLOAD]) / 0.1
    return duty, rotor, overload, available


@inlined
def observe(block: Floats, x: int, plant: Plant, task: Task, observation: Observations, width: int) -> None:
    """Write a lane's observation; see :func:`observation_names` for its entries and their units."""
    at = 0
    t = plant.turbine
    n_action = int(task.modulates_k) + int(task.modulates_tau)
    for j in range(len(plant.wtgs)):
        o = (len(plant.syncs) * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width + x
        g = _group_row(j, task) * width + x
        rotor, wind = block[o + WtgState.ROTOR_SPEED * width], block[o + WtgRow.WIND * width]
        best, limit = t[TurbineConstant.TIP_SPEED_RATIO_OPT], t[TurbineConstant.TIP_SPEED_RATIO_LIMIT]
        ratio = t[TurbineConstant.TIP_SPEED] * rotor / wind
        observation[at] = _bounded((block[o + WtgState.SPEED * width] - 1.0) * task.nominal_hz / 0.5)
        observation[at + 1] = _bounded(block[g + GroupRow.ROCOF * width])
        observation[at + 2] = _bounded((ratio - best) / (limit - best))
        observation[at + 3] = _bounded((rotor - 1.0) / 0.25)
        observation[at + 4] = _bounded(block[o + WtgRow.POWER * width])
        observation[at + 5] = _bounded((wind - 10.0) / 5.0)
        observation[at + 6] = _bounded((block[o + WtgRow.COEFFICIENT * width] - task.k_low) / task.k_span)
        observation[at + 7] = _bounded(block[o + WtgState.FILTER * width] * task.nominal_hz / 0.5)
        at += N_LOCAL
        for a in range(n_action):
            observation[at + a] = block[g + (GroupRow.ACTION + a) * width]
        at += n_action
    if task.privileged:
        own, extra = lane_row(plant) * width + x, task.extra * width + x
        torque = 0.0
        for i in range(len(plant.syncs)):
            o = i * SyncRow.N_ROWS * width + x
            rating = plant.machines[i, MachineConstant.RATING]
            observation[at] = _bounded((block[o + SyncState.SPEED * width] - 1.0) * task.nominal_hz / 0.5)
            observation[at + 1] = _bounded(block[o + SyncRow.POWER * width] / rating)
            observation[at + 2] = _bounded((block[o + SyncRow.VOLTAGE * width] - 1.0) / 0.1)
            torque += block[o + SyncRow.TORQUE * width]
            at += N_MACHINE
        observation[at] = _bounded((block[own + LaneRow.COI * width] - 1.0) * task.nominal_hz / 0.5)
        observation[at + 1] = _bounded(block[extra + TaskRow.ROCOF * width])
        observation[at + 2] = _bounded(torque)


@inlined
def _bounded(value: float) -> float:
    return min(max(value, -OBSERVATION_BOUND), OBSERVATION_BOUND)


def observation_names(n_wtg: int, n_sync: int, action_mode: str, *, privileged: bool) -> list[str]:
    """Return the names of the observation's entries, with the unit each is counted in."""
    names = []
    action = [name for name, used in zip(("k", "tau"), ACTION_MODES[action_mode], strict=True) if used]
    for j in range(n_wtg):
        names += [
            f"wtg{j}.frequency_deviation [0.5 Hz]",
            f"wtg{j}.rocof [Hz/s]",
            f"wtg{j}.tip_speed_ratio [0 at λ_opt, 1 at λ_pr]",
            f"wtg{j}.rotor_speed [0.25 p.u. from 1 p.u.]",
            f"wtg{j}.power [p.u.]",
            f"wtg{j}.wind [5 m/s from 10 m/s]",
            f"wtg{j}.coefficient [0 at K_pr, 1 at K_opt]",
            f"wtg{j}.filter_state [0.5 Hz]",
            *(f"wtg{j}.last_action_{name}" for name in action),
        ]
    if privileged:
        for i in range(n_sync):
            names += [f"sync{i}.speed [0.5 Hz]", f"sync{i}.power [rating]", f"sync{i}.voltage [0.1 p.u. from 1 p.u.]"]
        names += ["grid.frequency_deviation [0.5 Hz]", "grid.rocof [Hz/s]", "grid.torque [100 MVA]"]
    return names
