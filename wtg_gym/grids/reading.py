"""A file of another program, made into a grid, and groups of turbines in the place of its machines."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from wtg_gym.extras import install_advice
from wtg_gym.files import interpreting
from wtg_gym.grids import dyr, matpower, powsybl, solved_case
from wtg_gym.physics.grid import Grid
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup

#: Share of the power that groups take over by default.
SHARE = 0.6
#: Groups at most then.
MOST_GROUPS = 6
#: Power of the machines at a bus up to which they are replaced then [MW]; more than that is an equivalent of a grid.
MOST_MW = 20_000.0
#: Rating of turbines over the power that they take over: 1.25 of the load for :data:`SHARE` of it.
OVER = 1.25 / SHARE


def read_case(
    path: Path,
    dynamic: Path | None = None,
    *,
    frequency_hz: float | None = None,
    drop: Collection[str] = (),
    substitute: bool = False,
) -> Grid:
    """Return the grid of a case, without WTG groups; its wind parks are machines marked as replaced.

    The ending of `path` says which format it has; `dynamic` is a DYR file with the machines of a RAW file. The nominal
    frequency is that of the file, or a usual one, where none is given. Types of element in `drop` are left out. To
    `substitute` puts typical controls in the place of models that are not here, or leaves those out. A ValueError says
    where a file is missing or damaged, has what a grid has not, or the grid's power flow is not the library's.
    """
    for file in (path, dynamic):
        if file is not None and not file.is_file():
            raise ValueError(f"there is no file {file}")
    if path.suffix.lower() in (".m", ".mat"):
        read = matpower.read_matpower
    else:
        read = matpower.read_pandapower if matpower.is_network(path) else powsybl.read_powsybl
    with interpreting(path, "case"):
        try:
            case = read(path, frequency_hz, drop)
        except ImportError as error:
            raise ValueError(f"it needs {error.name}; {install_advice('grids')}") from error
        dynamics = None if dynamic is None else dyr.Dynamics(dynamic, case.notes, substitute=substitute)
        grid = solved_case.grid_of(case, dynamics, drop)
    return replace(grid, source=f"{path.name}, read by {case.library}")


def with_wind(grid: Grid, buses: Sequence[int] = ()) -> Grid:
    """Return a grid with a WTG group in the place of the machines at each of some buses.

    The buses that the grid calls replaced are wind parks, which get groups in any case. Without `buses` the machines
    that give most follow, until all give :data:`SHARE` of the power, or where that is none, the slack bus. There
    turbines stand beside the machines, and are rated for :data:`SHARE` of what those give. A ValueError says that a bus
    has no machine that gives power, or no machine with a governor is left.
    """
    case, dispatch_mw = grid.case, dict[int, float]()
    for machine in case.machines:
        dispatch_mw[machine.bus] = dispatch_mw.get(machine.bus, 0.0) + max(machine.dispatch_mw, 0.0)
    total_mw, slack = sum(dispatch_mw.values()), case.slack_bus
    able = sorted(bus for bus, mw in dispatch_mw.items() if mw > 0.0)
    if wrong := [bus for bus in buses if bus not in able]:
        raise ValueError(f"no machine gives power at bus {wrong[0]}; those that do are at {able}")
    chosen = list(dict.fromkeys((*grid.replaced, *buses)))
    if not buses:
        taken_mw = sum(dispatch_mw[bus] for bus in chosen)
        for bus in sorted(dispatch_mw, key=dispatch_mw.__getitem__, reverse=True):
            fits = 0.0 < dispatch_mw[bus] <= min(SHARE * total_mw - taken_mw, MOST_MW)
            if fits and bus not in (slack, *chosen) and len(chosen) < MOST_GROUPS:
                chosen.append(bus)
                taken_mw += dispatch_mw[bus]
        chosen = chosen or [slack]
    replaced = tuple(bus for bus in chosen if bus != slack)
    if not any(machine.governor is not None and machine.bus not in replaced for machine in case.machines):
        raise ValueError("a machine with a governor has to stay")
    dispatch_mw[slack] *= SHARE
    turbine_mw = TurbineParameters().rated_power_mw
    sizes = {bus: max(1.0, round(OVER * dispatch_mw[bus] / turbine_mw)) for bus in chosen}
    groups = [solved_case.made(f"turbines at bus {bus}", WtgGroup, bus=bus, n_turbines=n) for bus, n in sizes.items()]
    return replace(grid, groups=tuple(groups), replaced=replaced)
