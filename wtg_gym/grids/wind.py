"""Groups of turbines in the place of synchronous machines."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from wtg_gym.physics.grid import Grid
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup

#: Share of the power that groups take over where nobody says which machines they replace.
SHARE = 0.6
#: Groups at most then.
MOST_GROUPS = 6
#: Rating of turbines over the power that they take over: 1.25 of the load for :data:`SHARE` of it.
OVER = 1.25 / SHARE


def with_wind(grid: Grid, buses: Sequence[int] = (), rating: float | None = None) -> Grid:
    """Return a grid with a WTG group in the place of the machines at each of some buses.

    Args:
        grid: without groups.
        buses: where; none: the machines that give most, until they give :data:`SHARE` of the power.
        rating: of all turbines together, over the load [-]; each group's is in proportion to what its machines gave.
            None: :data:`OVER` times that.

    Raises:
        ValueError: no bus is given or found, one has no machine that gives power, or no machine with a governor is
            left.
    """
    case, given = grid.case, dict[int, float]()
    for machine in case.machines:
        given[machine.bus] = given.get(machine.bus, 0.0) + max(machine.dispatch_mw, 0.0)
    able = sorted(bus for bus, mw in given.items() if mw > 0.0)
    if not buses:
        total, taken = sum(given.values()), 0.0
        chosen = list[int]()
        for bus in sorted(given, key=given.__getitem__, reverse=True):
            if bus != case.slack_bus and 0.0 < given[bus] <= SHARE * total - taken and len(chosen) < MOST_GROUPS:
                chosen.append(bus)
                taken += given[bus]
        if not chosen:
            raise ValueError(
                f"no bus but the slack bus has machines that give power, at most {100.0 * SHARE:g} % of it: name the "
                f"buses where turbines replace them; machines give power at {able}"
            )
        buses = chosen
    if wrong := [bus for bus in buses if bus not in able]:
        raise ValueError(f"no machine gives power at bus {wrong[0]}; those that do are at {able}")
    left = [machine for machine in case.machines if machine.bus not in buses and machine.governor is not None]
    if not left or not any(machine.bus == case.slack_bus for machine in case.machines if machine.bus not in buses):
        raise ValueError("a machine with a governor has to stay, and one at the slack bus")
    total, turbine_mw = sum(given[bus] for bus in buses), TurbineParameters().rated_power_mw
    over = OVER if rating is None else rating * case.load_mw / total
    groups = tuple(WtgGroup(bus=bus, n_turbines=max(1.0, round(over * given[bus] / turbine_mw))) for bus in buses)
    return dataclasses.replace(grid, groups=groups, replaced=tuple(buses))
