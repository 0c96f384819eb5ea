"""What the page shows, as JSON-ready data: summaries, profiles, scenarios and traces of every suite."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import ANCHORS, Entry, EntrySummary, Interval, Results, leaderboard_rows, statistics
from wtg_gym.evaluation.recording import Recording, record
from wtg_gym.evaluation.summary import pinned
from wtg_gym.physics.compiled import source_hash
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.scenario import Event, LineTrip, LoadRamp, LoadStep, Scenario
from wtg_gym.rendering import BUS_PLACES, describe_event
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]

#: Samples of the page's traces come this far apart [s].
TRACE_STEP_S = 0.2
#: Steps that the traces' numbers are rounded to; the wind comes once a scenario, everything else once an entry, the
#: frequency as its deviation from the nominal one.
RESOLUTIONS: Mapping[str, float] = {
    "frequency": 0.0005,
    "rocof": 0.002,
    "rotor": 0.0005,
    "power": 0.0005,
    "k": 0.001,
    "tau": 0.005,
}
WIND_RESOLUTION = 0.005
#: What stands for "no value": the episode is over, or the law has no such quantity.
MISSING = -32768
#: Scores that the performance profile counts scenarios above.
_PROFILE_LOW, _PROFILE_STEP = -50.0, 0.5
#: Attribute of the summary, heading, whether more is better.
PHYSICAL_METRICS = (
    ("failures_percent", "failures\n[%]", False),
    ("mean_cost", "mean\ncost", False),
    ("median_nadir_hz", "nadir\n[Hz]", True),
    ("p95_rocof_hz_s", "RoCoF\n[Hz/s]", False),
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
        n_threads: threads to step with; None for one per processor.
        on_progress: called with (name of the entry, entries done, entries in all) after every entry.

    Raises:
        ValueError: no results, two of one suite, or traces of results that another source code gave.
        NoScaleError: there is no score, see :attr:`Results.summaries`.
    """
    names = [each.name for each in results]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"the page needs results, one of each suite and split; got {', '.join(names) or 'none'}")
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
        "metrics": [{"label": label, "up": up} for _, label, up in PHYSICAL_METRICS],
        "series": [{"name": name, "step": step} for name, step in RESOLUTIONS.items()],
        "wind_step": WIND_RESOLUTION,
        "missing": MISSING,
        "nominal": modified_ieee14().frequency_hz,
        "tip_speed": TurbineParameters().tip_speed_ratio_per_speed_m_s,
        "reference": ANCHORS[1],
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
    for name in ANCHORS:
        found.setdefault(name, Entry(name=name, strategy=name))
    return list(found.values())


def _settings(results: Results) -> EnvSettings:
    shared = {key: value for key, value in results.settings.items() if key != "authority"}
    return EnvSettings(suite=results.suite, split=results.split, **shared)


def _scenarios(results: Results, n: int) -> list[Scenario]:
    groups = results.settings["groups"]
    return get_suite(results.suite).scenarios(
        results.seeds[:n],
        n_wtg=len(groups),
        n_turbines=[group["n_turbines"] for group in groups],
        duration_s=results.settings["duration_s"],
    )


def _suite(
    results: Results, scenarios: Sequence[Scenario], played: Sequence[Entry], recordings: Mapping[str, Recording]
) -> dict[str, Any]:
    rows = leaderboard_rows(results)
    scores = _scores(results)
    top = max(float(values.max()) for values in scores.values())
    grid = np.arange(_PROFILE_LOW, math.ceil(top) + 2.0 * _PROFILE_STEP, _PROFILE_STEP)
    order = [row.name for row in rows if row.name in recordings]
    seeds = {entry.name: entry.training_seed for entry in played}
    return {
        "name": results.suite,
        "split": results.split,
        "description": get_suite(results.suite).description,
        "hash": results.suite_hash,
        "source": results.source_hash,
        "versions": dict(sorted(results.versions.items())),
        "n_scenarios": len(results.seeds),
        "groups": [int(group["bus"]) for group in results.settings["groups"]],
        "profile": {"low": _PROFILE_LOW, "step": _PROFILE_STEP},
        "entries": [
            _entry(results, rank, row, scores[row.name], grid, seeds) for rank, row in enumerate(rows, start=1)
        ],
        "traced": order,
        "scenarios": [
            _scenario(results, scenario, place, seeds, [recordings[name] for name in order])
            for place, scenario in enumerate(scenarios)
        ],
    }


def _scores(results: Results) -> dict[str, Floats]:
    """Return the scenarios' scores of every entry, (n_runs, n_scenarios)."""
    cap = float(results.settings["weights"]["cap"])
    runs: dict[str, dict[int | None, list[float]]] = {}
    for episode in results.episodes:
        runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(pinned(episode, cap))
    costs = {name: np.array(list(own.values())) for name, own in runs.items()}
    mppt, reference = (costs[name][0] for name in ANCHORS)
    scale = statistics.score_scale(mppt, reference)
    return {
        name: statistics.scenario_scores(statistics.log_gains(own, reference), scale) for name, own in costs.items()
    }


def _entry(
    results: Results,
    rank: int,
    row: EntrySummary,
    scores: Floats,
    grid: Floats,
    training_seeds: Mapping[str, int | None],
) -> dict[str, Any]:
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
        "training_seed": seed,
        "score": _interval(row.score),
        "iqm": _interval(row.interquartile_mean),
        "improvement": _interval(row.probability_of_improvement, 3),
        "gap": None if row.gap_closed_percent is None else _interval(row.gap_closed_percent),
        "physical": [round(float(getattr(row, name)), 5) for name, _, _ in PHYSICAL_METRICS],
        "above": [round(float(value), 4) for value in (scores.ravel()[:, None] > grid).mean(axis=0)],
        "scenario_scores": [round(float(value), 1) for value in scores[every.index(seed)]],
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
    return {
        "seed": seed,
        "name": scenario.name,
        "facts": f"mean wind {wind} m/s, load level {scenario.load_level:.2f}, "
        f"inertia {100 * scenario.inertia_scale:.0f} %{droop}",
        "events": [_event(event) for event in sorted(scenario.events, key=lambda event: event.time_s)],
        "failures": {
            episode.entry: [episode.failure, round(float(episode.metrics["survived_s"] or 0.0), 1)]
            for episode in results.episodes
            if episode.seed == seed and episode.failed and episode.run in training_seeds.items()
        },
        **_traces(recordings, place),
    }


def _event(event: Event) -> dict[str, Any]:
    buses = [event.from_bus, event.to_bus] if isinstance(event, LineTrip) else [event.bus]
    lasts = event.duration_s if isinstance(event, LoadRamp) else 0.0
    load = event.power_mw if isinstance(event, LoadStep) else 0.0
    return {
        "time": round(event.time_s, 2),
        "lasts": round(lasts, 2),
        "buses": buses,
        "text": describe_event(event),
        "load": load,
    }


# --- traces ----------------------------------------------------------------------------------------------------------


def _traces(recordings: Sequence[Recording], place: int) -> dict[str, Any]:
    """Return the traces of a scenario, all entries together: packed rows, and how many samples each has."""
    if not recordings:
        return {"n": 0, "step": TRACE_STEP_S, "packed": ""}
    first = recordings[0]
    step = float(first.time_s[1] - first.time_s[0])
    stride = max(1, round(TRACE_STEP_S / step))
    longest = max(recordings, key=lambda recording: recording.time_s.size)
    n = len(range(0, longest.time_s.size, stride))
    # Wind is the scenario's: whoever lasts longest has seen most of it.
    full = max(recordings, key=lambda recording: int(np.isfinite(recording.wind_m_s[place, :, 0]).sum()))
    rows = [quantised(wind, WIND_RESOLUTION) for wind in full.wind_m_s[place, ::stride].T]
    for recording in recordings:
        for name, resolution in RESOLUTIONS.items():
            rows += [quantised(values, resolution) for values in _values(recording, name, place)[::stride].T]
    table = np.full((len(rows), n), MISSING, dtype=np.int16)
    for index, row in enumerate(rows):
        table[index, : row.size] = row
    return {"n": n, "step": round(stride * step, 6), "packed": packed(table)}


def _values(recording: Recording, name: str, place: int) -> Floats:
    """Return one of the page's quantities, (n, 1) of the grid or (n, n_wtg)."""
    if name == "frequency":
        deviation: Floats = recording.frequency_hz[place][:, np.newaxis] - modified_ieee14().frequency_hz
        return deviation
    arrays: dict[str, Floats] = {
        "rocof": recording.rocof_hz_s,
        "rotor": recording.rotor_speed_pu,
        "power": recording.power_pu,
        "k": recording.coefficient_pu,
        "tau": recording.time_constant_s,
    }
    values: Floats = arrays[name][place]
    return values


def quantised(values: Floats, resolution: float) -> npt.NDArray[np.int16]:
    """Return numbers as whole steps of a resolution, :data:`MISSING` where there is none, limited to what fits."""
    steps = np.clip(np.round(np.nan_to_num(values, posinf=0.0, neginf=0.0) / resolution), MISSING + 1, -MISSING - 1)
    whole: npt.NDArray[np.int16] = np.where(np.isfinite(values), steps, MISSING).astype(np.int16)
    return whole


def packed(table: npt.NDArray[np.int16]) -> str:
    """Return rows of whole numbers as base64 of their deflated differences, all low bytes before all high bytes."""
    differences = np.diff(table.astype(np.int64), axis=1, prepend=0).astype("<u2")
    low, high = (differences & 0xFF).astype(np.uint8), (differences >> 8).astype(np.uint8)
    return base64.b64encode(zlib.compress(low.tobytes() + high.tobytes(), 9)).decode()


def unpacked(text: str, n_rows: int) -> npt.NDArray[np.int16]:
    """Return the rows that :func:`packed` packed, as the page does it too."""
    low, high = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8).reshape(2, n_rows, -1)
    differences = low.astype(np.uint16) | (high.astype(np.uint16) << 8)
    table: npt.NDArray[np.int16] = np.cumsum(differences, axis=1, dtype=np.uint16).view(np.int16)
    return table


# --- the grid --------------------------------------------------------------------------------------------------------


def _case() -> dict[str, Any]:
    case = modified_ieee14()
    return {
        "buses": {str(bus.number): list(BUS_PLACES[bus.number]) for bus in case.buses},
        "loads": {str(bus.number): bus.load_mw for bus in case.buses if bus.load_mw},
        "branches": [[branch.from_bus, branch.to_bus] for branch in case.branches],
        # The machine with a governor is the generator; the others are condensers.
        "machines": [[machine.bus, "G" if machine.governor is not None else "C"] for machine in case.machines],
    }


__all__ = ["MISSING", "PHYSICAL_METRICS", "RESOLUTIONS", "packed", "page_data", "quantised", "unpacked", "untraced"]
