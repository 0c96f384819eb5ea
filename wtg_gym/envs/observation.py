"""Observations and `info`: their equations over units, and the names of an observation's entries."""

from __future__ import annotations

from typing import TypeVar, get_type_hints

from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.envs.task_records import (
    Acted,
    CostTerms,
    GridObservation,
    GroupRows,
    Info,
    LocalInfo,
    MachineObservation,
    MeasuredObservation,
    Reach,
    Task,
    WtgObservation,
)
from wtg_gym.envs.task_units import ACTING, SENSED, TASK, WATCHED
from wtg_gym.physics.machine import Machine, MachineOutput, MachineState
from wtg_gym.physics.sensors import Measurement
from wtg_gym.physics.units import Joining
from wtg_gym.physics.wind_turbine import Rotor, Turbine, WtgOutput, WtgState, frequency_of, tip_speed_ratio
from wtg_gym.systems.elementary import clip, select
from wtg_gym.systems.programs import Here
from wtg_gym.systems.records import each, size
from wtg_gym.systems.systems import system

T = TypeVar("T")
#: Every entry of the observation is clipped to ± this.
OBSERVATION_BOUND = 5.0
#: Unit of frequency deviations [Hz].
FREQUENCY_UNIT_HZ = 0.5
#: Unit of deviations of the rotor speed from rated [p.u.].
ROTOR_SPEED_UNIT_PU = 0.25
N_LOCAL, N_MEASURED = size(WtgObservation), size(MeasuredObservation)


def bounded(observation: T) -> T:
    """Return an observation, each entry clipped."""
    clipped: T = each(lambda value: clip(value, -OBSERVATION_BOUND, OBSERVATION_BOUND), observation)
    return clipped


def _scaled_ratio(rotor_speed: float, wind: float, c: Rotor) -> float:
    ratio = tip_speed_ratio(rotor_speed, wind, c)
    return (ratio - c.tip_speed_ratio_opt) / (c.tip_speed_ratio_limit - c.tip_speed_ratio_opt)


def _scaled_rotor_speed(rotor_speed: float) -> float:
    return (rotor_speed - 1.0) / ROTOR_SPEED_UNIT_PU


def _scaled_wind(wind: float) -> float:
    return (wind - 10.0) / 5.0


def observe_measured(m: Measurement, wind_sensor: float, t: Turbine, task: Task) -> MeasuredObservation:
    """Return the observation of what a WTG group measures; without a wind sensor, wind and ratio are 0."""
    return bounded(
        MeasuredObservation(
            frequency_deviation=(m.frequency - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
            rocof=m.rocof,
            tip_speed_ratio=wind_sensor * _scaled_ratio(m.rotor_speed, m.wind, t.rotor),
            rotor_speed=_scaled_rotor_speed(m.rotor_speed),
            power=m.power,
            wind=wind_sensor * _scaled_wind(m.wind),
        )
    )


@system(ACTING, "observed", when="exact observation")
def observe_group(
    state: WtgState, output: WtgOutput, group: GroupRows, turbine: Turbine, reach: Reach, task: Task
) -> WtgObservation:
    """Return the exact observation of a WTG group."""
    return bounded(
        WtgObservation(
            frequency_deviation=(frequency_of(state, output) - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
            rocof=group.rocof,
            tip_speed_ratio=_scaled_ratio(state.rotor_speed, output.wind, turbine.rotor),
            rotor_speed=_scaled_rotor_speed(state.rotor_speed),
            power=output.power,
            wind=_scaled_wind(output.wind),
            coefficient=(output.coefficient - reach.k_low) / reach.k_span,
            filter_state=state.converter.filter * task.nominal_hz / FREQUENCY_UNIT_HZ,
        )
    )


@system(ACTING, "shown_actions")
def show_actions(last_action_k: float, last_action_tau: float) -> Acted:
    """Return the last actions of a WTG group."""
    return Acted(last_action_k, last_action_tau)


@system(SENSED, "shown_duty")
def show_duty(mean_duty: float) -> float:
    """Return the duty error that is charged."""
    return clip(mean_duty, -OBSERVATION_BOUND, OBSERVATION_BOUND)


@system(WATCHED, "machine_observed", when="privileged")
def observe_machine(state: MachineState, output: MachineOutput, machine: Machine, task: Task) -> MachineObservation:
    """Return the observation of a synchronous machine."""
    return bounded(
        MachineObservation(
            speed=(state.speed - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
            power=output.power / machine.rating,
            voltage=(output.voltage - 1.0) / 0.1,
        )
    )


@system(TASK, "total_torque")
def begin_torque() -> float:
    """Begin to add the torques of all machines."""
    return 0.0


@system(WATCHED, "total_torque")
def add_torque(total_torque: float, output_torque: float) -> float:
    """Add the torque of a machine."""
    return total_torque + output_torque


@system(TASK, "grid_observed", when="privileged")
def observe_grid(coi: float, own_rocof: float, total_torque: float, task: Task) -> GridObservation:
    """Return the observation of the grid."""
    return bounded(
        GridObservation((coi - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ, own_rocof, task.inv_torque * total_torque)
    )


@system(TASK, "info")
def inform(
    step: float, coi: float, own_rocof: float, constraint: float, terms: CostTerms, task: Task, simulation_dt: float
) -> Info:
    """Return the numbers of `info`; its last are the terms of the cost, in their order."""
    return Info(step * simulation_dt, task.nominal_hz * coi, own_rocof, constraint, *terms)


@system(TASK, "local_info", when="extended")
def inform_of_places(worst: float, shed_energy: float, base_mva: float, task: Task) -> LocalInfo:
    """Return what `info` has besides in extended physics."""
    return LocalInfo(task.nominal_hz * worst, base_mva * shed_energy)


@system(TASK, "active")
def end_episode(active: float, was_active: float, step: float, end_step: float) -> float:
    """Let a lane at its end stand still until it is started again."""
    return select((was_active > 0.5) & (step >= end_step - 0.5), 0.0, active)


OBSERVE = (
    observe_group,
    show_actions,
    show_duty,
    observe_machine,
    begin_torque,
    add_torque,
    observe_grid,
    Here(Joining.OBSERVE),
    inform,
    inform_of_places,
)


def observation_names(n_wtg: int, n_sync: int, action_mode: str, *, privileged: bool, sensed: bool) -> list[str]:
    """Return the names of the observation's entries, with the unit each is counted in.

    `wtg0` is group 1 of commands and pictures. With sensors a group has what they say; the privileged part then begins
    with the exact values, as "exact0" and so on, and the duty error that is charged.
    """
    actions = [
        f"last_action_{name}" for name, used in zip(("k", "tau"), ACTION_MODES[action_mode], strict=True) if used
    ]
    names = []
    for j in range(n_wtg):
        seen = _names(f"wtg{j}", MeasuredObservation if sensed else WtgObservation)
        names += [*seen, *(f"wtg{j}.{action}" for action in actions)]
    if privileged:
        for j in range(n_wtg if sensed else 0):
            names += [*_names(f"exact{j}", WtgObservation), f"exact{j}.mean_duty [0.05 of the available power]"]
        for i in range(n_sync):
            names += _names(f"sync{i}", MachineObservation)
        names += _names("grid", GridObservation)
    return names


def _names(owner: str, record: type) -> list[str]:
    hints = get_type_hints(record, include_extras=True)
    return [f"{owner}.{name} [{hint.__metadata__[0]}]" for name, hint in hints.items()]
