"""A file of another program, made into a grid: which library reads it."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from wtg_gym.extras import install_advice
from wtg_gym.files import interpreting
from wtg_gym.grids import dyr, matpower, powsybl, solved_case
from wtg_gym.physics.grid import Grid


def read_case(
    path: Path,
    dynamic: Path | None = None,
    *,
    frequency_hz: float | None = None,
    drop: Collection[str] = (),
    substitute: bool = False,
) -> Grid:
    """Return the grid of a case, without WTG groups; what it calls replaced are its wind parks.

    A ValueError says where a file is missing or damaged, has what a grid has not, or the grid's power flow is not the
    library's.

    Args:
        path: of the case: its ending says which format it has.
        dynamic: a DYR file with the machines of a RAW file.
        frequency_hz: nominal frequency; None: the file's, or a usual one.
        drop: types of element that are left out.
        substitute: put typical controls in the place of models that are not here, or leave those out.
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
