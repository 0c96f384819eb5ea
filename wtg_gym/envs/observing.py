"""Systems of the observation and of `info`; the equations are in :mod:`wtg_gym.envs.observation`."""

from __future__ import annotations

from wtg_gym.envs.observation import (
    OBSERVATION_BOUND,
    GridObservation,
    MachineObservation,
    WtgObservation,
    bounded,
    observe_grid,
    observe_machine,
    observe_wtg,
)
from wtg_gym.envs.task_records import Acted, CostTerms, GroupRows, Info, LocalInfo, Task
from wtg_gym.envs.task_units import ACTING, SENSED, TASK, WATCHED
from wtg_gym.physics.machine import Machine, MachineOutput, MachineState
from wtg_gym.physics.wind_turbine import Turbine, WtgOutput, WtgState
from wtg_gym.systems.elementary import clip, select
from wtg_gym.systems.programs import Here
from wtg_gym.systems.systems import system


@system(ACTING, "observed", when="exact observation")
def observe_group(state: WtgState, output: WtgOutput, group: GroupRows, turbine: Turbine, task: Task) -> WtgObservation:
    """Return the exact observation of a WTG group."""
    observed: WtgObservation = bounded(observe_wtg(state, output, group, turbine, task))
    return observed


@system(ACTING, "shown_actions")
def show_actions(last_action_k: float, last_action_tau: float) -> Acted:
    """Return the last actions of a WTG group."""
    return Acted(last_action_k, last_action_tau)


@system(SENSED, "shown_duty")
def show_duty(mean_duty: float) -> float:
    """Return the duty error that is charged."""
    return clip(mean_duty, -OBSERVATION_BOUND, OBSERVATION_BOUND)


@system(WATCHED, "machine_observed", when="privileged")
def observe_each_machine(
    state: MachineState, output: MachineOutput, machine: Machine, task: Task
) -> MachineObservation:
    """Return the observation of a synchronous machine."""
    observed: MachineObservation = bounded(observe_machine(state, output, machine, task))
    return observed


@system(TASK, "total_torque")
def begin_torque() -> float:
    """Begin to add the torques of all machines."""
    return 0.0


@system(WATCHED, "total_torque")
def add_torque(total_torque: float, torque: float) -> float:
    """Add the torque of a machine."""
    return total_torque + torque


@system(TASK, "grid_observed", when="privileged")
def observe_whole_grid(coi: float, rocof: float, total_torque: float, task: Task) -> GridObservation:
    """Return the observation of the grid."""
    observed: GridObservation = bounded(observe_grid(coi, rocof, total_torque, task))
    return observed


@system(TASK, "info")
def inform(
    step: float, coi: float, rocof: float, constraint: float, terms: CostTerms, task: Task, simulation_dt: float
) -> Info:
    """Return the numbers of `info`."""
    return Info(
        time_s=step * simulation_dt,
        frequency_hz=task.nominal_hz * coi,
        rocof_hz_s=rocof,
        cost=constraint,
        cost_frequency=terms.frequency,
        cost_rocof=terms.rocof,
        cost_duty=terms.duty,
        cost_rotor=terms.rotor,
        cost_overload=terms.overload,
        cost_effort=terms.effort,
        cost_failure=terms.failure,
    )


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
    observe_each_machine,
    begin_torque,
    add_torque,
    observe_whole_grid,
    Here("observe"),
    inform,
    inform_of_places,
)
