"""The cost of one control interval, term by term.

The cost is a rate [1/s] times the time that passed. A term is a field of :class:`CostTerms`, a weight in
:class:`CostWeights`, and an equation; the total and `info` take all fields. Version v0 charges the frequency of the
centre of inertia and caps the cost; version v1 charges that of the unit with the largest deviation, and load that is
not served.
"""

import math
from typing import Annotated, NamedTuple

from wtg_gym.physics.converter import tracking_coefficient
from wtg_gym.physics.machine import MachineInput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.units import ENV
from wtg_gym.physics.wind_turbine import Turbine, WtgInput, WtgOutput, WtgState, frequency_of, tip_speed_ratio
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.ranges import require_range
from wtg_gym.systems.elementary import select
from wtg_gym.systems.systems import Kind, each, system
from wtg_gym.tasks.episode import ACTING, TASK, GroupRows, TaskConstants

#: Frequency deviation beyond which the constraint cost counts [Hz]: ENTSO-E's steady-state limit is 0.2, its
#: instantaneous limit 0.8 Hz.
CONSTRAINT_FREQUENCY_HZ = 0.8


class CostTerms(NamedTuple):
    """Terms of the cost."""

    frequency: float = 0.0  # deviation of the frequency, in v1 the largest of any unit
    rocof: float = 0.0  # rate of change of frequency
    duty: float = 0.0  # captured minus prescribed power, in v1 filtered with 15 s
    rotor: float = 0.0  # tip-speed ratio outside its range
    overload: float = 0.0  # power above 1.05 p.u., in v0 1.1 p.u.
    effort: float = 0.0  # actions and their changes
    failure: float = 0.0  # failure at the end; in v1 also load not served


COST_TERMS = CostTerms._fields


class CostWeights(NamedTuple):
    """Weights of the cost's terms. Each is a rate [1/s] at the deviation that its text names as one unit."""

    frequency: Annotated[
        float,
        "one at ±0.2 Hz, where European primary reserve is fully active; quadratic inside, four times as steep "
        "as at that edge outside",
    ] = 1.0
    rocof: Annotated[
        float, "one unit at 0.2 Hz/s over 500 ms, squared; loss-of-mains relays act from 0.5 … 1 Hz/s on"
    ] = 4.0
    duty: Annotated[
        float,
        "one unit at a captured power 5 % of the available away from what the prescribed characteristic asks: the "
        "reserve that a unit is paid to hold. In v0 its weight is twice that of the frequency: a unit controls its "
        "reserve alone, but the frequency only together with all others",
    ] = 2.0
    rotor: Annotated[
        float,
        "one unit at a tip-speed ratio 10 % of λ_opt beyond 0.9 λ_opt … 1.1 λ_pr, squared: low speed leads to "
        "stall, high speed loads the structure",
    ] = 5.0
    overload: Annotated[
        float,
        "one unit at 0.1 p.u. of power above 1.1 p.u., squared. A converter at its current limit, which v0 does "
        "not model, no longer forms the grid: 1.2 p.u. costs about what 0.4 Hz of deviation do",
    ] = 10.0
    effort: Annotated[
        float,
        "one unit at full action, four at a change by 1 within a step: a tie-breaker that keeps unused actions at "
        "zero and discourages chatter",
    ] = 0.05
    cap: Annotated[
        float,
        "upper limit of the cost rate. A failed episode pays it for the time that was left plus 1 s, so failing never "
        "pays off. In v1 it limits all terms but frequency and load not served",
    ] = 50.0
    unserved: Annotated[
        float,
        "in v1 alone: one unit where the whole load is not served. The first stage of shedding, 5 %, costs what "
        "0.55 Hz of deviation do: it does not pay to have load shed",
    ] = 300.0
    failure: Annotated[
        float,
        "in v1 alone: largest cost rate of a running episode, above that of the frequency at its limits, all stages "
        "of shedding and all other terms at their cap together; a failed episode costs this for its whole length and "
        "one second more",
    ] = 250.0

    def checked(self) -> "CostWeights":
        """Return the weights as floats; a ValueError names one outside 0 … 1e6 1/s; the cap is 1e-3 1/s or more."""
        lows = {"cap": 1e-3}
        values = self._asdict().items()
        checked = (require_range(f"weights: {name}", value, lows.get(name, 0.0), 1e6, "1/s") for name, value in values)
        return CostWeights(*checked)


class GroupDeviations(NamedTuple):
    """Deviations of one WTG group, in the units of its costs, and its available power [p.u.]."""

    duty: float  # captured less prescribed power, 0.05 of the available power
    rotor: float  # tip-speed ratio outside its band, 0.1 λ_opt
    overload: float  # power beyond the converter's limit, 0.1 p.u.
    available: float
    charged: float  # the duty that is charged, in v1 filtered
    connected: float  # 0 for a group that an event has disconnected, else 1


class IntervalCost(NamedTuple):
    """A control interval that is being charged, besides its rates."""

    elapsed: float  # how long it lasted [s]
    violated: float  # 1 where it violated a constraint
    error: float  # duty error, mean over groups [-]


#: The cost of an environment.
COST = Kind(
    name="costs",
    rows={
        "sums": CostTerms,  # over the episode
        "terms": CostTerms,  # of the last step
        "cost": float,  # of the last step
        "constraint": float,  # 1 where the last step violated a constraint
        "constraint_sum": float,
        "available_energy": float,  # of all groups [p.u. s of the system base]
        "duty_error": float,  # ∫ |captured - prescribed| / available dt, mean over groups [s]
    },
    scratch={
        "term_rates": CostTerms,  # of the interval that is being charged [1/s]
        "interval_cost": IntervalCost,
        "new_terms": CostTerms,  # what the interval costs
        "largest_deviation": float,  # of the frequency of any unit [p.u.]
    },
    constants={"weights": CostWeights},
    sees={"task": TASK, "env": ENV},
)
#: The part of a WTG group in the cost.
GROUP_COST = Kind(
    name="costs of groups",
    scratch={"deviations": GroupDeviations},
    sees={"acting": ACTING, "group": GROUPS, "cost": COST, "task": TASK, "env": ENV},
)
#: The part of a synchronous machine in the cost.
MACHINE_COST = Kind(name="costs of machines", sees={"machine": MACHINES, "cost": COST, "task": TASK, "env": ENV})
#: The duty error of a WTG group behind a filter.
FILTERED_DUTY = Kind(
    name="filtered duties",
    rows={
        "leaves_at": float,  # simulation step at which an event disconnects the group
        "mean_duty": float,  # signed, 0.05 of the available power
    },
    sees={"charged": GROUP_COST, "task": TASK, "env": ENV},
)


def _frequency_cost(deviation: float, task: TaskConstants, weights: CostWeights) -> float:
    """Return the rate of a frequency deviation [p.u.]: quadratic within 0.2 Hz, linear and steeper outside."""
    ratio = deviation * task.nominal_hz / 0.2
    return weights.frequency * select(ratio < 1.0, ratio * ratio, 1.0 + 8.0 * (ratio - 1.0))


def _effort(action: float, last: float) -> float:
    change = action - last
    return action * action + 4.0 * change * change


def _capped(terms: CostTerms, elapsed: float, most: float) -> CostTerms:
    """Return what rates cost in a time that passed [s], all scaled alike so that their sum is at most `most` [1/s]."""
    total = sum(terms)
    factor = elapsed * select(total > 0.0, min(total, most) / total, 1.0)
    charged: CostTerms = each(lambda rate: rate * factor, terms)
    return charged


@system(COST, "term_rates", "interval_cost")
def charge_frequency(
    step: float, coi: float, task_rocof: float, task: TaskConstants, weights: CostWeights, simulation_dt: float
) -> tuple[CostTerms, IntervalCost]:
    """Begin the rates of the cost with those of the frequency, and find how long the interval lasted."""
    deviation, ratio = abs(coi - 1.0), task_rocof / 0.2
    rates = CostTerms(_frequency_cost(deviation, task, weights), weights.rocof * (ratio * ratio))
    # A run can end within the interval: the time after that is the failure's.
    unspent = math.ceil(step / task.n_substeps) * task.n_substeps - step
    violated = select(deviation * task.nominal_hz > CONSTRAINT_FREQUENCY_HZ, 1.0, 0.0)
    return rates, IntervalCost(task.interval_s - unspent * simulation_dt, violated, 0.0)


@system(COST, "largest_deviation")
def start_largest_deviation(coi: float) -> float:
    """Start the search for the largest deviation of any unit with that of the centre of inertia."""
    return abs(coi - 1.0)


@system(MACHINE_COST, "largest_deviation")
def compare_machine(state: MachineState, inputs: MachineInput, largest_deviation: float) -> float:
    return max(largest_deviation, inputs.connected * abs(state.speed - 1.0))


@system(GROUP_COST, "largest_deviation")
def compare_group(state: WtgState, inputs: WtgInput, output: WtgOutput, largest_deviation: float) -> float:
    return max(largest_deviation, inputs.connected * abs(frequency_of(state, output) - 1.0))


@system(COST, "term_rates")
def charge_largest_deviation(
    term_rates: CostTerms, largest_deviation: float, task: TaskConstants, weights: CostWeights
) -> CostTerms:
    """Charge that deviation in place of the centre of inertia's."""
    return term_rates._replace(frequency=_frequency_cost(largest_deviation, task, weights))


def _deviations(
    frequency: float, state: WtgState, output: WtgOutput, turbine: Turbine, task: TaskConstants
) -> GroupDeviations:
    """Return the deviations of a WTG group.

    The prescribed power is a share of the usable power: the available power, at most that of which a rotor with its
    nominal reserve captures what the pitch protection allows, P_limit / share_nominal. A group that a protection has
    tripped captures nothing and is charged for it.
    """
    wind = output.wind
    available = turbine.rotor.available_per_cubic_wind * wind * wind * wind
    usable = min(available, turbine.pitch.power_limit / task.share_nominal)
    prescribed = usable * tracking_coefficient(
        frequency, task.share_min, task.share_nominal, task.share_max, turbine.converter.corners
    )
    ratio = tip_speed_ratio(state.rotor_speed, wind, turbine.rotor)
    best = turbine.rotor.tip_speed_ratio_opt
    low, high = 0.9 * best - ratio, ratio - 1.1 * turbine.rotor.tip_speed_ratio_limit
    # Above rated the pitch, not the rotor, keeps the tip-speed ratio low.
    low = select(state.pitch.pitch > turbine.limits.stall_pitch, 0.0, low)
    duty = (output.captured - prescribed) / (0.05 * available)
    rotor = max(0.0, max(low, high)) / (0.1 * best)
    overload = max(0.0, output.power - turbine.converter.overload_limit) / 0.1
    return GroupDeviations(duty, rotor, overload, available, charged=duty, connected=1.0)


@system(GROUP_COST, "deviations")
def find_deviations(state: WtgState, output: WtgOutput, turbine: Turbine, task: TaskConstants) -> GroupDeviations:
    return _deviations(frequency_of(state, output), state, output, turbine, task)


@system(GROUP_COST, "deviations")
def find_deviations_at_grid_frequency(
    state: WtgState, inputs: WtgInput, output: WtgOutput, coi: float, turbine: Turbine, task: TaskConstants
) -> GroupDeviations:
    """Find them at the grid's frequency where the group is disconnected: its own no longer moves."""
    frequency = select(inputs.connected > 0.5, frequency_of(state, output), coi)
    return _deviations(frequency, state, output, turbine, task)


@system(FILTERED_DUTY, "deviations", "mean_duty")
def filter_duty(
    deviations: GroupDeviations,
    mean_duty: float,
    leaves_at: float,
    step: float,
    was_active: float,
    task: TaskConstants,
) -> tuple[GroupDeviations, float]:
    """Charge the filtered duty; a group that an event has disconnected is charged nothing.

    An interval that ends early counts as a whole one.
    """
    connected = select(step <= leaves_at, 1.0, 0.0)
    exempt: GroupDeviations = each(lambda deviation: connected * deviation, deviations)
    duty = connected * (mean_duty + select(was_active > 0.5, task.duty_gain, 0.0) * (exempt.duty - mean_duty))
    return exempt._replace(charged=duty, connected=connected), duty


@system(GROUP_COST, "term_rates", "interval_cost", "available_energy")
def charge_group(
    term_rates: CostTerms,
    interval_cost: IntervalCost,
    available_energy: float,
    deviations: GroupDeviations,
    group: GroupRows,
    share: float,
    was_active: float,
    task: TaskConstants,
    weights: CostWeights,
) -> tuple[CostTerms, IntervalCost, float]:
    """Add the rates of a WTG group to those of the environment; actions of one that is disconnected cost nothing.

    The cost of duty is quadratic within one unit, linear outside (Huber).
    """
    d, w, n_wtg, size = deviations, weights, task.n_groups, abs(deviations.charged)
    on_k = d.connected * w.effort * _effort(group.action_k, group.last_action_k) / task.n_actions
    on_tau = d.connected * w.effort * _effort(group.action_tau, group.last_action_tau) / task.n_actions
    acted = term_rates.effort + select(task.modulates_k, on_k, 0.0)
    rates = term_rates._replace(
        duty=term_rates.duty + w.duty * select(size < 1.0, size * size, 2.0 * size - 1.0) / n_wtg,
        rotor=term_rates.rotor + w.rotor * d.rotor * d.rotor / n_wtg,
        overload=term_rates.overload + w.overload * d.overload * d.overload / n_wtg,
        effort=acted + select(task.modulates_tau, on_tau, 0.0),
    )
    elapsed, violated, error = interval_cost
    violated = select((d.rotor > 0.0) | (d.overload > 0.0), 1.0, violated)
    charged = IntervalCost(elapsed, violated, error + 0.05 * abs(d.duty) / n_wtg)
    return rates, charged, available_energy + select(was_active > 0.5, share * d.available * elapsed, 0.0)


@system(COST, "new_terms")
def charge_interval(
    term_rates: CostTerms,
    elapsed: float,
    end_step: float,
    step: float,
    status: float,
    weights: CostWeights,
    simulation_dt: float,
) -> CostTerms:
    """Find what the last control interval cost; a failure costs the cap for the time that is left and 1 s more."""
    failure = weights.cap * ((end_step - step) * simulation_dt + 1.0)
    return _capped(term_rates, elapsed, weights.cap)._replace(failure=select(status != 0.0, failure, 0.0))


@system(COST, "new_terms")
def charge_interval_partly_capped(
    term_rates: CostTerms,
    sums: CostTerms,
    elapsed: float,
    unserved: float,
    end_step: float,
    status: float,
    task: TaskConstants,
    weights: CostWeights,
    simulation_dt: float,
) -> CostTerms:
    """Find what the last control interval cost, where the cap is not for the frequency and load not served.

    The largest rate scales all terms alike. A failed episode costs that for its whole duration and 1 s more; in the
    interval of a failure, which may be a numerical one, nothing else is charged.
    """
    rates = _capped(term_rates._replace(frequency=0.0), 1.0, weights.cap)
    missed = weights.unserved * min(unserved * task.inv_load, 1.0)
    charged = _capped(rates._replace(frequency=term_rates.frequency, failure=missed), elapsed, weights.failure)
    missing, failed = weights.failure * (end_step * simulation_dt + 1.0) - sum(sums), status != 0.0
    kept: CostTerms = each(lambda term: select(failed, 0.0, term), charged)
    return kept._replace(failure=select(failed, missing, charged.failure))


@system(COST, "terms", "sums", "own_cost", "constraint", "constraint_sum", "duty_error")
def charge_env(
    new_terms: CostTerms,
    terms: CostTerms,
    sums: CostTerms,
    constraint: float,
    constraint_sum: float,
    duty_error: float,
    interval_cost: IntervalCost,
    status: float,
    was_active: float,
) -> tuple[CostTerms, CostTerms, float, float, float, float]:
    """Charge an environment that ran for the last control interval."""
    ran, violated = was_active > 0.5, select(status != 0.0, 1.0, interval_cost.violated)
    return (
        each(lambda charged, before: select(ran, charged, before), new_terms, terms),
        each(lambda charged, total: total + select(ran, charged, 0.0), new_terms, sums),
        sum(new_terms),
        select(ran, violated, constraint),
        constraint_sum + select(ran, violated, 0.0),
        duty_error + select(ran, interval_cost.error * interval_cost.elapsed, 0.0),
    )
