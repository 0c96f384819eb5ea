"""Observations: records with names and units, and their equations."""

from __future__ import annotations

from typing import Annotated, NamedTuple, get_type_hints

from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.envs.task_records import GroupRows, Task
from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.elementary import clip
from wtg_gym.physics.machine import Machine, MachineOutput, MachineState
from wtg_gym.physics.records import elementwise, size, storer
from wtg_gym.physics.wind_turbine import Turbine, WtgOutput, WtgState

#: Every entry of the observation is clipped to ± this.
OBSERVATION_BOUND = 5.0
#: What frequency deviations are counted in [Hz].
FREQUENCY_UNIT_HZ = 0.5


class WtgObservation(NamedTuple):
    """Local measurements of a WTG group."""

    frequency_deviation: Annotated[float, "0.5 Hz"]
    rocof: Annotated[float, "Hz/s"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u."]
    power: Annotated[float, "p.u."]
    wind: Annotated[float, "5 m/s from 10 m/s"]
    coefficient: Annotated[float, "0 at K_pr, 1 at K_opt"]
    filter_state: Annotated[float, "0.5 Hz"]


class MachineObservation(NamedTuple):
    """A synchronous machine, in the privileged observation."""

    speed: Annotated[float, "0.5 Hz"]
    power: Annotated[float, "rating"]
    voltage: Annotated[float, "0.1 p.u. from 1 p.u."]


class GridObservation(NamedTuple):
    """The grid, in the privileged observation."""

    frequency_deviation: Annotated[float, "0.5 Hz"]
    rocof: Annotated[float, "Hz/s"]
    torque: Annotated[float, "100 MVA"]


N_LOCAL, N_MACHINE = size(WtgObservation), size(MachineObservation)

store_wtg_observation, store_machine_observation = storer(WtgObservation), storer(MachineObservation)
store_grid_observation = storer(GridObservation)


@inlined
def _bounded(value: float, bound: float) -> float:
    return clip(value, -bound, bound)


bounded_wtg = elementwise(WtgObservation, _bounded, "bounded", "observation", "bound")
bounded_machine = elementwise(MachineObservation, _bounded, "bounded", "observation", "bound")
bounded_grid = elementwise(GridObservation, _bounded, "bounded", "observation", "bound")


@inlined
def observe_wtg(s: WtgState, output: WtgOutput, group: GroupRows, t: Turbine, task: Task) -> WtgObservation:
    """Return the measurements of a WTG group."""
    best, limit = t.rotor.tip_speed_ratio_opt, t.rotor.tip_speed_ratio_limit
    ratio = t.rotor.tip_speed * s.rotor_speed / output.wind
    return WtgObservation(
        frequency_deviation=(s.converter.speed - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
        rocof=group.rocof,
        tip_speed_ratio=(ratio - best) / (limit - best),
        rotor_speed=(s.rotor_speed - 1.0) / 0.25,
        power=output.power,
        wind=(output.wind - 10.0) / 5.0,
        coefficient=(output.coefficient - task.k_low) / task.k_span,
        filter_state=s.converter.filter * task.nominal_hz / FREQUENCY_UNIT_HZ,
    )


@inlined
def observe_machine(s: MachineState, output: MachineOutput, c: Machine, task: Task) -> MachineObservation:
    """Return the measurements at a synchronous machine."""
    return MachineObservation(
        speed=(s.speed - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
        power=output.power / c.rating,
        voltage=(output.voltage - 1.0) / 0.1,
    )


@inlined
def observe_grid(coi: float, rocof: float, torque: float, task: Task) -> GridObservation:
    """Return the grid's measurements: frequency of the centre of inertia [p.u.], RoCoF [Hz/s], torque [p.u.]."""
    return GridObservation((coi - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ, rocof, torque)


def observation_names(n_wtg: int, n_sync: int, action_mode: str, *, privileged: bool) -> list[str]:
    """Return the names of the observation's entries, with the unit each is counted in.

    `wtg0` is group 1 of commands and pictures.
    """
    actions = [
        f"last_action_{name}" for name, used in zip(("k", "tau"), ACTION_MODES[action_mode], strict=True) if used
    ]
    names = []
    for j in range(n_wtg):
        names += [*_names(f"wtg{j}", WtgObservation), *(f"wtg{j}.{action}" for action in actions)]
    if privileged:
        for i in range(n_sync):
            names += _names(f"sync{i}", MachineObservation)
        names += _names("grid", GridObservation)
    return names


def _names(owner: str, record: type) -> list[str]:
    hints = get_type_hints(record, include_extras=True)
    return [f"{owner}.{name} [{hint.__metadata__[0]}]" for name, hint in hints.items()]
