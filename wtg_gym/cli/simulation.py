"""What `wtg-gym simulate` runs and prints: scenarios under laws, with their key figures."""

from __future__ import annotations

import csv as csv_format
import dataclasses
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym.cli.output import print_json, print_table, require_extra, say, write_and_say
from wtg_gym.cli.suites import describe_scenario
from wtg_gym.files import interpreting, read_json
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES, STRATEGY_NAMES, get_law
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.progress import Progress
from wtg_gym.scenarios import Suite, get_suite, read_wind_csv
from wtg_gym.tasks import V0
from wtg_gym.tasks.episode import ROCOF_WINDOW_S

if TYPE_CHECKING:
    from wtg_gym.cli.simulate import ScenarioOptions


def run(options: ScenarioOptions, strategies: Sequence[str], *, plot: Path | None, csv: Path | None, json: bool) -> int:
    """Simulate a scenario under laws, write what was asked for, and return the exit code."""
    if plot is not None:
        require_extra("matplotlib", "--plot")
    suite = get_suite(options.suite)
    scenario = _scenario(options, suite)
    settings = suite.plant.replaced(
        # Another number of groups stands at bus 2.
        groups=None if scenario.n_wtg == len(suite.plant.groups) else scenario.n_wtg,
        trips_groups=suite.task.on_failure == "trip",
    )
    everything = STRATEGIES if suite.task is V0 else STRATEGY_NAMES
    laws = {}
    for name in dict.fromkeys(each for word in strategies for each in (everything if word == "all" else (word,))):
        law = get_law(name, settings.turbine)
        if law.name in laws:
            raise ValueError(f"two strategies are called {law.name!r}; give the law in {name} another name")
        laws[law.name] = law
    runs = {}
    with Progress("runs") as progress:
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
        data = scenario.to_dict()
        for series in ("wind_speed", "wind_dt_s", "load_noise_mw"):
            del data[series]
        data["mean_wind_m_s"] = [round(float(mean), 6) for mean in scenario.wind_speed.mean(axis=1)]
        plant_data = {
            "groups": [dataclasses.asdict(group) for group in settings.groups],
            "control_dt_s": settings.control_dt,
            "simulation_dt_s": settings.simulation_dt,
            "on_failure": "trip" if settings.trips_groups else "terminate",
            "physics": "extended" if settings.extended else "paper",
        }
        print_json({"scenario": data, "plant": plant_data, "runs": figures})
    else:
        say(*describe_scenario(scenario), "")
        print_key_figures(figures)
    return int(any(trajectory.status == Status.NUMERICAL_FAILURE for trajectory in runs.values()))


def _scenario(options: ScenarioOptions, suite: Suite) -> Scenario:
    """Return the scenario that was asked for, with its wind replaced."""
    if options.scenario is None:
        seed = suite.test[0] if options.seed is None else options.seed
        scenario = suite.scenario(seed, duration_s=options.duration)
    else:
        scenario = read_scenario(options.scenario, suite)
        if options.duration is not None:
            scenario = dataclasses.replace(scenario, duration_s=options.duration)
    wind_dt_s = scenario.wind_dt_s
    if options.wind_csv is not None:
        wind, wind_dt_s = read_wind_csv(options.wind_csv, duration_s=scenario.duration_s)
    elif options.wind is None:
        wind = scenario.wind_speed
    else:
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
        raise ValueError(
            f"{path} has sensors, as scenarios of version v1: say with --suite whose grid it is, such as standard-v1"
        )
    return scenario


# --- key figures -----------------------------------------------------------------------------------------------------


def key_figures(name: str, run: Trajectory) -> dict[str, Any]:
    """Return the key figures of a run as JSON-ready data with units in the keys; groups count from 1.

    Those that are called local are the extremes over all groups, machines and, in extended physics, buses.
    """
    step = float(run.time_s[1] - run.time_s[0]) if run.time_s.size > 1 else ROCOF_WINDOW_S
    local = run.local_frequency_hz
    ratios, rotors = run.tip_speed_ratio[-1], run.rotor_speed_pu[-1]
    extremes = {Status.STALL: -ratios, Status.OVER_SPEED: rotors, Status.UNDER_SPEED: -rotors}
    failed = 1 + int(np.argmax(extremes[run.status])) if run.status in extremes else None
    # A disconnected group delivers exactly nothing; one that came back is not listed.
    off = run.power_pu == 0.0
    tripped = [
        {
            "group": 1 + int(group),
            "time_s": _plain(run.time_s[at]),
            "rotor_speed_pu": _plain(run.rotor_speed_pu[at, group]),
        }
        for group in np.flatnonzero(off[-1])
        # The sample from which on it is off to the end.
        for at in [0 if off[:, group].all() else int(len(off) - np.argmin(off[::-1, group]))]
    ]
    return {
        "strategy": name,
        "status": "completed" if run.status == Status.RUNNING else run.status.name.lower().replace("_", "-"),
        "failed_group": failed,
        "tripped_groups": tripped,
        "end_time_s": _plain(run.time_s[-1]),
        "nadir_hz": _plain(run.frequency_hz.min()),
        "zenith_hz": _plain(run.frequency_hz.max()),
        "largest_rocof_hz_s": _farthest(run.rocof_hz_s(ROCOF_WINDOW_S)),
        "local_nadir_hz": _plain(local.min()),
        "local_zenith_hz": _plain(local.max()),
        "local_rocof_hz_s": _farthest(run.rocof_hz_s(ROCOF_WINDOW_S, local)),
        "local_rocof_100_ms_hz_s": _farthest(run.rocof_hz_s(0.1, local)),
        "shed_energy_mws": _plain(run.shed_energy_mws[-1]),
        "rocof_window_s": _plain(max(1, round(ROCOF_WINDOW_S / step)) * step),
        "final_frequency_hz": _plain(run.frequency_hz[-1]),
        "final_rotor_speed_pu": [_plain(value) for value in run.rotor_speed_pu[-1]],
        "final_power_pu": [_plain(value) for value in run.power_pu[-1]],
    }


def _farthest(values: Floats) -> float | None:
    """The number that is farthest from zero."""
    return _plain(values.ravel()[np.argmax(np.abs(values))])


def _plain(value: float) -> float | None:
    """A float without the noise of its last digits; None where JSON has no number for it."""
    return round(float(value), 9) if np.isfinite(value) else None


def print_key_figures(figures: list[dict[str, Any]]) -> None:
    """Print the key figures of several runs as a table with units."""
    window_ms = round(1000 * figures[0]["rocof_window_s"])
    columns = {
        "strategy": lambda row: row["strategy"],
        "nadir [Hz]": lambda row: _digits(row["nadir_hz"]),
        "zenith [Hz]": lambda row: _digits(row["zenith_hz"]),
        "range of all units [Hz]": lambda row: f"{_digits(row['local_nadir_hz'])} … {_digits(row['local_zenith_hz'])}",
        f"RoCoF, {window_ms} ms [Hz/s]": lambda row: _digits(row["largest_rocof_hz_s"]),
        "final [Hz]": lambda row: _digits(row["final_frequency_hz"]),
        "final rotor speed [p.u.]": lambda row: " / ".join(map(_digits, row["final_rotor_speed_pu"])),
        "final power [p.u.]": lambda row: " / ".join(map(_digits, row["final_power_pu"])),
        "not served [MW s]": lambda row: _digits(row["shed_energy_mws"], 0),
        "end": _end,
    }
    if not any(row["shed_energy_mws"] for row in figures):
        del columns["not served [MW s]"]
    rows = [[cell(row) for cell in columns.values()] for row in figures]
    print_table(list(columns), rows, left=(0, len(columns) - 1))


def _end(row: Mapping[str, Any]) -> str:
    time_s = _digits(row["end_time_s"], 1)
    if row["status"] == "completed":
        trips: dict[str, list[str]] = {}
        for trip in row["tripped_groups"]:
            trips.setdefault(f"{trip['time_s']:.1f} s", []).append(str(trip["group"]))
        parts = [f"group {', '.join(groups)} tripped at {when}" for when, groups in trips.items()]
        return "; ".join([*parts, f"completed {time_s} s"])
    group = f" of group {row['failed_group']}" if row["failed_group"] else ""
    return f"{row['status'].replace('-', ' ')}{group} at {time_s} s"


def _digits(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def traces_csv(runs: Mapping[str, Trajectory]) -> str:
    """Return every sample of every run as CSV: one row per run and instant, units in the header, all from 1."""
    text = io.StringIO()
    writer = csv_format.writer(text, lineterminator="\n")
    for label, run in runs.items():
        columns = {name: getattr(run, name) for name in ("time_s", "frequency_hz", "shed_energy_mws")}
        columns["rocof_hz_s"] = run.rocof_hz_s()
        for name, values in vars(run).items():
            if getattr(values, "ndim", 0) == 2:
                kind, _, rest = name.partition("_")
                unit, quantity = (kind, rest) if kind in ("machine", "bus") else ("group", name)
                columns |= {f"{unit}_{i}_{quantity}": column for i, column in enumerate(values.T, start=1)}
        if not text.tell():
            writer.writerow(["strategy", *columns])
        for row in zip(*columns.values(), strict=True):
            writer.writerow([label, *(f"{value:.9g}" for value in row)])
    return text.getvalue()
