"""The grids that come with the package, and policies of one group on grids that they were not trained on.

    python docs/studies/grids.py [--output DOCS]

puts into DOCS/grids.md what is in each grid and its suite, and scores: laws, and the shipped policies with per_group =
true, which were trained on 14 buses; and draws DOCS/images/all-wind.svg, IEEE 39 with turbines alone. It takes five
minutes on two processors.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from output import folder as output_folder

from wtg_gym.evaluation import Results, evaluate, load_entries
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.grids.describe import describe_equilibrium, describe_grid
from wtg_gym.physics.grid import DEFAULT_GRID, get_grid, known_grids
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.trajectory import simulate
from wtg_gym.plotting import save_figure, style
from wtg_gym.progress import Progress
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite, suite_of_grid
from wtg_gym.scenarios.draws import LineTrips, LoadEvents, Wind
from wtg_gym.tasks import V1

#: Of the grid without machines: rating of all turbines over that of the machines that they replace, and their wind.
RATING, WIND_M_S = 1.8, 8.0
#: Its event, and the laws drawn.
STEP, LAWS = LoadStep(time_s=5.0, bus=8, power_mw=300.0), ("coordinated-tuned", "coordinated-piecewise", "mppt")
SUITES = tuple(suite_of_grid(name) for name in known_grids())
N_SCENARIOS = 300


def grids() -> str:
    """Return a column per grid: what `wtg-gym grid check` says, and what its suite draws from."""
    columns = []
    for name, suite in zip(known_grids(), map(get_suite, SUITES), strict=True):
        grid = get_grid(name)
        lines = dict([*describe_grid(grid), *(() if name == DEFAULT_GRID else describe_equilibrium(grid))])
        kinds = {kind.name.rpartition("/")[2]: kind for kinds in suite.drawn_from.values() for kind in kinds}
        large = kinds["large-loads"]
        lines["wind's share"] = "{:.0%} … {:.0%}".format(*large.find(Wind).penetration)
        lines["large load events"] = "{:.0f} … {:.0f} MW".format(*large.find(LoadEvents).size_mw)
        lines["lines that trip"] = str(len(large.find(LineTrips).lines))
        lines["kinds of event"] = ", ".join(kinds)
        columns.append(lines)
    same = ("step", "state below", "stable")  # the page says it once
    assert all(len({lines[key] for lines in columns if key in lines}) == 1 for key in same)
    rows = [key for key in columns[-1] if key not in ("repaired", "replaced", "mode", "equilibrium", *same)]
    cells = [[row, *(lines.get(row, "–") for lines in columns)] for row in rows]
    return markdown_table(("", *(f"`{name}`" for name in known_grids())), cells)


def played(suite: str) -> Results:
    """Return the results of laws and policies of one group on a suite's first test scenarios."""
    entries = [entry for entry in load_entries("baselines", V1) if entry.policy is None]
    entries += [entry for entry in load_entries("policies", V1) if entry.per_group]
    with Progress("episodes") as progress:
        seeds = get_suite(suite).test[:N_SCENARIOS]
        return evaluate(entries, suite, "test", seeds=seeds, on_progress=progress.update, keep_going=True)


def transfer(columns: dict[str, Results]) -> str:
    """Return score, mark and share of bad runs of every entry, a column per suite."""
    rows = {suite: {row.name: row for row in results.ranking} for suite, results in columns.items()}

    def cell(suite: str, name: str) -> str:
        row = rows[suite].get(name)
        if row is None or row.score is None:
            return "–"
        return f"{row.score.value:.1f}{' ✓' if row.marked else ''}; {row.lost_or_beyond_percent:.1f} %"

    cells = [[name, *(cell(suite, name) for suite in columns)] for name in rows[DEFAULT_SUITE]]
    return markdown_table(("entry", *columns), cells, right=range(1, 1 + len(columns)))


@style.printed
def all_wind(duration_s: float = 60.0) -> Figure:
    """Draw a load step in IEEE 39 with turbines in the place of all machines: frequency, power and rotors over time."""
    case, turbine_mw = get_grid("ieee39").case, TurbineParameters().rated_power_mw
    groups = tuple(WtgGroup(bus=m.bus, n_turbines=round(RATING * m.rating_mva / turbine_mw)) for m in case.machines)
    plant = Plant().replaced(
        physics="extended", case=dataclasses.replace(case, machines=()), groups=groups, trips_groups=True
    )
    scenario = Scenario(
        name="ieee39/all-wind", wind_speed=np.full((len(groups), 1), WIND_M_S), duration_s=duration_s, events=(STEP,),
        load_noise_bus=STEP.bus,
    )  # fmt: skip
    rated_mw, looks = turbine_mw * np.array([group.n_turbines for group in groups]), style.strategy_looks(LAWS)
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 62.0)
    panels = figure.subplots(1, 3)
    labels = ("frequency of each group [Hz]", "power of all turbines [GW]", "slowest rotor [p.u.]")
    for axes, letter, label in zip(panels, "abc", labels, strict=True):
        style.letter_panel(axes, letter, label)
        axes.set(xlim=(0.0, duration_s), xlabel="time [s]")
    for law in LAWS:
        run, look = simulate(scenario, law, plant), looks[law]
        values = run.wtg_frequency_hz, run.power_pu @ rated_mw / 1000.0, run.rotor_speed_pu.min(axis=1)
        for axes, value in zip(panels, values, strict=True):
            axes.plot(run.time_s, value, color=look.colour, linestyle=look.dashes, linewidth=0.8)
    handles = [Line2D([], [], color=looks[law].colour, linestyle=looks[law].dashes, label=law) for law in LAWS]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(LAWS), handlelength=3.0)
    return figure


if __name__ == "__main__":
    docs = output_folder(__doc__)
    save_figure(all_wind(), docs / "images" / "all-wind", ["svg"])
    update_between_markers(docs / "grids.md", grids(), "grids")
    update_between_markers(docs / "grids.md", transfer({suite: played(suite) for suite in SUITES}), "transfer")
