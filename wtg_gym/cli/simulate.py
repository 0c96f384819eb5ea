"""`wtg-gym simulate`: one scenario under one or several strategies."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.cli.key_figures import key_figures, print_key_figures, traces_csv
from wtg_gym.cli.laws import add_law_option, chosen_laws
from wtg_gym.cli.output import PLOT_SUFFIXES, check_output_file, check_plot_file, print_json, say, write_and_say
from wtg_gym.cli.parser import Commands, add_command, add_plant_options
from wtg_gym.cli.suites_command import (
    case_seed,
    describe_scenario,
    read_scenario,
    scenario_summary,
    suite_name,
    suites_by_version,
)
from wtg_gym.physics.parameters import WtgGroup, default_groups
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import EVENT_KINDS, Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, STRATEGY_NAMES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.progress import Progress
from wtg_gym.scenarios import SUITES, Suite, get_suite, read_wind_csv
from wtg_gym.scenarios.benchmark import V0

_DESCRIPTION = f"""\
Simulates one scenario under each of the given strategies and prints the key figures: frequency nadir and zenith, the
largest rate of change of frequency over 500 ms, and where frequency, rotor speeds and powers end. The scenario is one
of the paper's cases, a seed of a suite, or a file; its wind can be replaced. A run ends early at a stall, an over-
speed, an under-speed (extended physics), a frequency outside 47.5 … 51.5 Hz (in suites of version v1: 48.5 … 51.5),
lost synchronism or a voltage collapse. A suite's scenarios run in its own grid, all others in the paper's; a scenario
file from a suite of version v1 needs --suite too, which says whose grid it is.

strategies: {", ".join(STRATEGY_NAMES)}
kinds of event in a file: {", ".join(EVENT_KINDS)}"""

_EXAMPLES = """\
  wtg-gym simulate --case load-increase --strategy mppt deloaded-5 coordinated-piecewise --plot run.png
  wtg-gym simulate --suite standard --seed 20003 --strategy all --csv traces.csv
  wtg-gym simulate --suite standard-v1 --seed 10003 --strategy coordinated-piecewise coordinated-tuned
  wtg-gym simulate --case load-decrease --wind 9 7.5 --duration 60
  wtg-gym simulate --wind-csv measured.csv --strategy my_law.toml
  wtg-gym suites weak-grid --seed 20010 --json > mine.json     write a scenario, edit it, then
  wtg-gym simulate --scenario mine.json --json                 simulate it"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym simulate`."""
    parser = add_command(commands, "simulate", run, description=_DESCRIPTION, examples=_EXAMPLES)
    cases = ", ".join(case.name for case in get_suite("paper").cases)
    group = parser.add_argument_group("scenario")
    what = group.add_mutually_exclusive_group()
    what.add_argument("--case", metavar="NAME", help=f"case of the paper: {cases} (default: load-increase)")
    what.add_argument("--suite", type=suite_name, metavar="NAME", help=f"suite to draw from, of {suites_by_version()}")
    group.add_argument(
        "--scenario", metavar="FILE", help="scenario file in JSON, as `wtg-gym suites NAME --seed N --json` prints"
    )
    change = parser.add_argument_group("changes to it")
    change.add_argument("--seed", type=int, metavar="N", help="seed of the suite (default: its first test seed)")
    change.add_argument(
        "--duration", type=float, metavar="S", help="length of the run [s], a drawn scenario is drawn anew for it"
    )
    wind = change.add_mutually_exclusive_group()
    wind.add_argument(
        "--wind",
        type=float,
        nargs="+",
        metavar="V",
        help="constant wind, 3 … 25 m/s: one for all WTG groups or one each",
    )
    wind.add_argument(
        "--wind-csv", metavar="FILE", help="wind series: time_s, then one column per WTG group [m/s], uniform steps"
    )
    add_plant_options(parser, default_groups="the suite's, or one per given wind")
    add_law_option(parser, REFERENCE_STRATEGY)
    out = parser.add_argument_group("output")
    out.add_argument(
        "--plot",
        metavar="FILE",
        help=f"write a figure of the runs: {', '.join(PLOT_SUFFIXES)}",
    )
    out.add_argument("--csv", metavar="FILE", help="write every sample of every run, units in the header: .csv")
    out.add_argument("--json", action="store_true", help="print the key figures as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym simulate`; return 1 if a run failed numerically."""
    plot = check_plot_file(arguments.plot, PLOT_SUFFIXES)
    table = None if arguments.csv is None else check_output_file("--csv", arguments.csv, (".csv",))
    suite = get_suite(arguments.suite or "paper")
    scenario, groups = _scenario_and_groups(arguments, suite)
    settings = suite.plant.settings(
        groups=groups,
        physics=arguments.physics,
        classical=arguments.machine_model == "classical",
        control_dt=arguments.control_dt,
        simulation_dt=arguments.simulation_dt,
        trips_groups=arguments.on_failure == "trip",
    )
    every = STRATEGIES if suite.benchmark is V0 else STRATEGY_NAMES
    laws = {law.name: law for law in chosen_laws(arguments, settings.turbine, every)}
    with Progress("runs") as progress:
        runs = {}
        for done, (name, law) in enumerate(laws.items()):
            runs[name] = simulate(
                scenario, law, settings, on_progress=partial(progress.update_part, name, done, len(laws))
            )
    if plot is not None:
        _write_plot(plot, runs, scenario, settings)
    if table is not None:
        write_and_say(table, traces_csv(runs))
    figures = [key_figures(name, trajectory) for name, trajectory in runs.items()]
    if arguments.json:
        print_json(
            {"scenario": scenario_summary(scenario), "plant": _plant_summary(arguments, suite, groups), "runs": figures}
        )
    else:
        say(*describe_scenario(scenario), "")
        print_key_figures(figures)
    return int(any(trajectory.status == Status.NUMERICAL_FAILURE for trajectory in runs.values()))


def _scenario_and_groups(arguments: argparse.Namespace, suite: Suite) -> tuple[Scenario, tuple[WtgGroup, ...]]:
    """The scenario that was asked for, with its wind replaced, and as many WTG groups as it has wind for."""
    if arguments.seed is not None and arguments.suite is None:
        raise ValueError(f"--seed {arguments.seed} needs a suite: --suite {' | '.join(SUITES)}")
    for option in ("case", "seed"):
        if arguments.scenario is not None and getattr(arguments, option) is not None:
            raise ValueError(f"--scenario {arguments.scenario} is the whole scenario: leave out --{option}")
    from_file = None if arguments.scenario is None else read_scenario(Path(arguments.scenario))
    if from_file is not None and from_file.sensors is not None and not suite.benchmark.sensed:
        raise ValueError(
            f"{arguments.scenario} has sensors, as scenarios of version v1: say with --suite whose grid it is, "
            "such as standard-v1"
        )
    if from_file is not None and arguments.duration is not None:
        from_file = dataclasses.replace(from_file, duration_s=arguments.duration)
    n_groups = _n_groups(arguments, from_file, suite)
    if suite.benchmark is not V0 and arguments.groups is None and n_groups != len(suite.plant.groups):
        # They would all stand at bus 2: another grid than the suite's.
        raise ValueError(
            f"there is wind for {n_groups} WTG groups, {suite.name} has {len(suite.plant.groups)}; "
            f"--groups {n_groups} puts as many at bus 2"
        )
    # Another number of groups stands at bus 2.
    groups = suite.plant.groups if n_groups == len(suite.plant.groups) else default_groups(n_groups)
    scenario = from_file if from_file is not None else _named_scenario(arguments, suite, groups)
    if arguments.wind is not None:
        wind = np.resize(np.array(arguments.wind), (n_groups, 1))
        scenario = dataclasses.replace(scenario, wind_speed=wind)
    elif arguments.wind_csv is not None:
        wind, wind_dt_s = read_wind_csv(arguments.wind_csv, duration_s=scenario.duration_s)
        scenario = dataclasses.replace(scenario, wind_speed=wind, wind_dt_s=wind_dt_s)
    if scenario.n_wtg != n_groups:
        raise ValueError(
            f"{arguments.scenario} has wind for {scenario.n_wtg} WTG groups, --groups asks for {n_groups}; "
            "give the wind too, with --wind or --wind-csv"
        )
    return scenario, groups


def _n_groups(arguments: argparse.Namespace, from_file: Scenario | None, suite: Suite) -> int:
    """Return how many WTG groups there are: those asked for, else those of wind, file or suite."""
    asked: int | None = arguments.groups
    if arguments.wind_csv is not None:
        n_given = int(read_wind_csv(arguments.wind_csv)[0].shape[0])
        if asked not in (None, n_given):
            raise ValueError(f"{arguments.wind_csv} has wind for {n_given} WTG groups, --groups asks for {asked}")
        return n_given
    n_given = 1 if arguments.wind is None else len(arguments.wind)
    if asked is not None:
        if n_given not in (1, asked):
            raise ValueError(f"--wind gives {n_given} values [m/s], --groups asks for {asked}: give one or {asked}")
        return asked
    if n_given > 1:
        return n_given
    return len(suite.plant.groups) if from_file is None else from_file.n_wtg


def _named_scenario(arguments: argparse.Namespace, suite: Suite, groups: tuple[WtgGroup, ...]) -> Scenario:
    if arguments.suite is not None:
        seed = suite.test[0] if arguments.seed is None else arguments.seed
    else:
        seed = case_seed(arguments.case)
    turbines = [group.n_turbines for group in groups]
    return suite.scenario(seed, n_wtg=len(groups), n_turbines=turbines, duration_s=arguments.duration)


def _plant_summary(arguments: argparse.Namespace, suite: Suite, groups: tuple[WtgGroup, ...]) -> dict[str, Any]:
    return {
        "groups": [dataclasses.asdict(group) for group in groups],
        "control_dt_s": arguments.control_dt,
        "simulation_dt_s": arguments.simulation_dt,
        "machine_model": arguments.machine_model,
        "on_failure": arguments.on_failure,
        "physics": arguments.physics or suite.plant.physics,
    }


def _write_plot(path: Path, runs: Mapping[str, Trajectory], scenario: Scenario, settings: PlantSettings) -> None:
    from wtg_gym.plotting import figure_bytes, plot_trajectories

    figure = plot_trajectories(runs, scenario, settings.control.overload_limit_pu)
    write_and_say(path, figure_bytes(figure, path.suffix))
