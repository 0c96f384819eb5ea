"""Suites of version v1 for any grid: where events may happen follows from the network, or is read from a file."""

from __future__ import annotations

from pathlib import Path

from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.network import NetworkCase
from wtg_gym.scenarios.benchmark import SuitePlant
from wtg_gym.scenarios.strata import Places, suite_of_strata
from wtg_gym.scenarios.suite import Suite

#: Largest increase of a bus's load, as a share of its own and, for small ones, of the grid's.
_INCREASE, _LEAST_INCREASE = 1.0, 0.05
#: Largest decrease: less than the bus has at the least load level.
_DECREASE = 0.84
#: Loads that may be disconnected, as shares of the grid's.
_TRIPPED = 0.02, 0.1


def all_places(case: NetworkCase) -> Places:
    """Return every place where something may happen without taking the network apart."""
    loads = [bus for bus in case.buses if bus.load_mw > 0.005 * case.load_mw]
    meshed = [b for index, b in enumerate(case.branches) if index not in case.bridges]
    # A transformer has another voltage at its other end; one that opens is no event of every day.
    lines = [(b.from_bus, b.to_bus) for b in meshed if b.tap == 1.0 and b.charging > 0.0]
    governed = sorted((m for m in case.machines if m.governor is not None), key=lambda m: m.rating_mva)
    others = [m.bus for m in case.machines if m.governor is None]
    least = _LEAST_INCREASE * case.load_mw
    return Places(
        load_buses=tuple(
            (bus.number, round(max(_INCREASE * bus.load_mw, least), 2), round(_DECREASE * bus.load_mw, 2))
            for bus in loads
        ),
        load_trip_buses=tuple(bus.number for bus in loads if _TRIPPED[0] <= bus.load_mw / case.load_mw <= _TRIPPED[1]),
        load_noise_bus=max(loads, key=lambda bus: bus.load_mw).number,
        line_trips=tuple(dict.fromkeys(lines)),
        fault_lines=tuple(dict.fromkeys(end for a, b in lines for end in ((a, b), (b, a)))),
        machine_buses=tuple(others or [m.bus for m in governed[:-1]]),
        generator_buses=tuple(m.bus for m in governed),
        governor_buses=tuple(m.bus for m in governed),
    )


def grid_suite(grid: str) -> Suite:
    """Return version v1's suite on a grid, with every event that does not take the network apart.

    `wtg-gym grid suite` leaves out what no law survives.
    """
    found = get_grid(grid)
    if not found.groups:
        raise ValueError(f"grid {grid!r} has no WTG groups; a suite needs some")
    name = Path(grid).stem
    plant = SuitePlant(grid=grid, groups=found.groups, physics="extended", overload_from_pu=1.05, secondary_time_s=30.0)
    return suite_of_strata(name, f"{found.case.name}.", plant, all_places(found.with_groups))
