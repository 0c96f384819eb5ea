"""Systems of the cost, and of the history of frequency and actions that cost, sensors and observation share.

The equations are in :mod:`wtg_gym.envs.cost`.
"""

from __future__ import annotations

import math

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
from wtg_gym.envs.task_records import CostTerms, GroupRows, Task
from wtg_gym.envs.task_units import ACTING, SENSED, SHIFTS, TASK, WINDOW
from wtg_gym.physics.wind_turbine import Turbine, WtgOutput, WtgState, frequency_of
from wtg_gym.systems.elementary import select
from wtg_gym.systems.programs import Here
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import system


@system(TASK, "interval", "begins")
def count_interval(was_active: float, interval: float, step: float, task: Task) -> tuple[float, float]:
    """Count control intervals; a run that ends early in one has not begun another."""
    newest = select(was_active > 0.5, _rounded(step / task.n_substeps), interval)
    return newest, select(newest > interval, 1.0, 0.0)


def _rounded(value: float) -> float:
    """Return the nearest whole number, the even one of two."""
    up = math.floor(value + 0.5)
    odd = up - 2.0 * math.floor(0.5 * up)
    return select((up - value == 0.5) & (odd == 1.0), up - 1.0, up)


@system(SHIFTS, "frequency")
def shift_history(frequency: float, next_frequency: float, begins: float) -> float:
    """Move the history on where an interval begins; else the newest frequency is replaced."""
    return select(begins > 0.5, next_frequency, frequency)


@system(WINDOW, "newest_frequency", "rocof", "largest_rocof")
def rate_of_change(
    oldest_frequency: float,
    newest_frequency: float,
    coi: float,
    was_active: float,
    rocof: float,
    largest_rocof: float,
    task: Task,
) -> tuple[float, float, float]:
    """Put the new frequency into the history, and find its rate of change over the window [Hz/s]."""
    ran = was_active > 0.5
    change = (coi - oldest_frequency) * task.nominal_hz
    new = select(ran, change / (task.n_window * task.control_dt), rocof)
    return select(ran, coi, newest_frequency), new, max(largest_rocof, abs(new))


@system(TASK, "term_rates", "elapsed", "violated", "error")
def charge_frequency(
    step: float, coi: float, rocof: float, task: Task, simulation_dt: float
) -> tuple[CostTerms, float, float, float]:
    """Begin the rates of the cost with those of the frequency, and find how long the interval lasted."""
    deviation = abs(coi - 1.0) * task.nominal_hz
    frequency, on_rocof = task.weights.frequency * frequency_cost(deviation), task.weights.rocof * rocof_cost(rocof)
    # A run can end within the interval: the time after that is the failure's.
    unspent = math.ceil(step / task.n_substeps) * task.n_substeps - step
    return (
        CostTerms(frequency, on_rocof, 0.0, 0.0, 0.0, 0.0, 0.0),
        task.control_dt - unspent * simulation_dt,
        select(deviation > CONSTRAINT_FREQUENCY_HZ, 1.0, 0.0),
        0.0,
    )


def _charged(
    term_rates: CostTerms,
    violated: float,
    error: float,
    available_energy: float,
    costs: GroupDeviations,
    duty: float,
    there: float,
    group: GroupRows,
    share: float,
    elapsed: float,
    was_active: float,
    task: Task,
) -> tuple[CostTerms, float, float, float]:
    """Return the lane's sums with a WTG group added; see :func:`~wtg_gym.envs.cost.add_group_costs`."""
    beyond = (costs.rotor > 0.0) | (costs.overload > 0.0)
    energy = share * costs.available * elapsed
    return (
        add_group_costs(term_rates, costs, duty, there, group, task),
        select(beyond, 1.0, violated),
        error + 0.05 * abs(costs.duty) / task.n_groups,
        available_energy + select(was_active > 0.5, energy, 0.0),
    )


@system(ACTING, "term_rates", "violated", "error", "available_energy", when="exact")
def charge_group(
    term_rates: CostTerms,
    violated: float,
    error: float,
    available_energy: float,
    state: WtgState,
    output: WtgOutput,
    group: GroupRows,
    turbine: Turbine,
    share: float,
    elapsed: float,
    was_active: float,
    task: Task,
) -> tuple[CostTerms, float, float, float]:
    """Add the rates of a WTG group to those of the lane."""
    costs = group_deviations(state, output, turbine, task)
    return _charged(
        term_rates, violated, error, available_energy, costs, costs.duty, 1.0, group, share, elapsed, was_active, task
    )


@system(SENSED, "term_rates", "violated", "error", "available_energy", "mean_duty")
def charge_sensed_group(
    term_rates: CostTerms,
    violated: float,
    error: float,
    available_energy: float,
    mean_duty: float,
    leaves_at: float,
    returns_at: float,
    state: WtgState,
    output: WtgOutput,
    group: GroupRows,
    turbine: Turbine,
    share: float,
    step: float,
    elapsed: float,
    was_active: float,
    task: Task,
) -> tuple[CostTerms, float, float, float, float]:
    """Add the rates of a WTG group whose duty is filtered; one that an event has disconnected is charged nothing."""
    costs = group_deviations(state, output, turbine, task)
    there = select((step <= leaves_at) | (step > returns_at), 1.0, 0.0)
    costs = GroupDeviations(there * costs.duty, there * costs.rotor, there * costs.overload, there * costs.available)
    duty = there * filtered_duty(mean_duty, costs.duty, was_active > 0.5, task)
    charged = _charged(
        term_rates, violated, error, available_energy, costs, duty, there, group, share, elapsed, was_active, task
    )
    return (*charged, duty)


@system(ACTING, "group")
def remember_group(group: GroupRows, state: WtgState, output: WtgOutput, was_active: float, task: Task) -> GroupRows:
    """Remember a group's frequency and actions."""
    ran, speed = was_active > 0.5, frequency_of(state, output)
    change = (speed - group.last_speed) / task.control_dt
    return GroupRows(
        base_inv_tau=group.base_inv_tau,
        last_speed=select(ran, speed, group.last_speed),
        rocof=select(ran, change * task.nominal_hz, group.rocof),
        last_action_k=select(ran, group.action_k, group.last_action_k),
        last_action_tau=select(ran, group.action_tau, group.last_action_tau),
        action_k=group.action_k,
        action_tau=group.action_tau,
    )


@system(TASK, "terms", "sums", "cost", "constraint", "constraint_sum", "duty_error")
def charge_lane(
    term_rates: CostTerms,
    terms: CostTerms,
    sums: CostTerms,
    constraint: float,
    constraint_sum: float,
    duty_error: float,
    violated: float,
    error: float,
    elapsed: float,
    end_step: float,
    step: float,
    status: float,
    was_active: float,
    task: Task,
    simulation_dt: float,
) -> tuple[CostTerms, CostTerms, float, float, float, float]:
    """Charge a lane that ran for the last control interval."""
    ran, failed = was_active > 0.5, status != 0.0
    new = interval_cost(term_rates, elapsed, (end_step - step) * simulation_dt, failed, task)
    now = select(failed, 1.0, violated)
    return (
        each(lambda charged, before: select(ran, charged, before), new, terms),
        each(lambda charged, total: total + select(ran, charged, 0.0), new, sums),
        total_cost(new),
        select(ran, now, constraint),
        constraint_sum + select(ran, now, 0.0),
        duty_error + select(ran, error * elapsed, 0.0),
    )


CHARGE = (
    count_interval,
    shift_history,
    rate_of_change,
    charge_frequency,
    charge_group,
    charge_sensed_group,
    remember_group,
    Here("charge"),
    charge_lane,
)
