"""The numbers of a report about one entry of version v1, on the test scenarios of its standard suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TERMINATION_REASONS
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import faults, summary
from wtg_gym.evaluation.adjusted import Adjusted
from wtg_gym.evaluation.damping import Damping, damping
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.evaluator import Progress, evaluate, play_batch
from wtg_gym.evaluation.grid_tests import GRID_TESTS, Verdict, run_grid_test
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.score import cost_offsets, gains
from wtg_gym.evaluation.statistics import Floats, Interval, mean, sign_test
from wtg_gym.evaluation.summary import EntrySummary
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies import Entry, PolicyError
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.scenarios.suites import DEFAULT_SUITE, get_suite

SUITE, SPLIT = DEFAULT_SUITE, "test"
#: The yardstick of energy, which captures what the wind gives.
_MOST_ENERGY = "mppt"
#: Test scenarios that sensors fail in, and that energy is counted in; scenarios that are drawn.
N_WITH_FAULTS, N_OF_ENERGY, N_DRAWN = 60, 60, 3
_MJ_PER_MWH = 3600.0
#: Parts of a report after the score, as progress counts them.
_N_PARTS = 5


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Episodes side by side, a sample at the start and after every step; NaN once one has ended; (n, n_lanes) each."""

    time_s: Floats  # (n,)
    frequency_hz: Floats  # of the centre of inertia
    worst_hz: Floats  # of the bus or unit farthest from nominal
    wind_m_s: Floats  # mean over the turbines
    power_mw: Floats  # of all groups
    rotor_speed_pu: Floats  # of the slowest rotor
    unserved_mw: Floats  # load
    stored_mj: Floats  # kinetic energy of the rotors of each group (n, n_lanes, n_wtg)
    whole: npt.NDArray[np.bool_]  # whether each episode went to its end, with all groups connected (n_lanes,)
    costs: Floats  # (n_lanes,)
    failures: list[str]  # why each ended before its time, empty where it did not (n_lanes,)


@dataclass(frozen=True, kw_only=True)
class BadRuns:
    """Runs lost or beyond 0.8 Hz, of the entry and of the anchor on the same scenarios."""

    n: int
    both: int
    entry_alone: int
    anchor_alone: int
    chance: float  # of so many more than the anchor's, were both equally prone
    chance_lost: float  # the same of runs lost
    difference: Interval  # to the anchor [percentage points]


@dataclass(frozen=True, kw_only=True)
class DrawnScenario:
    """A scenario with the runs of the entry and the anchor by their names."""

    scenario: Scenario
    seed: int
    runs: Mapping[str, Recorded]


@dataclass(frozen=True, kw_only=True)
class WithFault:
    """What a fault of the sensors does to an entry."""

    fault: str
    change: Interval  # of the score [points]
    bad_before: int
    bad_after: int


@dataclass(frozen=True, kw_only=True)
class Energy:
    """Energy of an entry, means over scenarios."""

    power_mw: float  # into the grid
    energy_mwh: float
    borrowed_mj: float  # by which the rotors' energy fell, wherever it fell
    repaid_mj: float  # and by which it rose


@dataclass(frozen=True, kw_only=True)
class Report:
    """All that is found about an entry; a text in place of numbers says why there are none."""

    entry: Entry
    spec: str  # by which commands name the entry
    results: Results
    row: EntrySummary
    stored: bool  # whether the results were read, not played
    bad: BadRuns
    drawn: list[DrawnScenario]
    drawn_are_worst: bool  # or asked for by their seeds
    grid_tests: dict[str, Verdict] | str
    with_faults: list[WithFault]
    n_with_faults: int
    energy: dict[str, Energy]
    n_of_energy: int
    damping: dict[str, Damping] | str


def make_report(
    entry: Entry,
    spec: str,
    *,
    seeds: Sequence[int] | None = None,
    drawn: Sequence[int] = (),
    stored: Path | None = None,
    n_threads: int | None = None,
    on_progress: Progress = lambda name, done, n: None,
) -> Report:
    """Return the report of an entry.

    Args:
        entry: of version v1.
        spec: the text that `load_entries` finds it by.
        seeds: test scenarios to play; None for all, which may be read.
        drawn: seeds of the scenarios to draw; empty for those that cost the entry most.
        stored: folder that may have results of the entry.
        n_threads: threads to step with.
        on_progress: called with what is under way, and how much of it is done.

    Raises:
        PolicyError: the entry's policy fails.
        ValueError: the entry is of another version.
    """
    results = None if seeds is not None else _stored_results(stored, entry)
    played = results is None
    if results is None:
        results = evaluate(entry, SUITE, SPLIT, seeds=seeds, n_threads=n_threads, on_progress=on_progress)
    row = next(row for row in results.ranking if row.name == entry.name)
    few = results.seeds[:N_OF_ENERGY]
    on_progress("scenarios that are drawn", 0, _N_PARTS)
    scenarios = _drawn(entry, results, drawn)
    on_progress("energy", 1, _N_PARTS)
    energy, n_of_energy = _energy(entry, results, few, n_threads)
    on_progress("faults of sensors", 2, _N_PARTS)
    with_faults = _with_faults(entry, results, n_threads)
    on_progress("damping", 3, _N_PARTS)
    damped = _damping(entry)
    return Report(
        entry=entry,
        spec=spec,
        results=results,
        row=row,
        stored=not played,
        bad=_bad_runs(entry, results, row),
        drawn=scenarios,
        drawn_are_worst=not drawn,
        grid_tests=_grid_tests(entry, on_progress),
        with_faults=with_faults,
        n_with_faults=min(N_WITH_FAULTS, len(results.seeds)),
        energy=energy,
        n_of_energy=n_of_energy,
        damping=damped,
    )


def _stored_results(folder: Path | None, entry: Entry) -> Results | None:
    """Return the stored results of an entry and the version's references, if there are any of the same policy."""
    path = Path(folder or "") / f"{SUITE}-{SPLIT}.json"
    if folder is None or not path.exists():
        return None
    results = Results.read(path)
    results.check_suite()
    runs = {(own["name"], own["training_seed"]): own for own in results.entries}
    own = runs.get((entry.name, entry.training_seed))
    if own is None or own["sha256"] is None or own["sha256"] != entry.identity:
        return None
    kept = {key for key in runs if key[0] in results.task.references} | {(entry.name, entry.training_seed)}
    return replace(
        results,
        entries=tuple(data for key, data in runs.items() if key in kept),
        episodes=tuple(episode for episode in results.episodes if episode.run in kept),
        failed=(),
    )


def _bad(results: Results, name: str) -> Floats:
    """Return 1 where a run of an entry was lost or beyond the design deviation, else 0, (n_scenarios,)."""
    runs = summary.runs_by_name(results.episodes)[name]
    return np.asarray(summary.lost_or_beyond(runs, get_suite(results.suite).nominal_hz)[0])


def _bad_runs(entry: Entry, results: Results, row: EntrySummary) -> BadRuns:
    names = entry.name, results.task.hundred
    own, anchor = (_bad(results, name) for name in names)
    lost = [np.array([[float(episode.failed) for episode in results.episodes_of(name)]]) for name in names]
    return BadRuns(
        n=own.size,
        both=int((own * anchor).sum()),
        entry_alone=int((own * (1.0 - anchor)).sum()),
        anchor_alone=int((anchor * (1.0 - own)).sum()),
        chance=sign_test(own[np.newaxis], anchor[np.newaxis]),
        chance_lost=sign_test(*lost),
        difference=row.lost_or_beyond_to_hundred,
    )


# --- runs ------------------------------------------------------------------------------------------------------------


def recorded(entry: Entry, settings: EnvSettings, scenarios: Sequence[Scenario], n_threads: int | None = 1) -> Recorded:
    """Play an entry through scenarios, and record them."""
    with started_lanes(entry, settings, scenarios, n_threads) as (lanes, _):
        simulator, base_mva = lanes.simulator, lanes.simulator.settings.case.base_mva
        inertia = np.array([turbine.inertia_constant_s for turbine in simulator.settings.turbines])
        rating_mva = base_mva * np.asarray(simulator.plant.share)
        connected, samples = np.ones(lanes.n_lanes, dtype=np.bool_), []

        def sample(running: npt.NDArray[np.bool_]) -> None:
            nonlocal connected
            rotors, power = simulator.wtg_values("rotor_speed"), simulator.wtg_values("power")
            columns = {
                "frequency_hz": lanes.nominal_hz * simulator.lane_values("coi"),
                "worst_hz": lanes.nominal_hz * simulator.lane_values("worst"),
                "wind_m_s": simulator.wtg_values("wind") @ rating_mva / rating_mva.sum(),
                "power_mw": power @ rating_mva,
                "rotor_speed_pu": rotors.min(axis=1),
                "unserved_mw": base_mva * simulator.lane_values("unserved"),
            }
            columns = {name: np.where(running, values, np.nan) for name, values in columns.items()}
            columns["stored_mj"] = np.where(running[:, np.newaxis], inertia * rating_mva * np.square(rotors), np.nan)
            samples.append(columns)
            connected &= (simulator.wtg_values("connected") > 0.5).all(axis=1)

        sample(np.ones(lanes.n_lanes, dtype=np.bool_))
        for running in play(entry, lanes):
            sample(running)
        series = {name: np.array([each[name] for each in samples]) for name in samples[0]}
        return Recorded(
            time_s=lanes.settings.step_s * np.arange(len(samples), dtype=np.float64),
            **series,
            whole=connected & ~lanes.ended()[0],
            costs=lanes.cost_sums().sum(axis=1),
            failures=[TERMINATION_REASONS[Status(status)] for status in lanes.statuses().tolist()],
        )


def _settings() -> EnvSettings:
    return EnvSettings(suite=SUITE, split=SPLIT)


def _anchor(results: Results) -> Entry:
    return load_entries(results.task.hundred)[0]


def _drawn(entry: Entry, results: Results, seeds: Sequence[int]) -> list[DrawnScenario]:
    """Return scenarios with the runs of the entry and the anchor: those given, or those that cost the entry most."""
    anchor = _anchor(results)
    pair = {each.name: each for each in (entry, anchor)}
    if not seeds:
        order = np.argsort(-results.pinned_costs[entry.name][0], kind="stable")
        seeds = [results.seeds[at] for at in order[:N_DRAWN]]
    found = []
    for seed in seeds:
        scenario = get_suite(SUITE).scenario(seed)
        runs = {name: recorded(each, _settings(), [scenario]) for name, each in pair.items()}
        found.append(DrawnScenario(scenario=scenario, seed=int(seed), runs=runs))
    return found


def _episodes(entry: Entry, scenarios: Sequence[Scenario], n_threads: int | None = 1) -> list[Episode]:
    """Play and measure scenarios; a PolicyError is raised."""
    played = play_batch(entry, _settings(), scenarios, n_threads)
    if isinstance(played, PolicyError):
        raise played
    return played


def _grid_tests(entry: Entry, on_progress: Progress) -> dict[str, Verdict] | str:
    """Return the verdicts of the operators' tests, or why the entry cannot play them."""
    verdicts: dict[str, Verdict] = {}
    for done, test in enumerate(GRID_TESTS.values()):
        on_progress(f"operators' test {test.name}", done, len(GRID_TESTS))
        try:
            verdicts[test.name] = run_grid_test(test, entry)[1]
        except ValueError as error:
            return str(error)
    return verdicts


def _with_faults(entry: Entry, results: Results, n_threads: int | None) -> list[WithFault]:
    """Return what each fault of the sensors does to a policy, on the first scenarios; nothing for a law."""
    if entry.policy is None:
        return []
    seeds = results.seeds[:N_WITH_FAULTS]
    few = replace(
        results, seeds=seeds, episodes=tuple(episode for episode in results.episodes if episode.seed in seeds)
    )
    scenarios = get_suite(SUITE).scenarios(seeds)
    changed = {name: (entry, [change(each) for each in scenarios]) for name, change in faults.WORSE_SENSORS.items()}
    failing = {name: (faults.with_fault(entry, *fault), scenarios) for name, fault in faults.SENSOR_FAULTS.items()}
    return [
        _with_fault(name, few, entry.name, _episodes(player, played, n_threads))
        for name, (player, played) in (changed | failing).items()
    ]


def _with_fault(fault: str, before: Results, name: str, episodes: Sequence[Episode]) -> WithFault:
    task = before.task
    assert task.scale is not None
    after = replace(before, episodes=(*(episode for episode in before.episodes if episode.entry != name), *episodes))
    hundred, offsets = before.pinned_costs[task.hundred][0], cost_offsets(before.groups, task)
    own, other = (gains(each.pinned_costs[name], hundred, offsets) for each in (after, before))
    return WithFault(
        fault=fault,
        change=Adjusted(task.scale, before.groups).score_difference(own, other),
        bad_before=int(_bad(before, name).sum()),
        bad_after=int(_bad(after, name).sum()),
    )


def _energy(
    entry: Entry, results: Results, seeds: Sequence[int], n_threads: int | None
) -> tuple[dict[str, Energy], int]:
    """Return the energy of the entry, the anchor and MPPT, and in how many scenarios all of them lost no group."""
    players = {each.name: each for each in (entry, _anchor(results), *load_entries(_MOST_ENERGY))}
    settings, scenarios = _settings(), get_suite(SUITE).scenarios(seeds)
    runs = {name: recorded(player, settings, scenarios, n_threads) for name, player in players.items()}
    whole = np.logical_and.reduce([run.whole for run in runs.values()])
    if not whole.any():
        return {}, 0
    return {name: _energy_of(run, whole) for name, run in runs.items()}, int(whole.sum())


def _energy_of(run: Recorded, whole: npt.NDArray[np.bool_]) -> Energy:
    power, changes = run.power_mw[1:, whole], np.diff(run.stored_mj[:, whole], axis=0)
    n, length_s = int(whole.sum()), float(run.time_s[-1])
    power_mw = mean(power)
    return Energy(
        power_mw=power_mw,
        energy_mwh=power_mw * length_s / _MJ_PER_MWH,
        borrowed_mj=float(-np.minimum(changes, 0.0).sum()) / n,
        repaid_mj=float(np.maximum(changes, 0.0).sum()) / n,
    )


def _damping(entry: Entry) -> dict[str, Damping] | str:
    """Return the damping of the entry, and of its law alone, or why there is none."""
    law = Entry(name=f"{entry.law.name} alone", strategy=entry.law)
    try:
        return {each.name: damping(each) for each in ([entry] if entry.policy is None else [entry, law])}
    except ValueError as error:
        return str(error)
