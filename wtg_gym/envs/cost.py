"""The cost of one control interval, term by term, and the history of frequency and actions that it follows.

The cost is a rate [1/s] times the time that passed; the terms' weights and the cap are those of
:class:`~wtg_gym.envs.settings.CostWeights`. Sensors and observation share the history.
"""

from __future__ import annotations

import math

from wtg_gym.envs.task_records import CostTerms, GroupDeviations, GroupRows, Task
from wtg_gym.envs.task_units import ACTING, SENSED, SHIFTS, TASK, WATCHED, WINDOW
from wtg_gym.physics.converter import tracking_coefficient
from wtg_gym.physics.machine import MachineInput, MachineState
from wtg_gym.physics.units import Joining
from wtg_gym.physics.wind_turbine import Turbine, WtgInput, WtgOutput, WtgState, frequency_of, tip_speed_ratio
from wtg_gym.systems.elementary import select
from wtg_gym.systems.programs import Here
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import system

#: Frequency deviation beyond which the constraint cost counts [Hz]: ENTSO-E's steady-state limit is 0.2, its
#: instantaneous limit 0.8 Hz.
CONSTRAINT_FREQUENCY_HZ = 0.8


def frequency_cost(deviation_hz: float) -> float:
    """Return the cost of a frequency deviation [Hz]: quadratic within 0.2 Hz, linear and steeper outside."""
    ratio = deviation_hz / 0.2
    return select(ratio < 1.0, ratio * ratio, 1.0 + 8.0 * (ratio - 1.0))


def rocof_cost(rocof_hz_s: float) -> float:
    """Return the cost of a rate of change of frequency [Hz/s]."""
    ratio = rocof_hz_s / 0.2
    return ratio * ratio


def duty_cost(duty: float) -> float:
    """Return the cost of a duty error: quadratic within one unit, linear outside (Huber)."""
    size = abs(duty)
    return select(size < 1.0, size * size, 2.0 * size - 1.0)


def filtered_duty(mean: float, duty: float, ran: bool, task: Task) -> float:
    """Return the duty error behind its filter, one control interval later; an early end counts as a whole interval.

    Args:
        mean: the filtered error before.
        duty: the duty error now.
        ran: whether the lane ran in that interval.
        task: constants.
    """
    return mean + select(ran, task.duty_gain, 0.0) * (duty - mean)


def effort(action: float, last: float) -> float:
    """Return the cost of an action and of its change."""
    change = action - last
    return action * action + 4.0 * change * change


def interval_cost(terms: CostTerms, elapsed: float, left: float, failed: bool, task: Task) -> CostTerms:
    """Return the terms of the cost of an interval.

    Args:
        terms: rates of all terms but failure [1/s].
        elapsed: time that passed [s].
        left: time that a failed episode leaves [s]; a failure costs the cap for this time and 1 s more.
        failed: whether the episode has failed.
        task: constants. The cap scales all terms alike, so that they still add up to the cost.
    """
    charged = _capped(terms, elapsed, task.weights.cap)
    return charged._replace(failure=select(failed, task.weights.cap * (left + 1.0), 0.0))


def open_cost(
    terms: CostTerms, elapsed: float, spent: float, unserved: float, duration: float, failed: bool, task: Task
) -> CostTerms:
    """Return the terms of the cost of an interval in which the cap is not for the frequency and load not served.

    Args:
        terms: rates of all terms but failure [1/s].
        elapsed: time that passed [s].
        spent: cost of the episode before.
        unserved: load that is not served, as a share of the case's load.
        duration: of the whole episode [s]. A failed one costs the largest rate there is for 1 s more than that.
        failed: whether the episode has failed.
        task: constants. The cap scales all terms but frequency alike, the largest rate all of them.

    In the interval of a failure, which may be a numerical one, nothing else is charged.
    """
    rates = _capped(terms._replace(frequency=0.0), 1.0, task.weights.cap)
    rates = rates._replace(frequency=terms.frequency, failure=task.weights.unserved * min(unserved, 1.0))
    charged = _capped(rates, elapsed, task.weights.failure)
    missing = task.weights.failure * (duration + 1.0) - spent
    kept: CostTerms = each(lambda term: select(failed, 0.0, term), charged)
    return kept._replace(failure=select(failed, missing, charged.failure))


def _capped(terms: CostTerms, elapsed: float, most: float) -> CostTerms:
    """Return what rates cost in a time that passed [s], their sum held at the most that it may be [1/s]."""
    total = _total_of_rates(terms) + terms.failure
    factor = elapsed * select(total > 0.0, min(total, most) / total, 1.0)
    charged: CostTerms = each(lambda rate: rate * factor, terms)
    return charged


def _total_of_rates(terms: CostTerms) -> float:
    """Return the sum of all terms but failure."""
    return terms.frequency + terms.rocof + terms.duty + terms.rotor + terms.overload + terms.effort


# --- the systems: over lanes and WTG groups ---------------------------------------------------------------------------


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


@system(SHIFTS, "this_frequency")
def shift_history(this_frequency: float, next_frequency: float, begins: float) -> float:
    """Move the history on where an interval begins; else the newest frequency is replaced."""
    return select(begins > 0.5, next_frequency, this_frequency)


@system(WINDOW, "newest_frequency", "task_rocof", "largest_rocof")
def rate_of_change(
    oldest_frequency: float,
    newest_frequency: float,
    coi: float,
    was_active: float,
    task_rocof: float,
    largest_rocof: float,
    task: Task,
) -> tuple[float, float, float]:
    """Put the new frequency into the history, and find its rate of change over the window [Hz/s]."""
    ran = was_active > 0.5
    change = (coi - oldest_frequency) * task.nominal_hz
    new = select(ran, change / (task.n_window * task.control_dt), task_rocof)
    return select(ran, coi, newest_frequency), new, max(largest_rocof, abs(new))


@system(TASK, "term_rates", "elapsed", "violated", "error")
def charge_frequency(
    step: float, coi: float, own_rocof: float, task: Task, simulation_dt: float
) -> tuple[CostTerms, float, float, float]:
    """Begin the rates of the cost with those of the frequency, and find how long the interval lasted."""
    deviation = abs(coi - 1.0) * task.nominal_hz
    frequency, on_rocof = task.weights.frequency * frequency_cost(deviation), task.weights.rocof * rocof_cost(own_rocof)
    # A run can end within the interval: the time after that is the failure's.
    unspent = math.ceil(step / task.n_substeps) * task.n_substeps - step
    return (
        CostTerms(frequency, on_rocof, 0.0, 0.0, 0.0, 0.0, 0.0),
        task.control_dt - unspent * simulation_dt,
        select(deviation > CONSTRAINT_FREQUENCY_HZ, 1.0, 0.0),
        0.0,
    )


@system(TASK, "farthest", when="charges worst")
def begin_farthest(coi: float) -> float:
    """Begin to look for the unit whose frequency is farthest from nominal with the centre of inertia."""
    return abs(coi - 1.0)


@system(WATCHED, "farthest", when="charges worst")
def farthest_machine(state: MachineState, given: MachineInput, farthest: float) -> float:
    """Compare a machine that is connected."""
    return max(farthest, given.connected * abs(state.speed - 1.0))


@system(ACTING, "farthest", when="charges worst")
def farthest_group(state: WtgState, given: WtgInput, output: WtgOutput, farthest: float) -> float:
    """Compare a WTG group that is connected."""
    return max(farthest, given.connected * abs(frequency_of(state, output) - 1.0))


@system(TASK, "term_rates", when="charges worst")
def charge_farthest(term_rates: CostTerms, farthest: float, task: Task) -> CostTerms:
    """Charge the frequency of that unit in place of the centre of inertia's."""
    return term_rates._replace(frequency=task.weights.frequency * frequency_cost(farthest * task.nominal_hz))


@system(ACTING, "deviations", "charged_duty", "there")
def find_deviations(
    state: WtgState, output: WtgOutput, turbine: Turbine, task: Task
) -> tuple[GroupDeviations, float, float]:
    """Find the deviations of a WTG group.

    The prescribed power is a share of the usable power. Usable is the available power, up to that of which a rotor with
    its nominal reserve captures as much as the pitch protection allows. A group that a protection has tripped captures
    nothing and is charged for it.
    """
    wind = output.wind
    available = turbine.rotor.available_per_cubic_wind * wind * wind * wind
    usable = min(available, turbine.pitch.power_limit / task.share_nominal)
    prescribed = usable * tracking_coefficient(
        frequency_of(state, output), task.share_min, task.share_nominal, task.share_max, turbine.converter.corners
    )
    ratio = tip_speed_ratio(state.rotor_speed, wind, turbine.rotor)
    best = turbine.rotor.tip_speed_ratio_opt
    low, high = 0.9 * best - ratio, ratio - 1.1 * turbine.rotor.tip_speed_ratio_limit
    # Above rated the pitch, not the rotor, keeps the tip-speed ratio low.
    low = select(state.pitch.pitch > turbine.limits.stall_pitch, 0.0, low)
    deviations = GroupDeviations(
        duty=(output.captured - prescribed) / (0.05 * available),
        rotor=max(0.0, max(low, high)) / (0.1 * best),
        overload=max(0.0, output.power - turbine.converter.overload) / 0.1,
        available=available,
    )
    return deviations, deviations.duty, 1.0


@system(SENSED, "deviations", "charged_duty", "there", "mean_duty")
def filter_duty(
    deviations: GroupDeviations,
    mean_duty: float,
    leaves_at: float,
    returns_at: float,
    step: float,
    was_active: float,
    task: Task,
) -> tuple[GroupDeviations, float, float, float]:
    """Charge the duty behind its filter, and a group that an event has disconnected nothing."""
    there = select((step <= leaves_at) | (step > returns_at), 1.0, 0.0)
    exempt: GroupDeviations = each(lambda deviation: there * deviation, deviations)
    duty = there * filtered_duty(mean_duty, exempt.duty, was_active > 0.5, task)
    return exempt, duty, there, duty


@system(ACTING, "term_rates", "violated", "error", "available_energy")
def charge_group(
    term_rates: CostTerms,
    violated: float,
    error: float,
    available_energy: float,
    deviations: GroupDeviations,
    charged_duty: float,
    there: float,
    group: GroupRows,
    share: float,
    elapsed: float,
    was_active: float,
    task: Task,
) -> tuple[CostTerms, float, float, float]:
    """Add the rates of a WTG group to those of the lane; actions of one that is not there cost nothing."""
    w, n_wtg = task.weights, task.n_groups
    on_k = there * w.effort * effort(group.action_k, group.last_action_k) / task.n_actions
    on_tau = there * w.effort * effort(group.action_tau, group.last_action_tau) / task.n_actions
    acted = term_rates.effort + select(task.modulates_k, on_k, 0.0)
    rates = term_rates._replace(
        duty=term_rates.duty + w.duty * duty_cost(charged_duty) / n_wtg,
        rotor=term_rates.rotor + w.rotor * deviations.rotor * deviations.rotor / n_wtg,
        overload=term_rates.overload + w.overload * deviations.overload * deviations.overload / n_wtg,
        effort=acted + select(task.modulates_tau, on_tau, 0.0),
    )
    return (
        rates,
        select((deviations.rotor > 0.0) | (deviations.overload > 0.0), 1.0, violated),
        error + 0.05 * abs(deviations.duty) / n_wtg,
        available_energy + select(was_active > 0.5, share * deviations.available * elapsed, 0.0),
    )


@system(ACTING, "group")
def remember_group(group: GroupRows, state: WtgState, output: WtgOutput, was_active: float, task: Task) -> GroupRows:
    """Remember a group's frequency and actions."""
    ran, speed = was_active > 0.5, frequency_of(state, output)
    change = (speed - group.last_speed) / task.control_dt
    return group._replace(
        last_speed=select(ran, speed, group.last_speed),
        rocof=select(ran, change * task.nominal_hz, group.rocof),
        last_action_k=select(ran, group.action_k, group.last_action_k),
        last_action_tau=select(ran, group.action_tau, group.last_action_tau),
    )


@system(TASK, "new_terms", when="charges capped")
def charge_interval(
    term_rates: CostTerms, elapsed: float, end_step: float, step: float, status: float, task: Task, simulation_dt: float
) -> CostTerms:
    """Find what the last control interval cost."""
    return interval_cost(term_rates, elapsed, (end_step - step) * simulation_dt, status != 0.0, task)


@system(TASK, "new_terms", when="charges worst")
def charge_open_interval(
    term_rates: CostTerms,
    sums: CostTerms,
    elapsed: float,
    unserved: float,
    end_step: float,
    status: float,
    task: Task,
    simulation_dt: float,
) -> CostTerms:
    """Find what the last control interval cost."""
    spent = _total_of_rates(sums) + sums.failure
    share = unserved * task.inv_load
    return open_cost(term_rates, elapsed, spent, share, end_step * simulation_dt, status != 0.0, task)


@system(TASK, "terms", "sums", "own_cost", "constraint", "constraint_sum", "duty_error")
def charge_lane(
    new_terms: CostTerms,
    terms: CostTerms,
    sums: CostTerms,
    constraint: float,
    constraint_sum: float,
    duty_error: float,
    violated: float,
    error: float,
    elapsed: float,
    status: float,
    was_active: float,
) -> tuple[CostTerms, CostTerms, float, float, float, float]:
    """Charge a lane that ran for the last control interval."""
    ran, failed, new = was_active > 0.5, status != 0.0, new_terms
    now = select(failed, 1.0, violated)
    return (
        each(lambda charged, before: select(ran, charged, before), new, terms),
        each(lambda charged, total: total + select(ran, charged, 0.0), new, sums),
        _total_of_rates(new) + new.failure,
        select(ran, now, constraint),
        constraint_sum + select(ran, now, 0.0),
        duty_error + select(ran, error * elapsed, 0.0),
    )


CHARGE = (
    count_interval,
    shift_history,
    rate_of_change,
    charge_frequency,
    begin_farthest,
    farthest_machine,
    farthest_group,
    charge_farthest,
    find_deviations,
    filter_duty,
    charge_group,
    remember_group,
    Here(Joining.CHARGE),
    charge_interval,
    charge_open_interval,
    charge_lane,
)
