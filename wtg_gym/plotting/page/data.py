"""The page's data, ready for JSON: summaries, profiles, scenarios and traces of every suite."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from wtg_gym.envs.rendering.diagram import BUS_PLACES, describe_event, struck_buses
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, EntrySummary, Interval, Results, leaderboard_rows, statistics, table_cells
from wtg_gym.evaluation.recording import Recording, record
from wtg_gym.evaluation.score import scenario_scores, score_scale
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.compiled import source_hash
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, TurbineParameters
from wtg_gym.physics.scenario import Event, LoadStep, Scenario
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.plotting.front import MOST_FAILURES_PERCENT
from wtg_gym.plotting.page.packing import MISSING, RESOLUTIONS, WIND_RESOLUTION, packed, quantised, scenario_traces
from wtg_gym.scenarios import get_suite

Progress = Callable[[str, int, int], None]

#: Step that the scenarios' scores are rounded to.
SCORE_RESOLUTION = 0.1

#: Attribute of the summary, heading, whether more is better.
PHYSICAL_METRICS = (
    ("failures_percent", "failures\n[%]", False),
    ("mean_pinned_cost", "pinned\ncost", False),
    ("median_nadir_hz", "nadir\n[Hz]", True),
    ("p95_rocof_hz_s", "RoCoF\n[Hz/s]", False),
    ("p95_peak_power_pu", "peak P\n[p.u.]", False),
    ("p95_power_change_pu", "ΔP(1 s)\n[p.u.]", False),
    ("mean_duty_error_percent", "duty err.\n[%]", False),
    ("mean_energy_share_percent", "energy\n[%]", True),
)


def page_data(
    results: Sequence[Results],
    entries: Sequence[Entry],
    *,
    n_scenarios: int,
    n_threads: int | None = None,
    on_progress: Progress | None = None,
) -> dict[str, Any]:
    """Return everything the page shows.

    Args:
        results: one of each suite.
        entries: those whose traces are recorded, where the results are theirs; both anchors are always recorded.
        n_scenarios: scenarios with traces, the first ones of each suite's results.
        on_progress: called with (name of the entry, entries done, entries in all) after every entry.

    Raises:
        ValueError: no results, two of one suite, or traces of results that another source code gave.
        NoScaleError: the results have no score, see :attr:`Results.summaries`.
    """
    names = [each.name for each in results]
    if not names or len(set(names)) < len(names):
        raise ValueError(
            "the page needs results with the suites' own sensors, one of each suite and split; "
            f"got {', '.join(names) or 'none'}"
        )
    if n_scenarios < 0:
        raise ValueError(f"the number of scenarios with traces must be 0 or more, got {n_scenarios}")
    for each in results:
        if n_scenarios and each.source_hash != source_hash():
            raise ValueError(
                f"the results {each.name} are of another source code, so that traces of today's would not be theirs; "
                "evaluate again, or ask for 0 scenarios with traces"
            )
    played = [_played(each, entries) if n_scenarios else [] for each in results]
    n_all, done = sum(map(len, played)), 0
    suites = []
    for each, own in zip(results, played, strict=True):
        scenarios = _scenarios(each, n_scenarios)
        recordings: dict[str, Recording] = {}
        for entry in own:
            recordings[entry.name] = record(entry, _settings(each), scenarios, n_threads)
            done += 1
            if on_progress is not None:
                on_progress(entry.name, done, n_all)
        suites.append(_suite(each, scenarios, own, recordings))
    return {
        "metrics": [{"name": name, "label": label, "up": up} for name, label, up in PHYSICAL_METRICS],
        "series": [{"name": name, "step": step} for name, step in RESOLUTIONS.items()],
        "wind_step": WIND_RESOLUTION,
        "score_step": SCORE_RESOLUTION,
        "most_failures": MOST_FAILURES_PERCENT,
        "missing": MISSING,
        "nominal": modified_ieee14().frequency_hz,
        "tip_speed": TurbineParameters().tip_speed_ratio_per_speed_m_s,
        "case": _case(),
        "suites": suites,
    }


def untraced(results: Sequence[Results], entries: Sequence[Entry]) -> list[str]:
    """Return the names of the entries of the results whose traces cannot be recorded from these entries."""
    names = {data["name"]: None for each in results for data in each.entries}
    for each in results:
        traced = {entry.name for entry in _played(each, entries)}
        names = {name: None for name in names if name not in traced}
    return list(names)


def _played(results: Results, entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries that the results are of, the first training seed of each name, and both anchors."""
    found: dict[str, Entry] = {}
    for entry in entries:
        if entry.name not in found and entry.to_dict() in results.entries:
            found[entry.name] = entry
    for name in results.benchmark.anchors:
        found.setdefault(name, Entry(name=name, strategy=name))
    return list(found.values())


def _settings(results: Results) -> EnvSettings:
    known = {field.name for field in dataclasses.fields(EnvSettings)}
    shared = {key: value for key, value in results.settings.items() if key in known}
    return EnvSettings(suite=results.suite, split=results.split, **shared)


def _scenarios(results: Results, n: int) -> list[Scenario]:
    if n == 0:
        return []
    groups = results.settings["groups"]
    return get_suite(results.suite).scenarios(
        results.seeds[:n],
        n_wtg=len(groups),
        n_turbines=[group["n_turbines"] for group in groups],
        duration_s=results.settings["duration_s"],
        sensors=_settings(results).sensor_distribution(),
    )


def _suite(
    results: Results, scenarios: Sequence[Scenario], played: Sequence[Entry], recordings: Mapping[str, Recording]
) -> dict[str, Any]:
    rows = leaderboard_rows(results)
    gains = results.log_gains
    zero, hundred = (results.pinned_costs[name][0] for name in results.benchmark.anchors)
    scale = score_scale(zero, hundred, results.benchmark.anchors)
    scores = {name: scenario_scores(own, scale) for name, own in gains.items()}
    order = [row.name for row in rows if row.name in recordings]
    seeds = {entry.name: entry.training_seed for entry in played}
    return {
        "name": results.suite if results.split == "test" else f"{results.suite}, {results.split}",
        "environment": results.benchmark.env_id,
        "zero": results.benchmark.zero,
        "hundred": results.benchmark.hundred,
        "limits": limits(results.suite),
        "split": results.split,
        "description": get_suite(results.suite).description,
        "hash": results.suite_hash,
        "source": results.source_hash,
        "versions": dict(sorted(results.versions.items())),
        "seeds": results.seeds,
        "groups": [int(group["bus"]) for group in results.settings["groups"]],
        "entries": [
            _entry(results, row, int(cells[0]), seeds) for row, cells in zip(rows, table_cells(rows), strict=True)
        ],
        # Rows of every entry's runs, in the order of the entries.
        "scores": packed(quantised(np.vstack([scores[row.name] for row in rows]), SCORE_RESOLUTION)),
        "differences": packed(
            quantised(
                _lower_bounds([gains[row.name] for row in rows], gains[results.benchmark.zero][0]), SCORE_RESOLUTION
            )
        ),
        "traced": order,
        "scenarios": [
            _scenario(results, scenario, place, seeds, [recordings[name] for name in order])
            for place, scenario in enumerate(scenarios)
        ],
    }


def _lower_bounds(gains: Sequence[Floats], zero: Floats) -> Floats:
    """Return lower ends of the intervals of the differences of mean scores, (n, n): row minus column.

    The upper end is minus the lower one the other way round.

    Args:
        gains: log gains of the entries in the order of the ranking, (n_runs, n_scenarios) each.
        zero: log gains of the zero (n_scenarios,).
    """
    bounds = np.zeros((len(gains), len(gains)))
    above = [statistics.resampled_scores(own, zero, side=1) for own in gains]
    for row, own in enumerate(gains):
        samples = statistics.resampled_scores(own, zero)
        for column in range(row):
            interval = statistics.percentile_interval(0.0, samples - above[column])
            bounds[row, column], bounds[column, row] = interval.low, -interval.high
    return bounds


def _entry(results: Results, row: EntrySummary, rank: int, training_seeds: Mapping[str, int | None]) -> dict[str, Any]:
    described = next(data for data in results.entries if data["name"] == row.name)
    # The run that is traced, the first where none is.
    seed = training_seeds.get(row.name, described["training_seed"])
    every = list(dict.fromkeys(episode.training_seed for episode in results.episodes_of(row.name)))
    return {
        "rank": rank,
        "name": row.name,
        "kind": row.kind,
        "action": "" if row.kind == "law" else described["action_mode"],
        "observation": "" if row.kind == "law" else described["observation_mode"],
        "description": described["description"],
        "equation": described["equation"],
        "source": described["source"],
        "sha256": described["sha256"],
        "n_runs": row.n_runs,
        "traced_run": every.index(seed),
        "training_seed": seed,
        "score": _interval(row.score),
        "above": None if row.difference_to_above is None else _interval(row.difference_to_above),
        "points": {term: round(value, 2) + 0.0 for term, value in row.points_by_term.items()},
        "iqm": _interval(row.interquartile_mean),
        "improvement": _interval(row.probability_of_improvement, 3),
        "gap": None if row.gap_closed_percent is None else _interval(row.gap_closed_percent),
        "physical": [round(float(getattr(row, name)), 5) for name, _, _ in PHYSICAL_METRICS],
    }


def _interval(interval: Interval, digits: int = 2) -> list[float]:
    return [round(value, digits) + 0.0 for value in (interval.value, interval.low, interval.high)]


def _scenario(
    results: Results,
    scenario: Scenario,
    place: int,
    training_seeds: Mapping[str, int | None],
    recordings: Sequence[Recording],
) -> dict[str, Any]:
    seed = results.seeds[place]
    droop = "" if scenario.governor_droop is None else f", governor droop {100 * scenario.governor_droop:.1f} %"
    wind = ", ".join(f"{series.mean():.1f}" for series in scenario.wind_speed)
    buses = [group["bus"] for group in results.settings["groups"]]
    return {
        "seed": seed,
        "name": scenario.name,
        "facts": f"mean wind {wind} m/s, load level {scenario.load_level:.2f}, "
        f"inertia {100 * scenario.inertia_scale:.0f} %{droop}",
        "events": [_event(event, buses) for event in sorted(scenario.events, key=lambda event: event.time_s)],
        "failures": {
            episode.entry: [episode.failure, round(float(episode.metrics["survived_s"] or 0.0), 1)]
            for episode in results.episodes
            if episode.seed == seed and episode.failed and episode.run in training_seeds.items()
        },
        **scenario_traces(recordings, place),
    }


def _event(event: Event, group_buses: Sequence[int]) -> dict[str, Any]:
    return {
        "time": round(event.time_s, 2),
        "lasts": round(event.end_s - event.time_s, 2),
        "buses": struck_buses(event, group_buses),
        "text": describe_event(event),
        "load": event.power_mw if isinstance(event, LoadStep) else 0.0,
    }


def limits(suite: str) -> dict[str, dict[str, float]]:
    """Return the dotted lines of the panels of traces in a suite: by panel, their names and values."""
    own = get_suite(suite)
    control, nominal = GridFormingParameters(), modified_ieee14().frequency_hz
    best, deloaded = tracking_point(0.0), tracking_point(control.deloading_limit)
    hundred = own.benchmark.hundred
    return {
        # Beyond it the deviation costs four times as much.
        "frequency": {"nominal − 0.2 Hz": nominal - 0.2, "nominal + 0.2 Hz": nominal + 0.2},
        "rotor": {"the pitch's limit": PitchParameters().rotor_speed_limit_pu},
        # Beyond them a rotor outside its range costs.
        "ratio": {"0.9 λ_opt": 0.9 * best.tip_speed_ratio, "1.1 λ_pr": 1.1 * deloaded.tip_speed_ratio},
        "power": {"the converter's limit": own.plant.overload_from_pu or control.overload_limit_pu},
        "k": {"K_pr": deloaded.coefficient, "K_opt": best.coefficient},
        "tau": {f"the τ of {hundred}": get_law(hundred).damping_time_constant_s},
    }


def _case() -> dict[str, Any]:
    case = modified_ieee14()
    return {
        "buses": {str(bus.number): list(BUS_PLACES[bus.number]) for bus in case.buses},
        "loads": {str(bus.number): bus.load_mw for bus in case.buses if bus.load_mw},
        "branches": [[branch.from_bus, branch.to_bus] for branch in case.branches],
        # The machine with a governor is the generator; the others are condensers.
        "machines": [[machine.bus, "G" if machine.governor is not None else "C"] for machine in case.machines],
    }
