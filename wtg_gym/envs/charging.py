"""The loops of the cost, and the history of frequency and actions that cost, sensors and observation share.

The equations are in :mod:`wtg_gym.envs.cost`.
"""

from __future__ import annotations

import math
from typing import Any

from wtg_gym.envs.cost import (
    CONSTRAINT_FREQUENCY_HZ,
    GroupDeviations,
    add_group_costs,
    filtered_duty,
    frequency_cost,
    group_deviations,
    interval_cost,
    rocof_cost,
    total_cost,
)
from wtg_gym.envs.task_records import (
    N_GROUP_ROWS,
    N_SENSED_ROWS,
    TASK,
    CostTerms,
    GroupRows,
    SensedRows,
    Task,
    load_group,
    load_sensed,
    load_terms,
    parts_of,
    store_group,
    store_sensed,
    store_terms,
)
from wtg_gym.systems.compiled import inlined
from wtg_gym.systems.elementary import select
from wtg_gym.physics.layout import (
    LANE,
    WTG,
    Floats,
    Lanes,
    load_wtg_output,
    load_wtg_state,
    read_turbine,
    rows_of,
    wtg_row,
)
from wtg_gym.systems.records import elementwise


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
        new = interval_cost(rates, elapsed, left * c["simulation_dt"], failed, task)
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
            costs = group_deviations(state, load_wtg_output(block, o + WTG.output * width + x, width), turbine, task)
            duty, there = costs.duty, 1.0
            if sensed:
                own = load_sensed(block, (parts.sensed + j * N_SENSED_ROWS) * width + x, width)
                # A group that an event (GroupTrip) has disconnected is charged nothing.
                there = select(block[rows_of(c).lane * width + LANE.step * width + x] <= own.leaves_at, 1.0, 0.0)
                costs = GroupDeviations(
                    there * costs.duty, there * costs.rotor, there * costs.overload, there * costs.available
                )
                duty = there * filtered_duty(own.mean_duty, costs.duty, ran, task)
                own = SensedRows(own.sensors, own.wind_bias, own.leaves_at, duty)
                store_sensed(own, block, (parts.sensed + j * N_SENSED_ROWS) * width + x, width)
            rates = load_terms(block, of_task + TASK.rates * width + x, width)
            rates = add_group_costs(rates, costs, duty, there, group, task, n_wtg)
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
