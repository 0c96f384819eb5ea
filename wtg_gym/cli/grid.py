"""`wtg-gym grid`: grids of one's own: bring one in and look at it."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from wtg_gym.cli.options import Flag, JsonFile, Words
from wtg_gym.cli.output import note, print_table, write_and_say

app = App(name="grid", help="grids of your own: bring one in, check it")


@app.command(name="import")
def import_grid(
    case: Path,
    /,
    *,
    output: JsonFile,
    dynamic: Path | None = None,
    wind: Annotated[tuple[int, ...], Parameter(consume_multiple=1, negative="", show_default=False)] = (),
    frequency: float | None = None,
    drop: Words = (),
    substitute: Flag = False,
) -> int:
    """Turn a case of another program into a grid's file.

    RAW and RAWX of PSS/E (with DYR), CGMES, UCTE, IEEE-CDF, PowerFactory and XIIDM are read by pypowsybl, MATPOWER's .m
    and .mat by PYPOWER, and networks that pandapower's `to_json` wrote by pandapower: extra `grids`. Without
    DYR every machine is a typical one. The grid's power flow must equal the library's. Elements that a grid cannot have
    are refused, or left out with --drop. Assumptions are printed and kept in the file.

    examples:
      wtg-gym grid import ieee39.raw --dynamic ieee39.dyr --output ieee39.json
      wtg-gym grid import case118.m --output ieee118.json --wind 10 26 65
      wtg-gym grid import network.json --output my_grid.json
      wtg-gym evaluate --suite ieee39.json                      score the laws on it

    Args:
        case: the other program's file
        dynamic: DYR file with the machines of a RAW file
        wind: buses whose machines are replaced by turbines of 5 MW, rated for 2.1 times the power they give; wind
            parks of the case stay turbines; default: the largest, up to 60 % of the power (turbines of up to 1.25 times
            the load)
        frequency: nominal frequency [Hz]; default: the file's
        drop: types of element to leave out, as the refusal calls them
        substitute: put typical controls in the place of models that are not here, or leave those out
    """
    from wtg_gym.grids.describe import describe_equilibrium
    from wtg_gym.grids.reading import read_case, with_wind
    from wtg_gym.physics.grid import grid_text

    grid = read_case(case, dynamic, frequency_hz=frequency, drop=drop, substitute=substitute)
    for line in (*grid.repairs, *grid.substitutions):
        note(line)
    made = with_wind(grid, wind)
    for group in made.groups:
        mva = sum(machine.rating_mva for machine in made.case.machines if machine.bus == group.bus)
        what = "in place of" if group.bus in made.replaced else "beside"
        note(f"turbines at bus {group.bus}: {group.n_turbines:g} × 5 MW {what} {mva:.0f} MVA")
    write_and_say(output, grid_text(made))
    try:
        list(describe_equilibrium(made))
    except ValueError as error:
        note(f"as it is, it does not start: {error}; turbines at other buses (--wind) may help")
    return 0


@app.command
def check(grid: str, /) -> int:
    """Look at a grid: power flow, equilibrium, least damped modes, step, and whether its scenarios start.

    A suite of v1 is checked with its own plant; ieee14 is that of standard-v1.

    examples:
      wtg-gym grid check ieee39
      wtg-gym grid check weak-grid-v1
      wtg-gym grid check my_grid.json

    Args:
        grid: a grid or suite of the package by its name, or a .json file
    """
    from wtg_gym.grids.describe import describe_equilibrium, describe_grid, describe_starts, grid_of

    network, suite = grid_of(grid)
    rows = [*describe_grid(network), *describe_equilibrium(network)]
    print_table(("", ""), rows, left=(0, 1))
    if network.groups:
        print_table(("", ""), describe_starts(suite), left=(0, 1))
    return 0
