"""Observations: records with names and units, and their equations."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple, get_type_hints

from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.envs.task_records import GroupRows, MeasuredObservation, Task
from wtg_gym.physics.machine import Machine, MachineOutput, MachineState
from wtg_gym.physics.sensors import Measurement
from wtg_gym.physics.wind_turbine import Rotor, Turbine, WtgOutput, WtgState, frequency_of, tip_speed_ratio
from wtg_gym.systems.elementary import clip
from wtg_gym.systems.records import each, size

#: Every entry of the observation is clipped to ± this.
OBSERVATION_BOUND = 5.0
#: Unit of frequency deviations [Hz].
FREQUENCY_UNIT_HZ = 0.5


class WtgObservation(NamedTuple):
    """Local measurements of a WTG group, each with its unit and meaning."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the converter minus the nominal one"]
    rocof: Annotated[float, "Hz/s", "rate of change of that frequency over the last control interval"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr", "speed of the blade tips over wind speed"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u.", "rotor speed; the nominal one is 1 p.u."]
    power: Annotated[float, "p.u.", "power into the grid, of the group's rating"]
    wind: Annotated[float, "5 m/s from 10 m/s", "wind, averaged over the rotor"]
    coefficient: Annotated[float, "0 at K_pr, 1 at K_opt", "k in use"]
    filter_state: Annotated[float, "0.5 Hz", "state of the damping filter"]


class MachineObservation(NamedTuple):
    """A synchronous machine, in the privileged observation."""

    speed: Annotated[float, "0.5 Hz", "speed as a frequency, minus the nominal one"]
    power: Annotated[float, "rating", "power into the grid"]
    voltage: Annotated[float, "0.1 p.u. from 1 p.u.", "voltage at the terminal"]


class GridObservation(NamedTuple):
    """The grid, in the privileged observation."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the centre of inertia minus the nominal one"]
    rocof: Annotated[float, "Hz/s", "rate of change of the frequency of the centre of inertia over 0.5 s"]
    torque: Annotated[float, "100 MVA", "mechanical torque of all machines"]


N_LOCAL, N_MEASURED = size(WtgObservation), size(MeasuredObservation)


def bounded(observation: Any) -> Any:
    """Return an observation, each entry clipped."""
    return each(lambda value: clip(value, -OBSERVATION_BOUND, OBSERVATION_BOUND), observation)


def _scaled_ratio(rotor_speed: float, wind: float, c: Rotor) -> float:
    ratio = tip_speed_ratio(rotor_speed, wind, c)
    return (ratio - c.tip_speed_ratio_opt) / (c.tip_speed_ratio_limit - c.tip_speed_ratio_opt)


def _scaled_rotor_speed(rotor_speed: float) -> float:
    return (rotor_speed - 1.0) / 0.25


def _scaled_wind(wind: float) -> float:
    return (wind - 10.0) / 5.0


def observe_wtg(s: WtgState, output: WtgOutput, group: GroupRows, t: Turbine, task: Task) -> WtgObservation:
    """Return the measurements of a WTG group."""
    return WtgObservation(
        frequency_deviation=(frequency_of(s, output) - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
        rocof=group.rocof,
        tip_speed_ratio=_scaled_ratio(s.rotor_speed, output.wind, t.rotor),
        rotor_speed=_scaled_rotor_speed(s.rotor_speed),
        power=output.power,
        wind=_scaled_wind(output.wind),
        coefficient=(output.coefficient - task.k_low) / task.k_span,
        filter_state=s.converter.filter * task.nominal_hz / FREQUENCY_UNIT_HZ,
    )


def observe_measured(m: Measurement, wind_sensor: float, t: Turbine, task: Task) -> MeasuredObservation:
    """Return the observation of what a WTG group measures; without a wind sensor, wind and ratio are 0."""
    return MeasuredObservation(
        frequency_deviation=(m.frequency - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
        rocof=m.rocof,
        tip_speed_ratio=wind_sensor * _scaled_ratio(m.rotor_speed, m.wind, t.rotor),
        rotor_speed=_scaled_rotor_speed(m.rotor_speed),
        power=m.power,
        wind=wind_sensor * _scaled_wind(m.wind),
    )


def observe_machine(s: MachineState, output: MachineOutput, c: Machine, task: Task) -> MachineObservation:
    """Return the measurements at a synchronous machine."""
    return MachineObservation(
        speed=(s.speed - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ,
        power=output.power / c.rating,
        voltage=(output.voltage - 1.0) / 0.1,
    )


def observe_grid(coi: float, rocof: float, torque: float, task: Task) -> GridObservation:
    """Return the grid's measurements: frequency of the centre of inertia [p.u.], RoCoF [Hz/s], torque [p.u.]."""
    return GridObservation((coi - 1.0) * task.nominal_hz / FREQUENCY_UNIT_HZ, rocof, torque)


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
