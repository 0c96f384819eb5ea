"""Suites of version v1 for any grid: where events may happen follows from the network, or is read from a file."""

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from wtg_gym.files import interpreting, parse_json, read_text
from wtg_gym.physics import machine_parameters, simulator
from wtg_gym.physics.grid import Grid, get_grid, record_of
from wtg_gym.physics.network import LEAST_IMPEDANCE
from wtg_gym.physics.plant import SIMULATION_DT_RANGE
from wtg_gym.ranges import Checked, describe, design, required
from wtg_gym.scenarios.draws import LOSSES, OperatingPoint, Span, Wind
from wtg_gym.scenarios.strata import COMMON, Places, constant_mw, governed_mva, suite_of_strata, wind_plant
from wtg_gym.scenarios.suite import Suite

#: Largest increase of a small load, as a share of the grid's; other loads at most double.
_LEAST_INCREASE = 0.05
#: Load of a bus that a decrease leaves at the least load level, as a share.
_LEFT = 0.01
#: Loads that change, the largest ones.
_N_LOADS = 20
#: Loads that may be disconnected, as shares of the grid's.
_TRIPPED = 0.02, 0.1
#: Loading of the machines at the least share of wind, and the least width of its range.
_LOADING, _WIDTH = 0.8, 0.13
_LOAD_LEVEL = 0.85, 1.1
#: Results are files of the suite's name.
_NAME = re.compile(r"[^\W_][\w .()+-]{0,80}")
#: Least and largest share of wind over the rated power of all turbines and the load.
_OF_RATED = 0.32, 0.72


def all_places(grid: Grid) -> Places:
    """Return every place of a network with its groups where something may happen without taking it apart.

    Branches with a tap or without charging count as transformers, which do not trip. Loads, machines and groups are not
    lost where that is more than the grid is planned for; a group counts as the machines that it replaces.
    """
    case, most_mw = grid.with_groups, grid.largest_loss_mw
    large = sorted(case.buses, key=lambda bus: -bus.load_mw)[:_N_LOADS]
    loads = [bus for bus in case.buses if bus in large and bus.load_mw > 0.0]
    meshed = [b for index, b in enumerate(case.branches) if index not in case.bridges]
    lines = [(b.from_bus, b.to_bus) for b in meshed if b.tap == 1.0 and b.charging > 0.0]
    governed = sorted((m for m in case.machines if m.governor is not None), key=lambda m: m.rating_mva)
    others = [m for m in case.machines if m.governor is None]
    small = [bus for bus, mw in grid.infeeds_mw.items() if mw <= most_mw]
    trips_mw = _TRIPPED[0] * case.load_mw, min(_TRIPPED[1] * case.load_mw, most_mw)
    least = _LEAST_INCREASE * case.load_mw
    return Places(
        load_buses=tuple(
            (bus.number, round(max(bus.load_mw, least), 2), round((_LOAD_LEVEL[0] - _LEFT) * bus.load_mw, 2))
            for bus in loads
        ),
        load_trip_buses=tuple(bus.number for bus in loads if trips_mw[0] <= bus.load_mw <= trips_mw[1]),
        load_noise_bus=large[0].number,
        line_trips=tuple(dict.fromkeys(lines)),
        fault_lines=tuple(dict.fromkeys(end for a, b in lines for end in ((a, b), (b, a)))),
        machine_buses=tuple(bus for bus in _buses(others or governed[:-1]) if bus in small),
        generator_buses=tuple(bus for bus in _buses(governed) if bus in small),
        governor_buses=_buses(governed),
        group_trips=all(bus in small for bus in grid.replaced),
    )


def _buses(machines: Sequence[machine_parameters.SynchronousMachineParameters]) -> tuple[int, ...]:
    return tuple(dict.fromkeys(machine.bus for machine in machines))


@dataclass(frozen=True, kw_only=True)
class GridSuite(Checked):
    """What the file of a suite says: a grid, where events may happen in it, and how large they are."""

    name: str = required("-", "design", "name of the suite, without its version")
    grid: str = required("-", "design", "name of the grid, or path of its file")
    places: Places = field(metadata=describe("-", "design", "where events may happen"))
    event_size: float = design(1.0, "-", "factor on the load events", 0.0, 10.0)
    wind_share: Span = design((0.4, 0.78), "-", "share of the load from wind", 0.0, 1.0)
    load_level: Span = design(_LOAD_LEVEL, "-", "factor on the loads of the case", 0.3, 1.5)
    simulation_dt: float = design(0.025, "s", "step of the integration", *SIMULATION_DT_RANGE)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"name must be letters, digits, blanks and . + - _ ( ), got {self.name!r:.80}")

    @property
    def suite(self) -> Suite:
        """The suite; a ValueError if the grid has none of its places."""
        grid = get_grid(self.grid)
        return suite_of_strata(
            self.name,
            f"{grid.case.name}.",
            self.plant,
            self.places,
            event_size=self.event_size,
            changes={Wind: {"penetration": self.wind_share}, OperatingPoint: {"load_level": self.load_level}},
            # With other machines left, the loss of one needs no more wind than other events.
            changes_in={"machine": {Wind: {"mean_m_s": COMMON[Wind]["mean_m_s"]}}},
        )

    @property
    def plant(self) -> dict[str, Any]:
        """Its grid and plant, see :func:`~wtg_gym.scenarios.strata.wind_plant`."""
        groups = get_grid(self.grid).groups
        if not groups:
            raise ValueError(f"grid {self.grid!r} has no WTG groups; a suite needs some")
        return wind_plant(self.grid, groups, simulation_dt=self.simulation_dt)


def suite_of_file(path: str) -> Suite:
    """Return the suite of a file, or the :func:`unscreened` one of a grid's file; a ValueError says what is wrong."""
    # `Path.resolve` raises another error for a link to itself.
    settings = read_suite(where := Path(os.path.realpath(path)))
    with interpreting(where, "suite"):
        return _suite_of(settings, get_grid(settings.grid))


# Kept by what is in the files of suite and grid, not by when they were written.
@lru_cache(maxsize=64)
def _suite_of(settings: GridSuite, _grid: Grid) -> Suite:
    return settings.suite


def read_suite(path: Path) -> GridSuite:
    """Return what the file of a suite says, where the path of a grid counts from the file's folder, or of a grid."""
    # Of the two kinds of file, a grid may be larger.
    return _read(path, read_text(path, "grid"))


@lru_cache(maxsize=64)
def _read(path: Path, text: str) -> GridSuite:
    data = parse_json(text, f"the suite or grid {path}")
    if isinstance(data, dict) and "branches" in data:
        with interpreting(path, "grid"):
            return unscreened(str(path))
    with interpreting(path, "suite"):
        settings: GridSuite = record_of(GridSuite, data)
        is_file = settings.grid.endswith(".json")
        return replace(settings, grid=os.path.realpath(path.parent / settings.grid)) if is_file else settings


def unscreened(grid: str) -> GridSuite:
    """Return a suite of a grid, a name or a file, with every event that does not take its network apart."""
    data = get_grid(grid)
    if data.case.load_mw <= 0.0:
        raise ValueError(f"the loads of grid {grid!r} take {data.case.load_mw:.6g} MW together; a suite needs some")
    for branch in data.case.branches:
        ends = f"branch {branch.from_bus}-{branch.to_bus}"
        if math.hypot(branch.resistance, branch.reactance) < LEAST_IMPEDANCE:
            raise ValueError(f"{ends} has an impedance below {LEAST_IMPEDANCE:g} p.u., too little for the power flow")
    settings = GridSuite(name=Path(grid).stem, grid=grid, places=all_places(data))
    plant = settings.plant["plant"]
    settings = replace(settings, simulation_dt=simulator.longest_step(plant))
    if (constant := constant_mw(plant)) < 0.0:
        raise ValueError(f"the machines without governor of grid {grid!r} take {-constant:.6g} MW; they must give some")
    # The machines supply the load that the wind leaves, and the losses.
    load_mw = settings.load_level[1] * data.case.load_mw
    machines = (governed_mva(plant) + constant) / load_mw
    # Turbines give a part of their rating.
    sizes = zip(data.groups, plant.turbines, strict=True)
    rated_mw = sum(group.n_turbines * turbine.rated_power_mw for group, turbine in sizes)
    low, high = map(min, settings.wind_share, (round(part * rated_mw / data.case.load_mw, 2) for part in _OF_RATED))
    low = max(low, round(1.0 + LOSSES - _LOADING * machines, 2))
    if low + _WIDTH > 1.0:
        raise ValueError(
            f"the machines of grid {grid!r} give {100.0 * _LOADING * machines:.0f} % of its load of {load_mw:.0f} MW; "
            f"{100.0 * (LOSSES + _WIDTH):.0f} % or more are needed beside the wind"
        )
    return replace(settings, wind_share=(low, max(high, round(low + _WIDTH, 2))))
