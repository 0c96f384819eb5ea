"""Groups of turbines in the place of synchronous machines, and machines for cases that have none."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from wtg_gym.physics.grid import Grid
from wtg_gym.physics.machine_parameters import ExciterParameters, GovernorParameters, SynchronousMachineParameters
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup

#: Share of the power that groups take over where nobody says which machines they replace.
SHARE = 0.6


def with_wind(grid: Grid, buses: Sequence[int] = (), rating: float = 1.25) -> Grid:
    """Return a grid with a WTG group in the place of the machines at each of some buses.

    Args:
        grid: without groups.
        buses: where; none: the machines that give most, until they give :data:`SHARE` of the power.
        rating: of all turbines together, over the load [-]; each group's is in proportion to what its machines gave.

    Raises:
        ValueError: a bus has no machine that gives power, or no machine with a governor is left.
    """
    case, given = grid.case, dict[int, float]()
    for machine in case.machines:
        given[machine.bus] = given.get(machine.bus, 0.0) + max(machine.dispatch_mw, 0.0)
    if not buses:
        total, taken = sum(given.values()), 0.0
        chosen = list[int]()
        for bus in sorted(given, key=given.__getitem__, reverse=True):
            if bus != case.slack_bus and taken + given[bus] <= SHARE * total:
                chosen.append(bus)
                taken += given[bus]
        buses = chosen
    if wrong := [bus for bus in buses if given.get(bus, 0.0) <= 0.0]:
        able = sorted(bus for bus, mw in given.items() if mw > 0.0)
        raise ValueError(f"no machine gives power at bus {wrong[0]}; those that do are at {able}")
    left = [machine for machine in case.machines if machine.bus not in buses and machine.governor is not None]
    if not left or not any(machine.bus == case.slack_bus for machine in case.machines if machine.bus not in buses):
        raise ValueError("a machine with a governor has to stay, and one at the slack bus")
    total, turbine_mw = sum(given[bus] for bus in buses), TurbineParameters().rated_power_mw
    groups = tuple(
        WtgGroup(bus=bus, n_turbines=max(1.0, round(rating * case.load_mw * given[bus] / total / turbine_mw)))
        for bus in buses
    )
    return dataclasses.replace(grid, groups=groups, replaced=tuple(buses))


def typical_machine(bus: int, power_mw: float, reactive_mvar: float, slack: bool) -> SynchronousMachineParameters:
    """Return a machine for a case that says what it gives alone; one that gives no power is a condenser.

    Its values are those of a large round-rotor machine; source: P. Kundur: Power System Stability and Control, table
    4.2.
    """
    rating = max(1.25 * abs(power_mw), 1.5 * abs(reactive_mvar), 20.0)
    governed = power_mw > 0.0 or slack
    return SynchronousMachineParameters(
        bus=bus, rating_mva=rating, two_h_s=8.0 if governed else 3.0, dispatch_mw=power_mw, damping_pu=0.0,
        x_d=1.8, x_q=1.7, x_d_transient=0.3, x_q_transient=0.55, x_subtransient=0.25, x_leakage=0.15,
        t_d0_transient_s=8.0, t_q0_transient_s=0.4, t_d0_subtransient_s=0.03, t_q0_subtransient_s=0.05,
        exciter=ExciterParameters(), governor=GovernorParameters(droop_pu=0.05) if governed else None,
    )  # fmt: skip
