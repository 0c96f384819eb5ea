"""The cost of one control interval, term by term.

The cost is a rate [1/s] times the time that passed; the terms' weights and the cap are those of
:class:`~wtg_gym.envs.settings.CostWeights`.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.envs.task_records import CostTerms, GroupRows, Task
from wtg_gym.physics.converter import tracking_coefficient
from wtg_gym.physics.wind_turbine import Turbine, WtgOutput, WtgState, frequency_of, tip_speed_ratio
from wtg_gym.systems.elementary import select

#: Frequency deviation beyond which the constraint cost counts [Hz]: ENTSO-E's steady-state limit is 0.2, its
#: instantaneous limit 0.8 Hz.
CONSTRAINT_FREQUENCY_HZ = 0.8


class GroupDeviations(NamedTuple):
    """Deviations of one WTG group, in the units of its costs, and its available power [p.u.]."""

    duty: float  # captured less prescribed power, 0.05 of the available power
    rotor: float  # tip-speed ratio outside its band, 0.1 λ_opt
    overload: float  # power beyond the converter's limit, 0.1 p.u.
    available: float


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


def group_deviations(s: WtgState, output: WtgOutput, t: Turbine, task: Task) -> GroupDeviations:
    """Return the deviations of one WTG group.

    The prescribed power is a share of the usable power. Usable is the available power, up to that of which a rotor with
    its nominal reserve captures as much as the pitch protection allows. A group that a protection has tripped captures
    nothing and is charged for it; one that an event has disconnected is exempt, see :mod:`wtg_gym.envs.charging`.
    """
    wind = output.wind
    available = t.rotor.available_per_cubic_wind * wind * wind * wind
    usable = min(available, t.pitch.power_limit / task.share_nominal)
    prescribed = usable * tracking_coefficient(
        frequency_of(s, output), task.share_min, task.share_nominal, task.share_max, t.converter.corners
    )
    ratio = tip_speed_ratio(s.rotor_speed, wind, t.rotor)
    best = t.rotor.tip_speed_ratio_opt
    low, high = 0.9 * best - ratio, ratio - 1.1 * t.rotor.tip_speed_ratio_limit
    # Above rated the pitch, not the rotor, keeps the tip-speed ratio low.
    low = select(s.pitch.pitch > t.limits.stall_pitch, 0.0, low)
    return GroupDeviations(
        duty=(output.captured - prescribed) / (0.05 * available),
        rotor=max(0.0, max(low, high)) / (0.1 * best),
        overload=max(0.0, output.power - t.converter.overload) / 0.1,
        available=available,
    )


def effort(action: float, last: float) -> float:
    """Return the cost of an action and of its change."""
    change = action - last
    return action * action + 4.0 * change * change


def add_group_costs(
    terms: CostTerms, costs: GroupDeviations, duty: float, there: float, group: GroupRows, task: Task
) -> CostTerms:
    """Return the terms with the costs of one WTG group added.

    Args:
        terms: rates of the terms so far [1/s].
        costs: the group's deviations.
        duty: the group's duty error, in v1 filtered.
        there: 0 for a group that an event has disconnected: its actions move nothing and cost nothing. Else 1.
        group: its actions.
        task: constants.
    """
    w, n_wtg = task.weights, task.n_groups
    on_k = there * w.effort * effort(group.action_k, group.last_action_k) / task.n_actions
    on_tau = there * w.effort * effort(group.action_tau, group.last_action_tau) / task.n_actions
    acted = terms.effort + select(task.modulates_k, on_k, 0.0)
    return CostTerms(
        frequency=terms.frequency,
        rocof=terms.rocof,
        duty=terms.duty + w.duty * duty_cost(duty) / n_wtg,
        rotor=terms.rotor + w.rotor * costs.rotor * costs.rotor / n_wtg,
        overload=terms.overload + w.overload * costs.overload * costs.overload / n_wtg,
        effort=acted + select(task.modulates_tau, on_tau, 0.0),
        failure=terms.failure,
    )


def interval_cost(terms: CostTerms, elapsed: float, unserved: float, failed: bool, task: Task) -> CostTerms:
    """Return the terms of the cost of an interval.

    Args:
        terms: rates of all terms but failure [1/s].
        elapsed: time that passed [s].
        unserved: time that a failed episode leaves [s]; a failure costs the cap for this time and 1 s more.
        failed: whether the episode has failed.
        task: constants. The cap scales all terms alike, so that they still add up to the cost.
    """
    total = terms.frequency + terms.rocof + terms.duty + terms.rotor + terms.overload + terms.effort
    factor = elapsed * select(total > 0.0, min(total, task.weights.cap) / total, 1.0)
    return CostTerms(
        frequency=terms.frequency * factor,
        rocof=terms.rocof * factor,
        duty=terms.duty * factor,
        rotor=terms.rotor * factor,
        overload=terms.overload * factor,
        effort=terms.effort * factor,
        failure=select(failed, task.weights.cap * (unserved + 1.0), 0.0),
    )


def total_cost(terms: CostTerms) -> float:
    """Return the sum of all terms."""
    rates = terms.frequency + terms.rocof + terms.duty + terms.rotor + terms.overload + terms.effort
    return rates + terms.failure
