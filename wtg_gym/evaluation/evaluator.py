"""Evaluating entries: every one is played through the scenarios of a suite, many at a time, and again to compare."""

import contextlib
import copy
import dataclasses
import json
import os
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import environment_fingerprint, versions
from wtg_gym.evaluation.episodes import COLUMNS, Episode, check_size
from wtg_gym.evaluation.metrics import frequencies, measure
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.workers import Part, Played, Playing, Workers
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies import Entry, OnnxPolicy, PolicyError, policy_process
from wtg_gym.policies.entry import check_entries, check_version, run_label
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.policies.play import play, started_batch
from wtg_gym.ranges import is_whole, require_count, require_whole
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite
from wtg_gym.scenarios.suite import MOST_SCENARIOS, Suite
from wtg_gym.signals import HeldSignals
from wtg_gym.systems.compiled import source_hash
from wtg_gym.tasks import V0
from wtg_gym.tasks.episode import TIME_CONSTANT_RATIO

Progress = Callable[[str, int, int], None]
#: What :func:`evaluate` plays: names, paths or entries, one or several.
Entries = str | Path | Entry | Sequence[str | Path | Entry]
#: How often the policies of an evaluation that ends early are closed until their threads have ended [s].
_CLOSE_AGAIN_S = 0.05
#: Settings that an entry or an argument of its own decides.
_TAKEN = ("strategy", "action_mode", "observation_mode", "suite", "split", "scenario")

#: The settings of results that are arguments of the environment, and what these are called.
_ARGUMENTS = {name: name for name in ("duration_s", "control_dt", "weights", "groups", "on_failure", "sensors")}
_ARGUMENTS["replaced"] = "plant"
#: What need not change a number: the words of a failure, for example, may depend on the machine.
_CIRCUMSTANCES = {"source_hash", "environment", "versions", "description", "source", "reason"}


def evaluate(
    entries: Entries,
    suite: str = DEFAULT_SUITE,
    split: str = "validation",
    *,
    seeds: Sequence[int] | None = None,
    batch: int = 256,
    n_threads: int | None = None,
    on_progress: Progress | None = None,
    partial: str | Path | None = None,
    workers: Workers | None = None,
    keep_going: bool = False,
    **env_arguments: Any,
) -> Results:
    """Play entries, and the references of the suite's version, through scenarios of a suite, and score them.

    `evaluate("linear-feedback").scores["linear-feedback"]` is a score with its 95 % interval. References are the laws
    that score 0 and 100, and those that scores are adjusted by, :attr:`Task.references`.

    The numbers of a law and of an :class:`OnnxPolicy` depend neither on `batch` nor on `n_threads`, to the last bit;
    another policy's rounding may. A PolicyError names the entry that fails, and step or scenario. A ValueError says
    that an entry is for another version, an argument is unknown or out of range, or the workers cannot be used.

    Args:
        entries: each an :class:`Entry`, or a name or path that :func:`load_entries` takes.
        suite: its name.
        split: "train", "validation" or "test".
        seeds: some of the split's seeds; None for all.
        batch: scenarios that run side by side, of an ONNX policy 64 at most.
        n_threads: threads to step with, and ONNX policies that play side by side; None for one per processor.
        on_progress: called with (name of the entry, episodes done, episodes in all) after every batch.
        partial: folder for finished batches, with which an interrupted run continues, until :meth:`Results.write`.
        workers: other processes that play the same batches, on one thread each.
        keep_going: an entry whose policy fails, or whose law has no equilibrium in a scenario, is left out with all
            training seeds of its name and listed in :attr:`Results.failed`, unless it is a reference.
        env_arguments: further fields of :class:`wtg_gym.envs.settings.EnvSettings`, such as `duration_s`.
    """
    _check_arguments(suite, batch, n_threads, workers, env_arguments)
    settings = EnvSettings(suite=suite, split=split, **env_arguments)
    competitors = _with_references(entries, settings.resolved_suite)
    chosen = chosen_seeds(settings.suite_name, split, seeds)
    check_size((entry.name for entry in competitors), len(chosen))
    shared, of_suite = shared_settings(settings), settings.resolved_suite
    store = PartialStore(partial, [of_suite.name, of_suite.hash, split, shared])
    parts = [part for entry in competitors for part in _parts(entry, chosen, batch)]
    needed = settings.task.references if keep_going else [entry.name for entry in competitors]
    episodes, failures = _episodes(store, parts, settings, n_threads, workers, on_progress, needed)
    return Results(
        suite=settings.suite_name,
        split=split,
        suite_hash=of_suite.hash,
        source_hash=source_hash(),
        seeds=tuple(chosen),
        environment={"id": settings.env_id, "fingerprint": environment_fingerprint(settings)},
        settings=shared,
        versions=dict(versions()),
        entries=tuple(entry.to_dict() for entry in competitors),
        episodes=tuple(episodes),
        parts=store,
    ).without(failures)


def _parts(entry: Entry, seeds: list[int], batch: int) -> list[Part]:
    """Return the batches that an entry is played in."""
    size = min(batch, entry.policy.most_episodes) if isinstance(entry.policy, OnnxPolicy) else batch
    return [(entry, seeds[first : first + size]) for first in range(0, len(seeds), size)]


def _with_references(specs: Entries, suite: Suite) -> list[Entry]:
    """Return the entries, and the version's references that are not among them."""
    if not isinstance(specs, (str, Path, Entry, Sequence)):
        raise ValueError(f"entries must be names, paths or Entry, one or a list of them, got {specs!r}")
    entries: list[Any] = []
    task = suite.task
    for spec in [specs] if isinstance(specs, (str, Path, Entry)) else specs:
        entries += load_entries(spec, task=task) if isinstance(spec, (str, Path)) else [spec]
    check_entries(entries)
    check_version(entries, suite)
    missing = [name for name in task.references if name not in {entry.name for entry in entries}]
    texts = {name: f"{'Anchor' if name in task.anchors else 'Control variate'} of the score." for name in missing}
    return [*entries, *(Entry(name=name, strategy=name, description=text) for name, text in texts.items())]


def _check_arguments(
    suite: str, batch: int, n_threads: int | None, workers: Workers | None, env_arguments: dict[str, Any]
) -> None:
    known = [field.name for field in dataclasses.fields(EnvSettings) if field.name not in _TAKEN]
    unknown = sorted(set(env_arguments) - set(known))
    if unknown:
        raise ValueError(
            f"unknown environment settings {unknown}; allowed here: {', '.join(known)} "
            f"({', '.join(_TAKEN)} are set by the entry or by an argument of its own, a scenario by its seed)"
        )
    require_whole("batch", batch, 1, MOST_SCENARIOS)
    if workers is not None and n_threads not in (None, 1):
        raise ValueError(f"a worker steps with one thread; leave out the threads, got {n_threads!r}")
    if not isinstance(suite, str):
        raise ValueError(f"suite must be a name or the path of a file, by which results find it, got {suite!r:.80}")


def chosen_seeds(suite: str, split: str, seeds: Sequence[int] | None) -> list[int]:
    """Return the seeds of the scenarios that :func:`evaluate` plays; arguments and errors as there."""
    allowed = get_suite(suite).seeds(split)
    text = f"the {split} seeds of suite {suite!r} are {allowed.start} … {allowed.stop - 1}"
    if seeds is None:
        if len(allowed) > MOST_SCENARIOS:
            raise ValueError(f"{text}: too many to play them all; choose some with seeds=")
        return list(allowed)
    if isinstance(seeds, str) or not isinstance(seeds, (Sequence, np.ndarray)) or len(seeds) == 0:
        raise ValueError(f"seeds must be a list of whole numbers, one or more, got {seeds!r}; {text}")
    require_count("the list of seeds", len(seeds), MOST_SCENARIOS)
    if wrong := [seed for seed in seeds if not is_whole(seed) or seed not in allowed]:
        raise ValueError(f"{text}; got {', '.join(map(repr, wrong[:5]))}{' …' if len(wrong) > 5 else ''}")
    if twice := [seed for seed, times in Counter(seeds).items() if times > 1]:
        raise ValueError(f"every seed may be given once; given more often: {', '.join(map(str, twice[:5]))}")
    return [int(seed) for seed in seeds]


def shared_settings(settings: EnvSettings) -> dict[str, Any]:
    """Return the settings that all entries share, defaults filled in, as JSON-ready data."""
    task, plant = settings.task, settings.resolved_plant
    shared: dict[str, Any] = {
        "duration_s": settings.episode_duration_s(),
        "control_dt": float(settings.step_s),
        "simulation_dt": float(plant.simulation_dt),
        "weights": {key: float(value) for key, value in settings.cost_weights()._asdict().items()},
        "groups": [group.to_dict() for group in plant.groups],
        "authority": {"k": task.k_authority, "tau": TIME_CONSTANT_RATIO**task.tau_authority},
        "on_failure": "trip" if plant.trips_groups else "terminate",
    }
    if settings.plant is not None:
        if not isinstance(settings.plant, Mapping):
            raise ValueError("results say which plant was played: plant must be a dictionary of what to replace")
        shared["replaced"] = dict(settings.plant)
    if task is not V0:
        sensors = settings.sensor_distribution
        shared["version"] = task.version
        shared["plant"] = dict(settings.resolved_suite.plant_data)
        shared["sensors"] = "exact" if sensors is None else dataclasses.asdict(sensors)
        shared["duty_time_s"] = task.duty_time_s
    # Lists, as files hold them, not tuples.
    try:
        data: dict[str, Any] = json.loads(json.dumps(shared))
    except TypeError as error:
        raise ValueError(f"results hold what was played: in plant, give numbers and texts ({error})") from error
    return data


def _episodes(
    store: PartialStore,
    parts: Sequence[Part],
    settings: EnvSettings,
    n_threads: int | None,
    workers: Workers | None,
    on_progress: Progress | None,
    needed: Collection[str],
) -> tuple[list[Episode], dict[tuple[str, int | None], str]]:
    """Return the episodes in the order of the parts, and how entries failed, by name and training seed.

    Stored parts are read, the others are played and stored. The failure of an entry that is needed is raised.
    """
    episodes: dict[int, list[Episode]] = {}
    failures: dict[tuple[str, int | None], str] = {}
    n_done, n_all, suite_hash = 0, sum(len(seeds) for _, seeds in parts), settings.resolved_suite.hash

    def take(index: int, played: Played) -> None:
        nonlocal n_done
        entry, seeds = parts[index]
        if not isinstance(played, PolicyError):
            episodes[index] = played
        elif entry.name in needed:
            raise played
        else:
            failures.setdefault((entry.name, entry.training_seed), str(played))
        n_done += len(seeds)
        if on_progress is not None:
            on_progress(entry.name, n_done, n_all)

    remaining: dict[int, Part] = {}
    for index, part in enumerate(parts):
        if (stored := store.load(*part)) is None:
            remaining[index] = part
        else:
            take(index, stored)
    if workers is None or not remaining:
        playing = _played_here(remaining, settings, n_threads)
    else:
        playing = workers.play(play_batch, settings, remaining)
    with contextlib.closing(playing) as batches:
        for index, played in batches:
            if get_suite(settings.suite_name).hash != suite_hash:
                raise ValueError(f"suite {settings.suite_name} was written anew while it was played: evaluate again")
            if not isinstance(played, PolicyError):
                store.save(*parts[index], played)
            take(index, played)
    return [episode for index in sorted(episodes) for episode in episodes[index]], failures


def _played_here(parts: Mapping[int, Part], settings: EnvSettings, n_threads: int | None) -> Playing:
    failures: dict[str, PolicyError] = {}
    playing: list[OnnxPolicy] = []

    def played(index: int, n_threads: int | None) -> tuple[int, Played]:
        entry, seeds = parts[index]
        if isinstance(entry.policy, OnnxPolicy):
            # A process of its own for every part, also of one entry.
            policy = copy.copy(entry.policy)
            entry = dataclasses.replace(entry, policy=policy)
            playing.append(policy)
        rows = failures.get(entry.name) or play_batch(entry, settings, seeds, n_threads)
        if isinstance(rows, PolicyError):
            # Its row is left out, so its other training seeds need not be played.
            failures[entry.name] = rows
        return index, rows

    # Laws share all threads by themselves, and a policy in Python is called by one thread only.
    apart = [index for index, (entry, _) in parts.items() if isinstance(entry.policy, OnnxPolicy)]
    for index in sorted(parts.keys() - set(apart)):
        yield played(index, n_threads)
    pool, futures = ThreadPoolExecutor(n_threads or os.cpu_count()), []
    try:
        with HeldSignals():
            futures += [pool.submit(played, index, 1) for index in apart]
        for future in futures:
            yield future.result()
    finally:
        with HeldSignals():
            pool.shutdown(wait=False, cancel_futures=True)
            # A thread between two answers of its policy starts that one's process again.
            while wait(futures, _CLOSE_AGAIN_S).not_done:
                for policy in playing:
                    policy.close()


def play_batch(
    entry: Entry, settings: EnvSettings, scenarios: Sequence[int] | Sequence[Scenario], n_threads: int | None
) -> Played:
    """Play and measure one batch of scenarios, or of seeds of the settings' suite, from start to end."""
    try:
        with started_batch(entry, settings, scenarios, n_threads) as (played, drawn):
            courses_hz = frequencies(played, play(entry, played))
            return [
                Episode(
                    entry=entry.name,
                    training_seed=entry.training_seed,
                    seed=int(played.scenario_seeds[env]),
                    scenario=scenario.name,
                    duration_s=min(scenario.duration_s, played.duration_s),
                    **measure(played, env, course_hz),
                )
                for env, (scenario, course_hz) in enumerate(zip(drawn, courses_hz, strict=True))
            ]
    except policy_process.NotIsolatedError:
        raise
    except PolicyError as error:
        return error


class Comparison(NamedTuple):
    """The findings of :func:`compare`: what differs, each with where, the stored value and the value now."""

    #: Numbers, policies, suite and settings; empty where the results are reproduced.
    differences: list[tuple[str, str, str]]
    #: Source code, versions, the environment's answers and texts about entries; they need not change a number.
    circumstances: list[tuple[str, str, str]]


def recompute(stored: Results, entries: Sequence[Entry], **options: Any) -> Comparison:
    """Evaluate the entries of stored results again, on the same scenarios with the same settings, and compare.

    A ValueError names an entry that is missing; others than those of the results are ignored.
    """
    by_run = {(entry.name, entry.training_seed): entry for entry in entries}
    expected = [(entry["name"], entry["training_seed"]) for entry in (*stored.entries, *stored.failed)]
    missing = [name for name, seed in expected if (name, seed) not in by_run and name not in stored.task.references]
    if missing:
        raise ValueError(f"the results hold entries that were not given: {', '.join(dict.fromkeys(missing))}")
    settings = {_ARGUMENTS[name]: value for name, value in stored.settings.items() if name in _ARGUMENTS}
    chosen = [by_run[run] for run in expected if run in by_run]
    place: dict[str, Any] = {"suite": stored.suite, "split": stored.split, "seeds": stored.seeds}
    return compare(stored, evaluate(chosen, **place, keep_going=True, **settings, **options))


def compare(stored: Results, now: Results) -> Comparison:
    """Compare two results on the same scenarios, to the last bit."""
    comparison = Comparison([], [])
    first, other = _facts(stored), _facts(now)
    for where in {**first, **other}:
        # Where one side alone has an entry's episodes, that it was not played to the end is the difference.
        if first.get(where) != other.get(where) and not (where[-1] in COLUMNS and (where in first) != (where in other)):
            differences = comparison.circumstances if _CIRCUMSTANCES & {*where} else comparison.differences
            differences.append((": ".join(where), str(first.get(where)), str(other.get(where))))
    return comparison


def _facts(results: Results) -> dict[tuple[str, ...], Any]:
    """Return what results say of themselves, of their entries and of every episode, by where it stands."""
    facts: dict[tuple[str, ...], Any] = {(key,): getattr(results, key) for key in ("suite_hash", "source_hash")}
    for part in ("settings", "environment", "versions"):
        facts |= {(part, key): value for key, value in getattr(results, part).items()}
    for entry in (*results.entries, *results.failed):
        label = f"entry {run_label(entry['name'], entry['training_seed'])}"
        # The texts about a reference depend on whether it was asked for.
        left_out = _CIRCUMSTANCES if entry["name"] in results.task.references else ()
        facts |= {(label, key): value for key, value in entry.items() if key not in left_out}
        facts[label, "played to the end"] = "reason" not in entry
    for episode in results.episodes:
        label = f"{run_label(*episode.run)}, seed {episode.seed}"
        facts |= {(label, column): cell for column, cell in zip(COLUMNS, episode.cells(), strict=True)}
    return facts


def departures(stored: Results) -> list[str]:
    """Return how results depart from the benchmark's own: other settings, or not as many scenarios."""
    usual = shared_settings(EnvSettings(suite=stored.suite, split=stored.split))
    differences = [
        f"{key} is {stored.settings.get(key)}, that of the benchmark {usual.get(key)}"
        for key in {**usual, **stored.settings}
        if stored.settings.get(key) != usual.get(key)
    ]
    n_all = len(get_suite(stored.suite).seeds(stored.split))
    if len(stored.seeds) != n_all:
        differences.append(f"{len(stored.seeds)} scenarios, those of the benchmark are {n_all}")
    return differences
