"""One step of the task over the lanes of a block: actions, physics, cost, observation, information.

The equations stand in :mod:`wtg_gym.envs.cost` and :mod:`wtg_gym.envs.observation`, their records in
:mod:`wtg_gym.envs.task_records`; here are the loops, in the same compiled call that advances the physics. Those of the
sensors are in :mod:`wtg_gym.envs.measuring`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.cost import (
    CONSTRAINT_FREQUENCY_HZ,
    GroupCosts,
    charged,
    filtered_duty,
    frequency_cost,
    group_costs,
    rocof_cost,
    total_cost,
    with_group,
)
from wtg_gym.envs.measuring import measure, show_delayed, start_sensors
from wtg_gym.envs.observation import (
    N_LOCAL,
    N_MACHINE,
    N_MEASURED,
    OBSERVATION_BOUND,
    bounded_grid,
    bounded_machine,
    bounded_wtg,
    observe_grid,
    observe_machine,
    observe_wtg,
    store_grid_observation,
    store_machine_observation,
    store_wtg_observation,
)
from wtg_gym.envs.settings import ACTION_MODES, EnvSettings
from wtg_gym.envs.task_layout import n_delayed, parts_of, rocof_window
from wtg_gym.envs.task_records import (
    GROUP,
    N_GROUP_ROWS,
    N_SENSED_ROWS,
    SENSED,
    TASK,
    CostTerms,
    GroupRows,
    Info,
    SensedRows,
    Task,
    Weights,
    load_group,
    load_sensed,
    load_terms,
    read_task,
    store_group,
    store_info,
    store_sensed,
    store_terms,
)
from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.elementary import clip, select
from wtg_gym.physics.integration import advance_interval
from wtg_gym.physics.layout import (
    LANE,
    MACHINE,
    N_MACHINE_ROWS,
    WTG,
    WTG_INV_TAU,
    WTG_K_OFFSET,
    Floats,
    LaneData,
    Lanes,
    Plant,
    load_machine_output,
    load_machine_state,
    load_wtg_input,
    load_wtg_output,
    load_wtg_state,
    read_machine,
    read_turbine,
    rows_of,
    wtg_row,
)
from wtg_gym.physics.records import dtype, elementwise, flatten
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law

Observations = npt.NDArray[np.float32]

#: Full action multiplies or divides the damping time constant by this.
TIME_CONSTANT_RATIO = 4.0

N_INFO = len(Info._fields)


class Outputs(NamedTuple):
    """Outputs of a step, one row per lane."""

    observations: Observations  # (n_lanes, n_observation)
    rewards: Floats  # (n_lanes,), 0 for a lane that had ended
    infos: Floats  # (n_lanes, N_INFO)
    terminated: npt.NDArray[np.bool_]  # (n_lanes,)
    truncated: npt.NDArray[np.bool_]  # (n_lanes,)


def build_task(settings: EnvSettings, nominal_hz: float) -> npt.NDArray[np.void]:
    """Return the task's constants (1,): the numbers of :class:`~wtg_gym.envs.task_records.Task`, and "sensed".

    That part takes no space in a task without sensors, whose code then falls away where it is compiled.
    """
    plant = settings.plant()
    benchmark = settings.benchmark()
    sensed = benchmark.sensed
    reference = get_law(REFERENCE_STRATEGY, plant.turbine, plant.control)
    weights = settings.cost_weights()
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    task = Task(
        modulates_k=modulates_k,
        modulates_tau=modulates_tau,
        privileged=settings.observation_mode == "privileged",
        k_authority=benchmark.k_authority * (reference.k_min - reference.k_max),
        k_low=reference.k_max,
        k_span=reference.k_min - reference.k_max,
        share_min=1.0,
        share_nominal=1.0 - plant.control.deloading_nominal,
        share_max=1.0 - plant.control.deloading_limit,
        weights=Weights(*(getattr(weights, name) for name in Weights._fields)),
        control_dt=settings.control_dt,
        nominal_hz=nominal_hz,
        n_window=rocof_window(settings.control_dt),
        n_delayed=n_delayed(settings.control_dt) if sensed else 0,
        duty_gain=-math.expm1(-settings.control_dt / benchmark.duty_time_s) if benchmark.duty_time_s > 0.0 else 1.0,
    )
    own = dtype(Task)
    parts = [(name, own[name]) for name in own.names or ()]
    constants = np.zeros(1, dtype=np.dtype([*parts, ("sensed", np.int64, (int(sensed),))], align=True))
    for name, value in zip(own.names or (), flatten(task), strict=True):
        constants[name] = value
    return constants


@compiled
def first_invalid_action(actions: Floats) -> int:
    """Return the index of the first row (lane) with an action that is not finite, or -1."""
    for lane in range(actions.shape[0]):
        for a in range(actions.shape[1]):
            if not math.isfinite(actions[lane, a]):
                return lane
    return -1


@compiled
def start_tasks(
    blocks: Floats,
    starting: npt.NDArray[np.int64],
    plant: Plant,
    task: npt.NDArray[np.void],
    end_steps: Floats,
    sensors: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Reset the task's rows of freshly started lanes and write their first observation and information.

    Args:
        blocks, plant, task, outputs, lanes: as for :func:`step_blocks`.
        starting: the lanes (n,).
        end_steps: simulation step at which each episode is over (n,).
        sensors: numbers of :class:`~wtg_gym.physics.sensors.SensorInput` of each episode, then the bias of the wind of
            each WTG group, then the step at which an event disconnects it (n, any number); unused without sensors.
    """
    c, t = plant.constants[0], read_task(task[0])
    sensed = task[0]["sensed"].shape[0] > 0
    width, parts = len(lanes), parts_of(c, t)
    for start in range(starting.shape[0]):
        lane = starting[start]
        block, x = blocks[lane // width], lane % width
        for row in range(parts.lane, block.shape[0] // width):
            block[row * width + x] = 0.0
        block[(parts.lane + TASK.end_step) * width + x] = end_steps[start]
        for row in range(parts.history, parts.groups):
            block[row * width + x] = 1.0
        for j in range(c["share"].shape[0]):
            o = wtg_row(c, j) * width + x
            inv_tau = load_wtg_input(block, o + WTG.input * width, width).law.inv_tau
            speed = load_wtg_state(block, o, width).converter.speed
            group = GroupRows(inv_tau, speed, 0.0, 0.0, 0.0, 0.0, 0.0)
            store_group(group, block, (parts.groups + j * N_GROUP_ROWS) * width + x, width)
        if sensed:
            start_sensors(block, x, c, t, sensors[start], lanes)
        outputs.rewards[lane] = 0.0
        observe(block, c, t, sensed, lanes)
        report(block, x, lane, c, t, outputs, width)


@compiled
def step_blocks(
    blocks: Floats,
    first: int,
    last: int,
    plant: Plant,
    data: LaneData,
    task: npt.NDArray[np.void],
    actions: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Apply actions, advance one control interval, observe and charge, for the lanes of blocks first … last - 1.

    Args:
        blocks: (n_blocks, n_rows · width).
        plant, data: as for :func:`~wtg_gym.physics.integration.advance_interval`.
        task: constants (1,), see :func:`build_task`.
        actions: (n_lanes, n_action), finite; clipped to [-1, 1] here.
        outputs: written for running lanes; the reward is 0 for those that had ended.
        lanes: a tuple as long as a block is wide.
    """
    c, t = plant.constants[0], read_task(task[0])
    sensed = task[0]["sensed"].shape[0] > 0
    width = len(lanes)
    noise_y, keys = np.empty(width), np.empty(width, dtype=np.int64)
    parts, own = parts_of(c, t), rows_of(c).lane
    n_lanes = actions.shape[0]
    for b in range(first, last):
        block = blocks[b]
        count = min(width, n_lanes - b * width)
        apply_actions(block, c, t, actions[b * width : b * width + count], lanes)
        for x in range(width):
            block[(parts.lane + TASK.was_active) * width + x] = block[(own + LANE.active) * width + x]
        advance_interval(block, b * width, plant, data, noise_y, lanes)
        charge(block, c, t, sensed, lanes)
        if sensed:
            measure(block, c, t, keys, lanes)
        observe(block, c, t, sensed, lanes)
        for x in range(count):
            lane = b * width + x
            outputs.rewards[lane] = 0.0
            if block[(parts.lane + TASK.was_active) * width + x] > 0.5:
                outputs.rewards[lane] = -block[(parts.lane + TASK.cost) * width + x]
                # A lane at its end stands still until it is started again.
                if block[(own + LANE.step) * width + x] >= block[(parts.lane + TASK.end_step) * width + x] - 0.5:
                    block[(own + LANE.active) * width + x] = 0.0
                report(block, x, lane, c, t, outputs, width)


@inlined
def apply_actions(block: Floats, c: Any, task: Task, actions: Floats, lanes: Lanes) -> None:
    """Turn actions (count, n_action) into offsets on k and scales on τ; zero leaves the law to the last bit."""
    width, parts = len(lanes), parts_of(c, task)
    n_action = int(task.modulates_k) + int(task.modulates_tau)
    for x in range(actions.shape[0]):
        for j in range(c["share"].shape[0]):
            o = wtg_row(c, j) * width + x
            g = (parts.groups + j * N_GROUP_ROWS) * width + x
            if task.modulates_k:
                action = clip(actions[x, j * n_action], -1.0, 1.0)
                block[g + GROUP.action_k * width] = action
                block[o + WTG_K_OFFSET * width] = task.k_authority * action
            if task.modulates_tau:
                action = clip(actions[x, j * n_action + n_action - 1], -1.0, 1.0)
                block[g + GROUP.action_tau * width] = action
                scale = TIME_CONSTANT_RATIO**-action
                block[o + WTG_INV_TAU * width] = block[g + GROUP.base_inv_tau * width] * scale


@inlined
def charge(block: Floats, c: Any, task: Task, sensed: bool, lanes: Lanes) -> None:
    """Charge the lanes that ran for the last control interval."""
    _update_rocof(block, c, task, lanes)
    _charge_frequency(block, c, task, lanes)
    _charge_groups(block, c, task, sensed, lanes)
    width, parts = len(lanes), parts_of(c, task)
    own, of_task = rows_of(c).lane * width, parts.lane * width
    for x in range(width):
        ran = block[of_task + TASK.was_active * width + x] > 0.5
        failed = block[own + LANE.status * width + x] != 0.0
        left = block[of_task + TASK.end_step * width + x] - block[own + LANE.step * width + x]
        elapsed = block[of_task + TASK.elapsed * width + x]
        rates = load_terms(block, of_task + TASK.rates * width + x, width)
        new = charged(rates, elapsed, left * c["simulation_dt"], failed, task)
        sums = load_terms(block, of_task + TASK.sums * width + x, width)
        terms = load_terms(block, of_task + TASK.terms * width + x, width)
        violated = select(failed, 1.0, block[of_task + TASK.violated * width + x])
        store_terms(_chosen(new, terms, ran), block, of_task + TASK.terms * width + x, width)
        store_terms(_added(new, sums, ran), block, of_task + TASK.sums * width + x, width)
        block[of_task + TASK.cost * width + x] = total_cost(new)
        block[of_task + TASK.constraint * width + x] = select(
            ran, violated, block[of_task + TASK.constraint * width + x]
        )
        block[of_task + TASK.constraint_sum * width + x] += select(ran, violated, 0.0)
        block[of_task + TASK.duty_error * width + x] += select(
            ran, block[of_task + TASK.error * width + x] * elapsed, 0.0
        )


@inlined
def _choose(new: float, old: float, ran: bool) -> float:
    return select(ran, new, old)


@inlined
def _add(new: float, total: float, ran: bool) -> float:
    return total + select(ran, new, 0.0)


_chosen = elementwise(CostTerms, _choose, "chosen", "new, old", "ran")
_added = elementwise(CostTerms, _add, "added", "new, total", "ran")


@inlined
def _charge_frequency(block: Floats, c: Any, task: Task, lanes: Lanes) -> None:
    """Begin the rates of the cost with those of the frequency, and find how long the interval lasted."""
    width, parts = len(lanes), parts_of(c, task)
    own, of_task = rows_of(c).lane * width, parts.lane * width
    n_substeps, dt = float(c["n_substeps"]), c["simulation_dt"]
    for x in range(width):
        step = block[own + LANE.step * width + x]
        deviation = abs(block[own + LANE.coi * width + x] - 1.0) * task.nominal_hz
        frequency = task.weights.frequency * frequency_cost(deviation)
        rocof = task.weights.rocof * rocof_cost(block[of_task + TASK.rocof * width + x])
        rates = CostTerms(frequency, rocof, 0.0, 0.0, 0.0, 0.0, 0.0)
        store_terms(rates, block, of_task + TASK.rates * width + x, width)
        # A run can end within the interval: the time after that is the failure's.
        unspent = math.ceil(step / n_substeps) * n_substeps - step
        block[of_task + TASK.elapsed * width + x] = task.control_dt - unspent * dt
        block[of_task + TASK.violated * width + x] = select(deviation > CONSTRAINT_FREQUENCY_HZ, 1.0, 0.0)
        block[of_task + TASK.error * width + x] = 0.0


@inlined
def _charge_groups(block: Floats, c: Any, task: Task, sensed: bool, lanes: Lanes) -> None:
    """Add the rates of every WTG group, and remember its frequency and its actions."""
    width, parts = len(lanes), parts_of(c, task)
    of_task = parts.lane * width
    turbine = read_turbine(c["turbine"])
    n_wtg = c["share"].shape[0]
    for j in range(n_wtg):
        o, g = wtg_row(c, j) * width, (parts.groups + j * N_GROUP_ROWS) * width
        for x in range(width):
            ran = block[of_task + TASK.was_active * width + x] > 0.5
            state, group = load_wtg_state(block, o + x, width), load_group(block, g + x, width)
            costs = group_costs(state, load_wtg_output(block, o + WTG.output * width + x, width), turbine, task)
            duty, there = costs.duty, 1.0
            if sensed:
                own = load_sensed(block, (parts.sensed + j * N_SENSED_ROWS) * width + x, width)
                # A disconnected group is charged nothing.
                there = select(block[rows_of(c).lane * width + LANE.step * width + x] <= own.leaves_at, 1.0, 0.0)
                costs = GroupCosts(
                    there * costs.duty, there * costs.rotor, there * costs.overload, there * costs.available
                )
                duty = there * filtered_duty(own.mean_duty, costs.duty, ran, task)
                own = SensedRows(own.sensors, own.wind_bias, own.leaves_at, duty)
                store_sensed(own, block, (parts.sensed + j * N_SENSED_ROWS) * width + x, width)
            rates = load_terms(block, of_task + TASK.rates * width + x, width)
            rates = with_group(rates, costs, duty, there, group, task, n_wtg)
            store_terms(rates, block, of_task + TASK.rates * width + x, width)
            violated = select(
                (costs.rotor > 0.0) | (costs.overload > 0.0), 1.0, block[of_task + TASK.violated * width + x]
            )
            block[of_task + TASK.violated * width + x] = violated
            block[of_task + TASK.error * width + x] += 0.05 * abs(costs.duty) / n_wtg
            energy = c["share"][j] * costs.available * block[of_task + TASK.elapsed * width + x]
            block[of_task + TASK.available_energy * width + x] += select(ran, energy, 0.0)
            speed = state.converter.speed
            change = (speed - group.last_speed) / task.control_dt
            seen = GroupRows(
                base_inv_tau=group.base_inv_tau,
                last_speed=select(ran, speed, group.last_speed),
                rocof=select(ran, change * task.nominal_hz, group.rocof),
                last_action_k=select(ran, group.action_k, group.last_action_k),
                last_action_tau=select(ran, group.action_tau, group.last_action_tau),
                action_k=group.action_k,
                action_tau=group.action_tau,
            )
            store_group(seen, block, g + x, width)


@inlined
def _update_rocof(block: Floats, c: Any, task: Task, lanes: Lanes) -> None:
    """Put the new frequency into the history of lanes that ran, and find its rate of change over the window [Hz/s]."""
    width, parts = len(lanes), parts_of(c, task)
    own, of_task, newest = rows_of(c).lane * width, parts.lane * width, (parts.groups - 1) * width
    n_substeps = float(c["n_substeps"])
    for x in range(width):
        ran = block[of_task + TASK.was_active * width + x] > 0.5
        before = block[of_task + TASK.interval * width + x]
        interval = select(ran, _rounded(block[own + LANE.step * width + x] / n_substeps), before)
        # A run that ends early in an interval replaces the newest frequency instead.
        block[of_task + TASK.begins * width + x] = select(interval > before, 1.0, 0.0)
        block[of_task + TASK.interval * width + x] = interval
    for row in range(parts.history, parts.groups - 1):
        for x in range(width):
            begins = block[of_task + TASK.begins * width + x] > 0.5
            block[row * width + x] = select(begins, block[(row + 1) * width + x], block[row * width + x])
    for x in range(width):
        ran = block[of_task + TASK.was_active * width + x] > 0.5
        coi = block[own + LANE.coi * width + x]
        change = (coi - block[parts.history * width + x]) * task.nominal_hz
        rocof = select(ran, change / (task.n_window * task.control_dt), block[of_task + TASK.rocof * width + x])
        block[newest + x] = select(ran, coi, block[newest + x])
        block[of_task + TASK.rocof * width + x] = rocof
        largest = block[of_task + TASK.largest_rocof * width + x]
        block[of_task + TASK.largest_rocof * width + x] = max(largest, abs(rocof))


@inlined
def _rounded(value: float) -> float:
    """Return the nearest whole number, the even one of two."""
    up = math.floor(value + 0.5)
    odd = up - 2.0 * math.floor(0.5 * up)
    return select((up - value == 0.5) & (odd == 1.0), up - 1.0, up)


@inlined
def observe(block: Floats, c: Any, task: Task, sensed: bool, lanes: Lanes) -> None:
    """Write the observations of a block's lanes into its rows.

    :func:`~wtg_gym.envs.observation.observation_names` lists their entries.
    """
    width, parts = len(lanes), parts_of(c, task)
    row = parts.observation
    for j in range(c["share"].shape[0]):
        if sensed:
            show_delayed(block, j, c, task, row, lanes)
            row += N_MEASURED
        else:
            _observe_group(block, j, c, task, row, lanes)
            row += N_LOCAL
        g = (parts.groups + j * N_GROUP_ROWS) * width
        if task.modulates_k:
            _copy_row(block, g + GROUP.last_action_k * width, row * width, width)
            row += 1
        if task.modulates_tau:
            _copy_row(block, g + GROUP.last_action_tau * width, row * width, width)
            row += 1
    if task.privileged:
        if sensed:
            for j in range(c["share"].shape[0]):
                _observe_group(block, j, c, task, row, lanes)
                row += N_LOCAL
                for x in range(width):
                    duty = block[(parts.sensed + j * N_SENSED_ROWS + SENSED.mean_duty) * width + x]
                    block[row * width + x] = clip(duty, -OBSERVATION_BOUND, OBSERVATION_BOUND)
                row += 1
        _observe_grid(block, c, task, row, lanes)


@inlined
def _observe_group(block: Floats, j: int, c: Any, task: Task, row: int, lanes: Lanes) -> None:
    """Write the exact observation of WTG group j, which begins at a row."""
    width, parts = len(lanes), parts_of(c, task)
    turbine = read_turbine(c["turbine"])
    o, g = wtg_row(c, j) * width, (parts.groups + j * N_GROUP_ROWS) * width
    for x in range(width):
        output, group = load_wtg_output(block, o + WTG.output * width + x, width), load_group(block, g + x, width)
        seen = observe_wtg(load_wtg_state(block, o + x, width), output, group, turbine, task)
        store_wtg_observation(bounded_wtg(seen, OBSERVATION_BOUND), block, row * width + x, width)


@inlined
def _observe_grid(block: Floats, c: Any, task: Task, row: int, lanes: Lanes) -> None:
    """Write the privileged part of the observations, which begins at a row."""
    width, rows, parts = len(lanes), rows_of(c), parts_of(c, task)
    n_sync = c["machines"].shape[0]
    for i in range(n_sync):
        o, machine = i * N_MACHINE_ROWS * width, read_machine(c["machines"][i])
        for x in range(width):
            state = load_machine_state(block, o + x, width)
            output = load_machine_output(block, o + MACHINE.output * width + x, width)
            seen = observe_machine(state, output, machine, task)
            store_machine_observation(bounded_machine(seen, OBSERVATION_BOUND), block, row * width + x, width)
        row += N_MACHINE
    for x in range(width):
        torque = 0.0
        for i in range(n_sync):
            at = (i * N_MACHINE_ROWS + MACHINE.output) * width + x
            torque += load_machine_output(block, at, width).torque
        coi, rocof = block[(rows.lane + LANE.coi) * width + x], block[(parts.lane + TASK.rocof) * width + x]
        grid = observe_grid(coi, rocof, torque, task)
        store_grid_observation(bounded_grid(grid, OBSERVATION_BOUND), block, row * width + x, width)


@inlined
def _copy_row(block: Floats, source: int, target: int, width: int) -> None:
    for x in range(width):
        block[target + x] = block[source + x]


@inlined
def report(block: Floats, x: int, lane: int, c: Any, task: Task, outputs: Outputs, width: int) -> None:
    """Copy a lane's observation and the numbers of its `info`, and say whether its episode is over."""
    parts = parts_of(c, task)
    own, of_task = rows_of(c).lane * width + x, parts.lane * width + x
    for k in range(outputs.observations.shape[1]):
        outputs.observations[lane, k] = block[(parts.observation + k) * width + x]
    terms = load_terms(block, of_task + TASK.terms * width, width)
    info = Info(
        time_s=block[own + LANE.step * width] * c["simulation_dt"],
        frequency_hz=task.nominal_hz * block[own + LANE.coi * width],
        rocof_hz_s=block[of_task + TASK.rocof * width],
        cost=block[of_task + TASK.constraint * width],
        cost_frequency=terms.frequency,
        cost_rocof=terms.rocof,
        cost_duty=terms.duty,
        cost_rotor=terms.rotor,
        cost_overload=terms.overload,
        cost_effort=terms.effort,
        cost_failure=terms.failure,
    )
    store_info(info, outputs.infos[lane], 0, 1)
    failed = block[own + LANE.status * width] != 0.0
    outputs.terminated[lane] = failed
    outputs.truncated[lane] = not failed and block[own + LANE.active * width] < 0.5
