"""What `wtg-gym simulate` runs and prints: scenarios under laws, with their key figures."""

import csv as csv_format
import dataclasses
import io
from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.cli import output, suites
from wtg_gym.cli.options import ScenarioOptions
from wtg_gym.files import interpreting, read_json
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import GroupTrip, Scenario
from wtg_gym.physics.tracking_law import LAW_NAMES, LAWS, get_law
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.physics.units import TripCause
from wtg_gym.progress import Progress
from wtg_gym.scenarios import Suite, get_suite, read_wind_csv
from wtg_gym.tasks import V0, episode


def run(options: ScenarioOptions, strategies: Sequence[str], *, plot: Path | None, csv: Path | None, json: bool) -> int:
    """Simulate a scenario under laws, write what was asked for, and return the exit code."""
    if plot is not None:
        output.require_extra("matplotlib", "--plot")
    suite = get_suite(options.suite)
    scenario = _scenario(options, suite)
    settings = suite.plant.replaced(
        # Another number of groups stands at bus 2.
        groups=None if scenario.n_wtg == len(suite.plant.groups) else scenario.n_wtg,
        trips_groups=suite.task.on_failure == "trip",
    )
    everything = LAWS if suite.task is V0 else LAW_NAMES
    laws = {}
    for name in dict.fromkeys(law for word in strategies for law in (everything if word == "all" else (word,))):
        law = get_law(name, settings.turbine)
        if law.name in laws:
            raise ValueError(f"two laws are called {law.name!r}; give the law in {name} another name")
        laws[law.name] = law
    runs = {}
    with Progress("runs") as progress:
        for done, (name, law) in enumerate(laws.items()):
            progress.update(name, done, len(laws))
            runs[name] = simulate(scenario, law, settings)
    if plot is not None:
        from wtg_gym.plotting import figure_bytes, plot_trajectories

        output.write_and_say(plot, figure_bytes(plot_trajectories(runs, scenario), plot.suffix))
    if csv is not None:
        output.write_and_say(csv, traces_csv(runs))
    figures = [key_figures(name, trajectory, scenario) for name, trajectory in runs.items()]
    if json:
        series = ("wind_speed", "wind_dt_s", "load_noise_mw")
        data = {key: value for key, value in scenario.to_dict().items() if key not in series}
        data["mean_wind_m_s"] = [round(float(mean), 6) for mean in scenario.wind_speed.mean(axis=1)]
        plant_data = {
            "groups": [dataclasses.asdict(group) for group in settings.groups],
            "control_dt_s": settings.interval_s,
            "simulation_dt_s": settings.simulation_dt,
            "on_failure": "trip" if settings.trips_groups else "terminate",
            "physics": "extended" if settings.extended else "paper",
        }
        output.print_json({"scenario": data, "plant": plant_data, "runs": figures})
    else:
        output.say(*suites.describe_scenario(scenario, suite), "")
        has_shed = any(row["shed_energy_mws"] for row in figures)
        columns = {head: key for head, key in _COLUMNS.items() if has_shed or key != "shed_energy_mws"}
        rows = [[row["strategy"], *(_text(row[key]) for key in columns.values()), _end(row)] for row in figures]
        output.print_table(["strategy", *columns, "end"], rows, left=(0, 1 + len(columns)))
    return int(any(trajectory.status == Status.NUMERICAL_FAILURE for trajectory in runs.values()))


def _scenario(options: ScenarioOptions, suite: Suite) -> Scenario:
    if options.scenario is None:
        seed = suite.test[0] if options.seed is None else options.seed
        scenario = suite.scenario(seed, duration_s=options.duration)
    else:
        scenario = read_scenario(options.scenario, suite)
        if options.duration is not None:
            scenario = dataclasses.replace(scenario, duration_s=options.duration)
    if options.wind is None and options.wind_csv is None:
        return scenario
    wind_dt_s = scenario.wind_dt_s
    if options.wind_csv is not None:
        wind, wind_dt_s = read_wind_csv(options.wind_csv, duration_s=scenario.duration_s)
    else:
        assert options.wind is not None
        n_groups = scenario.n_wtg if len(options.wind) == 1 else len(options.wind)
        wind = np.resize(np.array(options.wind), (n_groups, 1))
    if suite.task is not V0 and len(wind) != len(suite.plant.groups):
        raise ValueError(f"there is wind for {len(wind)} WTG groups, {suite.name} has {len(suite.plant.groups)}")
    return dataclasses.replace(scenario, wind_speed=wind, wind_dt_s=wind_dt_s)


def read_scenario(path: Path, suite: Suite) -> Scenario:
    """Return the scenario of a file; a ValueError says what is wrong with it, or that it is of another version."""
    data = read_json(path, "scenario file")
    with interpreting(path, "scenario file"):
        scenario = Scenario.from_dict(data)
    if scenario.sensors is not None and not suite.task.has_sensors:
        raise ValueError(f"{path} has sensors, as those of v1: say with --suite whose grid it is, such as standard-v1")
    return scenario


def traces_csv(runs: Mapping[str, Trajectory]) -> str:
    """Return every sample of runs as CSV, with their law; groups, machines and buses count from 1."""
    text = io.StringIO()
    writer = csv_format.writer(text, lineterminator="\n")
    for strategy, run in runs.items():
        columns = {"time_s": run.time_s, "frequency_hz": run.frequency_hz, "shed_energy_mws": run.shed_energy_mws}
        for name, values in vars(run).items():
            if np.ndim(values) == 2:
                unit, quantity = name.split("_", 1) if name.startswith(("machine", "bus")) else ("group", name)
                columns |= {f"{unit}_{i}_{quantity}": 1.0 * column for i, column in enumerate(values.T, start=1)}
        if not text.tell():
            writer.writerow(["strategy", *columns])
        writer.writerows([strategy, *(f"{x:.9g}" for x in row)] for row in zip(*columns.values(), strict=True))
    return text.getvalue()


#: Numbers of a run that are printed, by their headings.
_COLUMNS = {
    "nadir [Hz]": "nadir_hz",
    "zenith [Hz]": "zenith_hz",
    "lowest of all units [Hz]": "local_nadir_hz",
    "highest of all units [Hz]": "local_zenith_hz",
    f"RoCoF, {1000 * episode.ROCOF_WINDOW_S:.0f} ms [Hz/s]": "largest_rocof_hz_s",
    "final [Hz]": "final_frequency_hz",
    "final rotor speed [p.u.]": "final_rotor_speed_pu",
    "final power [p.u.]": "final_power_pu",
    "not served [MW s]": "shed_energy_mws",
}


def key_figures(name: str, run: Trajectory, scenario: Scenario) -> dict[str, Any]:
    """Return the key figures of a run of a scenario as JSON-ready data with units in the keys; groups count from 1.

    Those that are called local are the extremes over all groups, machines and, in extended physics, buses.
    """
    ratios, rotors = run.tip_speed_ratio[-1], run.rotor_speed_pu[-1]
    extremes = {Status.STALL: -ratios, Status.OVER_SPEED: rotors, Status.UNDER_SPEED: -rotors}
    rocof = run.rocof_hz_s(episode.ROCOF_WINDOW_S)
    trips = []
    for group, cause in enumerate(run.trip_causes):
        if cause is not None:
            # A disconnected group delivers exactly nothing after the sample of its trip.
            time_s = run.time_s[np.flatnonzero(run.power_pu[:, group]).max(initial=0)]
            if cause == TripCause.EVENT:
                time_s = min(e.time_s for e in scenario.events if isinstance(e, GroupTrip) and e.group == group)
            trips.append({"group": 1 + group, "time_s": _plain(time_s), "cause": _word(cause)})
    figures = {
        "end_time_s": run.time_s[-1],
        "nadir_hz": run.frequency_hz.min(),
        "zenith_hz": run.frequency_hz.max(),
        "largest_rocof_hz_s": rocof[np.argmax(np.abs(rocof))],
        "local_nadir_hz": run.local_frequency_hz.min(),
        "local_zenith_hz": run.local_frequency_hz.max(),
        "shed_energy_mws": run.shed_energy_mws[-1],
        "final_frequency_hz": run.frequency_hz[-1],
        "final_rotor_speed_pu": rotors,
        "final_power_pu": run.power_pu[-1],
    }
    return {
        "strategy": name,
        "status": "completed" if run.status == Status.RUNNING else _word(run.status),
        "failed_group": 1 + int(np.argmax(extremes[run.status])) if run.status in extremes else None,
        "tripped_groups": trips,
        **{key: _plain(value) for key, value in figures.items()},
    }


def _word(member: IntEnum) -> str:
    return member.name.lower().replace("_", "-")


def _plain(value: Any) -> Any:
    """A number or a list of them without the noise of last digits; None where JSON has no number for it."""
    if np.ndim(value):
        return [_plain(item) for item in value]
    return round(float(value), 9) if np.isfinite(value) else None


def _end(row: Mapping[str, Any]) -> str:
    if row["status"] == "completed":
        trips = [
            f"group {trip['group']} tripped at {trip['time_s']:.1f} s ({trip['cause']})"
            for trip in row["tripped_groups"]
        ]
        return "; ".join([*trips, f"completed {row['end_time_s']:.1f} s"])
    group = f" of group {row['failed_group']}" if row["failed_group"] else ""
    return f"{row['status'].replace('-', ' ')}{group} at {row['end_time_s']:.1f} s"


def _text(value: Any) -> str:
    if isinstance(value, list):
        return " / ".join(map(_text, value))
    return "–" if value is None else f"{value:.3f}"
