"""What `wtg-gym simulate` runs: a scenario that was asked for, under laws."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.cli.key_figures import key_figures, print_key_figures, traces_csv
from wtg_gym.cli.options import PlantOptions
from wtg_gym.cli.output import print_json, require_extra, say, write_and_say
from wtg_gym.cli.scenario_text import describe_scenario, scenario_summary
from wtg_gym.cli.simulate import ScenarioOptions
from wtg_gym.files import interpreting, read_json
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES, STRATEGY_NAMES, TrackingLaw, get_law
from wtg_gym.physics.trajectory import simulate
from wtg_gym.progress import Progress
from wtg_gym.scenarios import Suite, get_suite, read_wind_csv
from wtg_gym.tasks import V0


def run(
    given: ScenarioOptions,
    plant: PlantOptions,
    strategies: Sequence[str],
    *,
    plot: Path | None,
    csv: Path | None,
    json: bool,
) -> int:
    """Simulate a scenario under laws, write what was asked for, and return the exit code."""
    if plot is not None:
        require_extra("matplotlib", "--plot")
    suite = get_suite(given.suite)
    scenario = _scenario(given, suite)
    settings = suite.plant.replaced(
        # Another number of groups stands at bus 2.
        groups=None if scenario.n_wtg == len(suite.plant.groups) else scenario.n_wtg,
        control_dt=plant.control_dt or suite.plant.control_dt,
        trips_groups=(plant.on_failure or suite.task.on_failure) == "trip",
        **plant.replaced(),
    )
    every = STRATEGIES if suite.task is V0 else STRATEGY_NAMES
    laws = _laws(strategies, settings.turbine, every)
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
            {
                "scenario": scenario_summary(scenario),
                "plant": _plant_summary(plant, suite, settings),
                "runs": figures,
            }
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
        scenario = read_scenario(given.scenario, suite)
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
    if suite.task is not V0 and len(wind) != len(suite.plant.groups):
        raise ValueError(f"there is wind for {len(wind)} WTG groups, {suite.name} has {len(suite.plant.groups)}")
    return dataclasses.replace(scenario, wind_speed=wind, wind_dt_s=wind_dt_s)


def read_scenario(path: Path, suite: Suite) -> Scenario:
    """Return the scenario of a file; a ValueError says what is wrong with it, or that it is of another version."""
    data = read_json(path, "scenario file")
    with interpreting(path, "scenario file"):
        scenario = Scenario.from_dict(data)
    if scenario.sensors is not None and not suite.task.has_sensors:
        raise ValueError(
            f"{path} has sensors, as scenarios of version v1: say with --suite whose grid it is, such as standard-v1"
        )
    return scenario


def _plant_summary(options: PlantOptions, suite: Suite, plant: Plant) -> dict[str, Any]:
    return {
        "groups": [dataclasses.asdict(group) for group in plant.groups],
        "control_dt_s": plant.control_dt,
        "simulation_dt_s": plant.simulation_dt,
        "machine_model": options.machine_model,
        "on_failure": "trip" if plant.trips_groups else "terminate",
        "physics": options.physics or ("extended" if suite.plant.extended else "paper"),
    }
