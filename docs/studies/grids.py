"""For docs/grids.md: what is in each grid and its suite, and scores of laws and policies of one group on all grids.

The policies were trained on 14 buses. It takes five minutes on two processors.
"""

from matrix import marks_lost, table
from output import DOCS

from wtg_gym.evaluation import Results, evaluate, load_entries
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.grids.describe import describe_equilibrium, describe_grid, grid_of
from wtg_gym.physics.grid import known_grids
from wtg_gym.progress import Progress
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite, suite_of_grid
from wtg_gym.scenarios.draws import LoadEvents, Wind
from wtg_gym.tasks import V1

SUITES = tuple(suite_of_grid(name) for name in known_grids())
N_SCENARIOS = 120


def grids() -> str:
    """Return a column per grid: what `wtg-gym grid check` says, and what its suite draws from."""
    columns = []
    for name, suite in zip(known_grids(), map(get_suite, SUITES), strict=True):
        grid, _ = grid_of(name)
        lines = dict([*describe_grid(grid), *describe_equilibrium(grid)])
        events = {draw.name.rpartition("/")[2]: draw for draws in suite.drawn_from.values() for draw in draws}
        large = events["large-loads"]
        lines["wind's share"] = "{:.0%} … {:.0%}".format(*large.find(Wind).penetration)
        lines["large load events"] = "{:.0f} … {:.0f} MW".format(*large.find(LoadEvents).size_mw)
        columns.append(lines)
    same = ("step", "state below", "stable")  # the page says it once
    assert all(len({lines[key] for lines in columns if key in lines}) == 1 for key in same)
    left_out = ("name", "source", "repaired", "assumed", "voltages", "mode", "equilibrium", "cost of a run", *same)
    rows = [key for key in columns[0] if key not in left_out]
    cells = [[row, *(lines.get(row, "–") for lines in columns)] for row in rows]
    return markdown_table(("", *(f"`{name}`" for name in known_grids())), cells)


def played(suite: str) -> Results:
    """Return the results of laws and policies of one group on a suite's first test scenarios."""
    entries = [entry for entry in load_entries("baselines", V1) if entry.policy is None]
    entries += [entry for entry in load_entries("policies", V1) if entry.per_group]
    with Progress("episodes") as progress:
        seeds = get_suite(suite).test[:N_SCENARIOS]
        return evaluate(entries, suite, "test", seeds=seeds, on_progress=progress.update, keep_going=True)


if __name__ == "__main__":
    update_between_markers(DOCS / "grids.md", grids(), "grids")
    columns = {suite: played(suite) for suite in SUITES}
    first = columns[DEFAULT_SUITE]
    update_between_markers(DOCS / "grids.md", f"{table(columns, first)}\n\n{marks_lost(columns, first)}", "transfer")
