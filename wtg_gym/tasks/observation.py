"""Observations and `info`: records, their equations, and the names of an observation's entries.

A new entry is a field of a record here, with its unit, and a line in the equation below it. Observations through
sensors, as in v1, are in :mod:`wtg_gym.tasks.measured_observation`.
"""

from typing import Annotated, Any, NamedTuple, TypeVar

import numpy.typing as npt

from wtg_gym.physics.machine import Machine, MachineOutput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.sensors import Measurement
from wtg_gym.physics.units import ENV
from wtg_gym.physics.wind_turbine import Rotor, Turbine, WtgOutput, WtgState, frequency_of, tip_speed_ratio
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.elementary import clip
from wtg_gym.systems.systems import Kind, each, system
from wtg_gym.tasks.cost import COST, COST_TERMS, FILTERED_DUTY, CostTerms
from wtg_gym.tasks.episode import ACTING, ACTION_MODES, TASK, GroupRows, Reach, TaskConstants

OBSERVATION_MODES = ("local", "privileged")
T = TypeVar("T")
R = TypeVar("R", bound=tuple[Any, ...])
#: Every entry of the observation is clipped to ± this.
OBSERVATION_BOUND = 5.0
#: Unit of frequency deviations [Hz].
FREQUENCY_UNIT_HZ = 0.5
#: Unit of deviations of the rotor speed from rated [p.u.].
ROTOR_SPEED_UNIT_PU = 0.25


def bounded(observation: T) -> T:
    """Return an observation, each entry clipped."""
    clipped: T = each(lambda value: clip(value, -OBSERVATION_BOUND, OBSERVATION_BOUND), observation)
    return clipped


def exact_measurement(state: WtgState, output: WtgOutput, group: GroupRows) -> Measurement:
    """Return what a WTG group would measure without errors."""
    return Measurement(frequency_of(state, output), group.rocof, state.rotor_speed, output.power, output.wind)


def shown(m: Measurement, rotor: Rotor, task: TaskConstants) -> tuple[float, float, float, float, float, float]:
    """Return a measurement in the units of observations, in the order of their first six entries."""
    ratio, best = tip_speed_ratio(m.rotor_speed, m.wind, rotor), rotor.tip_speed_ratio_opt
    return (
        (m.frequency - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
        m.rocof,
        (ratio - best) / (rotor.tip_speed_ratio_limit - best),
        (m.rotor_speed - 1.0) / ROTOR_SPEED_UNIT_PU,
        m.power,
        (m.wind - 10.0) / 5.0,
    )


def of_groups(observation: npt.NDArray[Any], record: type[R], action_mode: str) -> R:
    """Return what every WTG group shows in a local observation (..., n_observation): a record of arrays (..., n_wtg).

    The record is :class:`WtgObservation` in v0, in v1 `MeasuredObservation`. The last actions of the action mode stand
    behind each group's numbers. A ValueError says that the numbers do not fit.
    """
    n = len(record._fields)  # type: ignore[attr-defined]
    n_each, n_all = n + sum(ACTION_MODES[action_mode]), observation.shape[-1]
    if n_all % n_each:
        raise ValueError(
            f"observations of {n_all} numbers are not of groups with {n_each} each: is action_mode={action_mode!r} "
            "that of the entry, and observation_mode local?"
        )
    groups = observation.reshape(*observation.shape[:-1], -1, n_each)
    return record(*(groups[..., i] for i in range(n)))


class WtgObservation(NamedTuple):
    """Local measurements of a WTG group, each with its unit and meaning."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the converter, minus nominal"]
    rocof: Annotated[float, "Hz/s", "rate of change of that frequency over the last step"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr", "speed of the blade tips over wind speed"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u.", "rotor speed"]
    power: Annotated[float, "p.u.", "power into the grid"]
    wind: Annotated[float, "5 m/s from 10 m/s", "wind, averaged over the rotor"]
    coefficient: Annotated[float, "0 at K_pr, 1 at K_opt", "k in use"]
    filter_state: Annotated[float, "0.5 Hz", "state of the damping filter"]


class ActionObservation(NamedTuple):
    """The last actions of a WTG group."""

    last_action_k: float
    last_action_tau: float


class DutyObservation(NamedTuple):
    """The duty error of a WTG group that is charged."""

    mean_duty: Annotated[float, "0.05 of the available power", "captured less prescribed power behind its filter"]


OBSERVED = Kind(
    name="observed groups",
    scratch={"observed": WtgObservation, "shown_actions": ActionObservation},
    sees={"acting": ACTING, "group": GROUPS, "task": TASK, "env": ENV},
)
OBSERVED_DUTY = Kind(
    name="observed duties", scratch={"shown_duty": DutyObservation}, sees={"filtered": FILTERED_DUTY, "task": TASK}
)


@system(OBSERVED, "observed", when="observes exactly")
def observe_group(
    state: WtgState, output: WtgOutput, group: GroupRows, turbine: Turbine, reach: Reach, task: TaskConstants
) -> WtgObservation:
    return bounded(
        WtgObservation(
            *shown(exact_measurement(state, output, group), turbine.rotor, task),
            coefficient=(output.coefficient - reach.k_low) / reach.k_span,
            filter_state=state.converter.filter * task.nominal_hz / FREQUENCY_UNIT_HZ,
        )
    )


@system(OBSERVED, "shown_actions")
def show_actions(group: GroupRows) -> ActionObservation:
    return ActionObservation(group.last_action_k, group.last_action_tau)


@system(OBSERVED_DUTY, "shown_duty")
def show_duty(filtered_mean_duty: float) -> DutyObservation:
    return bounded(DutyObservation(filtered_mean_duty))


class MachineObservation(NamedTuple):
    """A synchronous machine, in the privileged observation."""

    speed: Annotated[float, "0.5 Hz", "speed as a frequency, minus nominal"]
    power: Annotated[float, "rating", "power into the grid"]
    voltage: Annotated[float, "0.1 p.u. from 1 p.u.", "voltage at the terminal"]


class GridObservation(NamedTuple):
    """The grid, in the privileged observation."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the centre of inertia, minus nominal"]
    rocof: Annotated[float, "Hz/s", "rate of change of that frequency over 0.5 s"]
    torque: Annotated[float, "100 MVA", "mechanical torque of all machines; elsewhere in 39 % of the load"]


OBSERVED_GRID = Kind(
    name="observed grids",
    scratch={"total_torque": float, "grid_observed": GridObservation},  # torque of all machines [p.u.]
    constants={"inv_torque": float},  # 1 / what the torque is counted in [1/p.u.]
    sees={"task": TASK, "env": ENV},
)
OBSERVED_MACHINES = Kind(
    name="observed machines",
    scratch={"machine_observed": MachineObservation},
    sees={"machine": MACHINES, "grid": OBSERVED_GRID, "task": TASK, "env": ENV},
)


@system(OBSERVED_MACHINES, "machine_observed", when="privileged")
def observe_machine(
    state: MachineState, output: MachineOutput, machine: Machine, task: TaskConstants
) -> MachineObservation:
    return bounded(
        MachineObservation(
            speed=(state.speed - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
            power=output.power / machine.rating,
            voltage=(output.voltage - 1.0) / 0.1,
        )
    )


@system(OBSERVED_GRID, "total_torque")
def start_torque() -> float:
    return 0.0


@system(OBSERVED_MACHINES, "total_torque")
def add_torque(total_torque: float, output_torque: float) -> float:
    return total_torque + output_torque


@system(OBSERVED_GRID, "grid_observed", when="privileged")
def observe_grid(
    coi: float, task_rocof: float, total_torque: float, inv_torque: float, task: TaskConstants
) -> GridObservation:
    deviation = (coi - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ
    return bounded(GridObservation(deviation, task_rocof, inv_torque * total_torque))


class Info(NamedTuple):
    """The numbers of `info`, with their units and meanings; the terms of the cost follow."""

    time_s: Annotated[float, "s", "time since the start of the episode"]
    frequency_hz: Annotated[float, "Hz", "frequency of the centre of inertia"]
    rocof_hz_s: Annotated[float, "Hz/s", "rate of change of that frequency over 0.5 s"]
    cost: Annotated[
        float,
        "-",
        "1 for a step with a failure, an overload, a frequency beyond 50 ± 0.8 Hz or a tip-speed ratio outside its "
        "range, else 0",
    ]


class LocalInfo(NamedTuple):
    """Further numbers of `info`, in extended physics."""

    worst_frequency_hz: Annotated[float, "Hz", "frequency with the largest deviation of any bus or unit"]
    shed_energy_mws: Annotated[float, "MW s", "load not served since the start, at 1 p.u. of voltage"]


#: Keys of `info` for every step; those of :class:`LocalInfo` follow.
INFO_KEYS = (*Info._fields, *(f"cost_{term}" for term in COST_TERMS))
INFO = Kind(
    name="information",
    scratch={"info": Info, "info_terms": CostTerms, "local_info": LocalInfo},  # each follows the one before
    sees={"cost": COST, "task": TASK, "env": ENV},
)


@system(INFO, "info", "info_terms")
def inform(
    step: float,
    coi: float,
    task_rocof: float,
    constraint: float,
    terms: CostTerms,
    task: TaskConstants,
    simulation_dt: float,
) -> tuple[Info, CostTerms]:
    return Info(step * simulation_dt, task.nominal_hz * coi, task_rocof, constraint), terms


@system(INFO, "local_info", when="extended")
def inform_of_places(worst: float, shed_energy: float, base_mva: float, task: TaskConstants) -> LocalInfo:
    return LocalInfo(task.nominal_hz * worst, base_mva * shed_energy)
