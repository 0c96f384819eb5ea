"""Groups of turbines in the place of synchronous machines."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from wtg_gym.grids.solved_case import made
from wtg_gym.physics.grid import Grid
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup

#: Share of the power that groups take over where nobody says which machines they replace.
SHARE = 0.6
#: Groups at most then.
MOST_GROUPS = 6
#: Power of the machines at a bus up to which they are replaced then [MW]; more than that is an equivalent of a grid.
MOST_MW = 20_000.0
#: Rating of turbines over the power that they take over: 1.25 of the load for :data:`SHARE` of it.
OVER = 1.25 / SHARE


def with_wind(grid: Grid, buses: Sequence[int] = (), rating: float | None = None) -> Grid:
    """Return a grid with a WTG group in the place of the machines at each of some buses.

    At the slack bus turbines stand beside the machines, and are rated for :data:`SHARE` of what those give.

    Args:
        grid: without groups; the buses that it calls replaced are wind parks, which get groups in any case.
        buses: where else; none: the machines that give most, until all give :data:`SHARE` of the power, or where that
            is none, the slack bus.
        rating: of all turbines together, over the load [-]; each group's is in proportion to what its machines gave.
            None: :data:`OVER` times that.

    Raises:
        ValueError: a bus has no machine that gives power, or no machine with a governor is left.
    """
    case, given = grid.case, dict[int, float]()
    for machine in case.machines:
        given[machine.bus] = given.get(machine.bus, 0.0) + max(machine.dispatch_mw, 0.0)
    total, slack = sum(given.values()), case.slack_bus
    able = sorted(bus for bus, mw in given.items() if mw > 0.0)
    if wrong := [bus for bus in buses if bus not in able]:
        raise ValueError(f"no machine gives power at bus {wrong[0]}; those that do are at {able}")
    chosen = list(dict.fromkeys((*grid.replaced, *buses)))
    if not buses:
        taken = sum(given[bus] for bus in chosen)
        for bus in sorted(given, key=given.__getitem__, reverse=True):
            fits = bus not in (slack, *chosen) and 0.0 < given[bus] <= min(SHARE * total - taken, MOST_MW)
            if fits and len(chosen) < MOST_GROUPS:
                chosen.append(bus)
                taken += given[bus]
        chosen = chosen or [slack]
    replaced = tuple(bus for bus in chosen if bus != slack)
    left = [machine for machine in case.machines if machine.bus not in replaced and machine.governor is not None]
    if not left:
        raise ValueError("a machine with a governor has to stay")
    given[slack] *= SHARE
    turbine_mw = TurbineParameters().rated_power_mw
    over = OVER if rating is None else rating * case.load_mw / sum(given[bus] for bus in chosen)
    sizes = {bus: max(1.0, round(over * given[bus] / turbine_mw)) for bus in chosen}
    groups = tuple(made(f"turbines at bus {bus}", WtgGroup, bus=bus, n_turbines=size) for bus, size in sizes.items())
    return dataclasses.replace(grid, groups=groups, replaced=replaced)
