"""`wtg-gym simulate`: one scenario under one or several strategies."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Group, Parameter

from wtg_gym.cli.cases import play_cases
from wtg_gym.cli.key_figures import key_figures, print_key_figures, traces_csv
from wtg_gym.cli.options import CsvFile, FigureFile, Flag, Json, PlantOptions, SuiteName, Whole, Words
from wtg_gym.cli.output import print_json, require_extra, say, write_and_say
from wtg_gym.cli.scenario_text import describe_scenario, scenario_summary
from wtg_gym.files import read_json
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup, default_groups
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, STRATEGY_NAMES, TrackingLaw, get_law
from wtg_gym.physics.trajectory import simulate
from wtg_gym.policies.load import example_law as law_file
from wtg_gym.progress import Progress
from wtg_gym.scenarios import Suite, get_suite, read_wind_csv
from wtg_gym.scenarios.benchmark import V0


@Parameter(name="*", group=Group("Scenario", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class ScenarioOptions:
    """The scenario, and changes to it."""

    suite: SuiteName = "paper"
    """suite to draw from, one of those that `wtg-gym suites` lists; the grid is its own too"""
    seed: Whole | None = None
    """seed of the suite; default: its first test seed, of the suite paper the load increase"""
    scenario: Path | None = None
    """scenario file in JSON, as `wtg-gym suites NAME --seed N --json` prints, in the place of a seed"""
    duration: float | None = None
    """length of the run [s]; a drawn scenario is drawn anew for it"""
    wind: Annotated[tuple[float, ...] | None, Parameter(consume_multiple=1, negative="")] = None
    """constant wind, 3 … 25 m/s: one for all WTG groups or one each"""
    wind_csv: Path | None = None
    """wind series: time_s, then one column per WTG group [m/s], uniform steps"""

    def __post_init__(self) -> None:
        """Refuse options that exclude each other."""
        for first, second in (("scenario", "seed"), ("wind", "wind_csv")):
            if getattr(self, first) is not None and getattr(self, second) is not None:
                raise ValueError(f"--{first} and --{second.replace('_', '-')} exclude each other: give one of the two")


def simulate_scenario(
    *,
    given: ScenarioOptions = ScenarioOptions(),
    plant: PlantOptions = PlantOptions(),
    strategy: Words = (REFERENCE_STRATEGY,),
    case: Words = (),
    entry: Words = (),
    example_law: Flag = False,
    plot: FigureFile | None = None,
    csv: CsvFile | None = None,
    json: Json = False,
) -> int:
    """Simulate one scenario under each of the given strategies and print the key figures.

    These are the frequency's nadir and zenith, the largest rate of change of frequency over 500 ms, and where
    frequency, rotor speeds and powers end. The scenario is a seed of a suite or a file; its wind can be replaced. A run
    ends early at a frequency outside 47.5 … 51.5 Hz, lost synchronism or a voltage collapse, in version v0 at a stall,
    an over-speed or, in extended physics, an under-speed too. In the paper's grid, wind for another
    number of WTG groups than two puts as many at bus 2.

    With --case, laws and policies play tests that operators ask of grid-forming plants instead, each in its own grid;
    what is printed is passed or failed, with the figure. The exit code is 1 where one has failed.

    examples:
      wtg-gym simulate --case dip last-machine --entry coordinated-piecewise mppt
      wtg-gym simulate --strategy mppt deloaded-5 coordinated-piecewise --plot run.png
      wtg-gym simulate --suite standard-v1 --seed 10003 --strategy coordinated-piecewise coordinated-tuned
      wtg-gym simulate --suite paper --seed 1 --wind 9 7.5 --duration 60
      wtg-gym simulate --wind-csv measured.csv --strategy my_law.toml
      wtg-gym suites weak-grid --seed 20010 --json > mine.json     write a scenario, edit it, then
      wtg-gym simulate --scenario mine.json --json                 simulate it

    Args:
        strategy: strategies by name, 'all', or .toml files with a law; default: the paper's coordinated-piecewise
        case: tests by name, or 'all': last-machine, rocof-up, rocof-down, rocof-up-2, rocof-down-2, angle-step,
            angle-step-30, dip, ratio-steps, island-surplus, island-deficit, current-limit
        entry: what plays them, as for `wtg-gym evaluate`; default: coordinated-piecewise
        example_law: print a law file to start from, and do nothing else: --example-law > my_law.toml
        plot: write a figure of the runs: .png, .svg or .pdf
        csv: write every sample of every run, units in the header: .csv
    """
    if example_law:
        say(*law_file().splitlines())
        return 0
    if entry and not case:
        raise ValueError("--entry belongs to --case; a scenario is played by laws: --strategy")
    if case:
        if (given, plant, strategy, plot, csv) != (
            ScenarioOptions(),
            PlantOptions(),
            (REFERENCE_STRATEGY,),
            None,
            None,
        ):
            raise ValueError("a case has its own scenario and grid, and is played by --entry: only --json goes with it")
        return play_cases(case, entry or (REFERENCE_STRATEGY,), json=json)
    if plot is not None:
        require_extra("matplotlib", "--plot")
    suite = get_suite(given.suite)
    scenario = _scenario(given, suite)
    # Another number of groups stands at bus 2.
    groups = suite.plant.groups if scenario.n_wtg == len(suite.plant.groups) else default_groups(scenario.n_wtg)
    settings = suite.plant.settings(
        groups=groups,
        physics=plant.physics,
        classical=plant.machine_model == "classical",
        control_dt=plant.control_dt,
        simulation_dt=plant.simulation_dt,
        trips_groups=(plant.on_failure or suite.benchmark.on_failure) == "trip",
    )
    every = STRATEGIES if suite.benchmark is V0 else STRATEGY_NAMES
    laws = _laws(strategy, settings.turbine, every)
    with Progress("runs") as progress:
        runs = {}
        for done, (name, law) in enumerate(laws.items()):
            progress.update(name, done, len(laws))
            runs[name] = simulate(scenario, law, settings)
    if plot is not None:
        from wtg_gym.plotting import figure_bytes, plot_trajectories

        write_and_say(plot, figure_bytes(plot_trajectories(runs, scenario), plot.suffix))
    if csv is not None:
        write_and_say(csv, traces_csv(runs))
    figures = [key_figures(name, trajectory) for name, trajectory in runs.items()]
    if json:
        print_json(
            {"scenario": scenario_summary(scenario), "plant": _plant_summary(plant, suite, groups), "runs": figures}
        )
    else:
        say(*describe_scenario(scenario), "")
        print_key_figures(figures)
    return int(any(trajectory.status == Status.NUMERICAL_FAILURE for trajectory in runs.values()))


def _laws(names: Sequence[str], turbine: TurbineParameters, every: Iterable[str]) -> dict[str, TrackingLaw]:
    """Return laws by name, each once; `every` are those of "all"."""
    laws: dict[str, TrackingLaw] = {}
    expanded = [each for name in names for each in (every if name == "all" else (name,))]
    for name in dict.fromkeys(expanded):
        law = get_law(name, turbine)
        if law.name in laws:
            raise ValueError(f"two strategies are called {law.name!r}; give the law in {name} another name")
        laws[law.name] = law
    return laws


def _scenario(given: ScenarioOptions, suite: Suite) -> Scenario:
    """Return the scenario that was asked for, with its wind replaced."""
    if given.scenario is None:
        seed = suite.test[0] if given.seed is None else given.seed
        scenario = suite.scenario(seed, duration_s=given.duration)
    else:
        scenario = _read_scenario(given.scenario, suite)
        if given.duration is not None:
            scenario = dataclasses.replace(scenario, duration_s=given.duration)
    wind_dt_s = scenario.wind_dt_s
    if given.wind_csv is not None:
        wind, wind_dt_s = read_wind_csv(given.wind_csv, duration_s=scenario.duration_s)
    elif given.wind is None:
        wind = scenario.wind_speed
    else:
        n_groups = scenario.n_wtg if len(given.wind) == 1 else len(given.wind)
        wind = np.resize(np.array(given.wind), (n_groups, 1))
    if suite.benchmark is not V0 and len(wind) != len(suite.plant.groups):
        raise ValueError(f"there is wind for {len(wind)} WTG groups, {suite.name} has {len(suite.plant.groups)}")
    return dataclasses.replace(scenario, wind_speed=wind, wind_dt_s=wind_dt_s)


def _read_scenario(path: Path, suite: Suite) -> Scenario:
    data = read_json(path, "scenario file")
    try:
        scenario = Scenario.from_dict(data)
    except ValueError as error:
        raise ValueError(f"scenario file {path}: {error}") from error
    if scenario.sensors is not None and not suite.benchmark.sensed:
        raise ValueError(
            f"{path} has sensors, as scenarios of version v1: say with --suite whose grid it is, such as standard-v1"
        )
    return scenario


def _plant_summary(plant: PlantOptions, suite: Suite, groups: tuple[WtgGroup, ...]) -> dict[str, Any]:
    return {
        "groups": [dataclasses.asdict(group) for group in groups],
        "control_dt_s": plant.control_dt,
        "simulation_dt_s": plant.simulation_dt,
        "machine_model": plant.machine_model,
        "on_failure": plant.on_failure or suite.benchmark.on_failure,
        "physics": plant.physics or suite.plant.physics,
    }
