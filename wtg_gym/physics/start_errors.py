"""Why a run cannot start, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wtg_gym.physics.governor import gate_limits
from wtg_gym.physics.layout import Floats, Layout
from wtg_gym.physics.machine_models import controls_of
from wtg_gym.physics.machine_parameters import ExciterParameters
from wtg_gym.physics.parameters import ConverterLimitParameters, VoltageControlParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.units import StartFailure

#: Beginning of the names of scenarios that a simulator makes for itself.
NOMINAL = "the plant at "


class StartError(ValueError):
    """There is no equilibrium to start a scenario from."""


def scenario_name(scenario: Scenario) -> str:
    """Return what an error calls a scenario."""
    return scenario.name if scenario.name.startswith(NOMINAL) else f"scenario {scenario.name!r}"


def bus_of_unit(settings: Plant, unit: int) -> int:
    """Return the bus number of a unit: machines, groups, devices."""
    devices = [bus for own in settings.all_devices for bus in own.buses]
    return [*(m.bus for m in settings.case.machines), *(group.bus for group in settings.groups), *devices][unit]


def unit_name(settings: Plant, unit: int) -> str:
    """Return what an error calls a unit."""
    group = unit - len(settings.case.machines)
    kind = "the synchronous machine" if group < 0 else f"WTG group {group}"
    if group >= len(settings.groups):
        kind = [f"a unit of {own.kind.name}" for own in settings.all_devices for _ in own.buses][
            group - len(settings.groups)
        ]
    return f"{kind} at bus {bus_of_unit(settings, unit)}"


def check_internal_voltages(rows: Floats, scenarios: Sequence[Scenario], settings: Plant, layout: Layout) -> None:
    """Refuse a start that needs a larger voltage behind a reactance than anybody builds."""
    of_machines = np.hypot(rows[:, layout.machine("e_d")], rows[:, layout.machine("e_q")])
    voltages = np.concatenate([of_machines, rows[:, layout.wtg("emf")]], axis=1)
    limit = settings.protection.internal_voltage_max_pu
    if (voltages <= limit).all():
        return
    lane, unit = np.argwhere(~(voltages <= limit))[0]
    bus = settings.case.buses[settings.case.bus_index(bus_of_unit(settings, int(unit)))]
    task = "for its share of the power" if bus.voltage_pu is None else f"to hold {bus.voltage_pu:g} p.u. there"
    raise StartError(
        f"{scenario_name(scenarios[lane])} cannot start: {unit_name(settings, int(unit))} needs an internal voltage of "
        f"{voltages[lane, unit]:.3g} p.u. {task}; allowed: at most {limit:g} p.u. (a larger rating needs less)"
    )


def check_rotor_speeds(rows: Floats, scenarios: Sequence[Scenario], settings: Plant, layout: Layout) -> None:
    """Refuse a start with a rotor below the under-speed trip."""
    speeds, least = rows[:, layout.wtg("rotor_speed")], settings.protection.rotor_speed_min_pu
    for lane, group in np.argwhere(speeds < least):
        scenario = scenarios[lane]
        raise StartError(
            f"scenario {scenario.name!r} cannot start: the rotor of {unit_name(settings, layout.n_sync + group)} would "
            f"start at {speeds[lane, group]:.3g} p.u. in a wind of {scenario.wind_speed[group, 0]:.3g} m/s, below the "
            f"under-speed trip at {least:g} p.u."
        )


def start_failure(
    failure: StartFailure, unit: int, rows: Floats, scenario: Scenario, settings: Plant, layout: Layout
) -> str:
    """Say why a unit cannot start, with the numbers that its rows (n_rows,) hold."""
    if failure == StartFailure.POWER_FLOW_DIVERGED:
        return f"the power flow has no solution at a load level of {scenario.load_level:g} and this wind"
    if failure == StartFailure.WIND_SHORTAGE:
        return (
            f"in this wind the WTG groups alone cannot meet the load at a level of {scenario.load_level:g}; "
            "more wind or turbines, or less load, are needed"
        )
    name = unit_name(settings, unit)
    if unit < layout.n_sync:
        quantity, value, low, high = _limited(failure, unit, rows, settings, layout)
        what = quantity.replace("_", " ")
        return (
            f"{name} would start at {value:.4g} p.u. of {what}, beyond its {what} "
            f"limits {low:g} … {high:g} p.u.; change wind or load level"
        )
    j = unit - layout.n_sync
    if j >= layout.n_wtg:
        return f"{name} finds no equilibrium within its limits"
    if failure == StartFailure.NO_TURBINE_EQUILIBRIUM:
        k = rows[layout.wtg("k_nominal")[j]]
        return f"{name} has no equilibrium at a wind of {scenario.wind_speed[j, 0]:g} m/s with k = {k:g} p.u."
    if failure == StartFailure.CONVERTER_LIMIT:
        limits = settings.limits or ConverterLimitParameters()
        return (
            f"{name} would start with {rows[layout.wtg('power')[j]]:.4g} p.u. of power, beyond its converter's limits: "
            f"power {limits.power_min_pu:g} … {limits.power_max_pu:g} p.u., current at most "
            f"{limits.current_max_pu:g} p.u."
        )
    control, emf = settings.voltage_control or VoltageControlParameters(), rows[layout.wtg("internal_voltage")[j]]
    return (
        f"{name} would start with {emf:.4g} p.u. behind X_g, beyond the limits {control.internal_voltage_min_pu:g} … "
        f"{control.internal_voltage_max_pu:g} p.u. of its voltage control"
    )


def _limited(
    failure: StartFailure, unit: int, rows: Floats, settings: Plant, layout: Layout
) -> tuple[str, float, float, float]:
    """Return the quantity of a machine that starts beyond its limits, its value, and the limits [p.u.]."""
    machine = settings.case.machines[unit]
    for own, parameters in controls_of(machine):
        if own.limits is not None and own.failure == failure:
            place = np.flatnonzero(layout.seen(own.kind, "machine") == unit)[0]
            value = rows[layout.rows_of(own.kind, own.limited)[place]]
            return own.limited, float(value), *own.limits(parameters)
    if failure == StartFailure.GOVERNOR_LIMIT:
        return "gate", float(rows[layout.machine("gate")[unit]]), *gate_limits(machine.governor)
    exciter = machine.exciter
    assert isinstance(exciter, ExciterParameters)
    value = rows[layout.machine("field_voltage")[unit]]
    return "field_voltage", float(value), exciter.field_min_pu, exciter.field_max_pu
