"""Playing entries through the scenarios of a suite, many at a time."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import os
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym import ENV_ID
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task import COEFFICIENT_AUTHORITY, TIME_CONSTANT_RATIO
from wtg_gym.evaluation.circumstances import versions
from wtg_gym.evaluation.entries import ANCHORS, Entry
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.fingerprint import environment_fingerprint
from wtg_gym.evaluation.metrics import Recorder, measure
from wtg_gym.evaluation.onnx_policy import OnnxPolicy
from wtg_gym.evaluation.parcels import Played
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.evaluation.policy_process import NotIsolatedError, PolicyError
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.workers import Workers
from wtg_gym.physics.compiled import source_hash
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import VERIFICATION, VerificationDraw, get_suite

Progress = Callable[[str, int, int], None]
#: What is played at once: an entry, and seeds of scenarios.
_Part = tuple[Entry, list[int]]
#: Settings that an entry or an argument of its own decides.
_TAKEN = ("strategy", "action_mode", "observation_mode", "suite", "split", "scenario", "duration_s")
#: More scenarios than this must be asked for by their seeds.
_LARGEST_SPLIT = 100_000


def evaluate(
    entries: Sequence[Entry],
    suite: str,
    split: str = "test",
    *,
    seeds: Sequence[int] | None = None,
    draw: VerificationDraw | None = None,
    duration_s: float | None = None,
    batch: int = 256,
    n_threads: int | None = None,
    on_progress: Progress | None = None,
    partial: str | Path | None = None,
    workers: Workers | None = None,
    keep_partial: bool = False,
    keep_going: bool = False,
    **env_arguments: Any,
) -> Results:
    """Play every entry, and the two anchors of the score, through the scenarios of a suite.

    The numbers of a law and of an :class:`OnnxPolicy` depend neither on `batch` nor on `n_threads`, to the last bit.
    Any other policy is called once per control step for a whole batch; its own rounding may depend on the batch's size.
    Batches are the same whoever plays them, and so are the numbers, with any `workers`.

    Args:
        entries: competitors; names (with training seeds) must be unique.
        suite: name of the suite.
        split: "train", "validation", "test" or "verification".
        seeds: some of the split's seeds; None for all.
        draw: the seeds of the split "verification".
        duration_s: length of the episodes [s]; None for the suite's own.
        batch: scenarios that run side by side.
        n_threads: threads to step with, and ONNX policies that play side by side; None for one per processor. Workers
            have one each.
        on_progress: called with (name of the entry, episodes done, episodes in all) after every batch.
        partial: folder for finished batches: a run that was killed goes on from them; in the end they are removed, the
            folder stays.
        workers: other processes that play the batches; None plays them here, one after the other.
        keep_partial: leave finished batches in that folder, for a run with more entries.
        keep_going: leave out an entry whose policy fails, with all training seeds of its name, and say so in
            :attr:`Results.failed`; the others' results are what they are without it. False raises the failure.
        env_arguments: further settings of the environment, see :class:`wtg_gym.envs.settings.EnvSettings`.

    Raises:
        PolicyError: a policy raises, ends, takes too long or returns no action; a ValueError that names entry and step.
        ValueError: an argument is unknown or out of range, or the workers cannot be used; the message names them.
    """
    competitors = _with_anchors(entries)
    _check_arguments(batch, partial, env_arguments)
    if workers is not None and n_threads not in (None, 1):
        raise ValueError(f"a worker steps with one thread; leave out the threads, got {n_threads!r}")
    settings = EnvSettings(suite=suite, split=split, duration_s=duration_s, **env_arguments)
    chosen = _seeds(suite, split, seeds, draw)
    shared, suite_hash = shared_settings(settings), get_suite(suite).hash
    store = PartialStore(None if partial is None else Path(partial), [suite, suite_hash, split, shared])
    parts = [(entry, chosen[first : first + batch]) for entry in competitors for first in range(0, len(chosen), batch)]
    played: dict[int, list[Episode]] = {}
    failures: dict[tuple[str, int | None], PolicyError] = {}
    n_done = 0
    with contextlib.closing(_stored_and_played(store, parts, settings, n_threads, workers)) as batches:
        for index, rows in batches:
            entry, own = parts[index]
            if isinstance(rows, PolicyError):
                if not keep_going:
                    raise rows
                failures.setdefault((entry.name, entry.training_seed), rows)
            else:
                played[index] = rows
            n_done += len(own)
            if on_progress is not None:
                on_progress(entry.name, n_done, len(competitors) * len(chosen))
    results = Results(
        suite=suite,
        split=split,
        suite_hash=suite_hash,
        source_hash=source_hash(),
        seeds=tuple(chosen),
        draw=None if draw is None else {"commit": draw.commit, "secret_sha256": draw.secret_sha256},
        environment={"id": ENV_ID, "fingerprint": environment_fingerprint(settings)},
        settings=shared,
        versions=versions(),
        entries=tuple(entry.to_dict() for entry in competitors),
        episodes=tuple(episode for index in range(len(parts)) for episode in played.get(index, ())),
    ).without({key: str(error) for key, error in failures.items()})
    if not keep_partial:
        store.clear()
    return results


def _check_arguments(batch: int, partial: str | Path | None, env_arguments: dict[str, Any]) -> None:
    known = [field.name for field in dataclasses.fields(EnvSettings) if field.name not in _TAKEN]
    unknown = sorted(set(env_arguments) - set(known))
    if unknown:
        raise ValueError(
            f"unknown environment settings {unknown}; allowed here: {', '.join(known)} "
            f"({', '.join(_TAKEN)} are set by the entry or by an argument of its own, a scenario by its seed)"
        )
    if isinstance(batch, bool) or not isinstance(batch, int) or not 1 <= batch <= 100_000:
        raise ValueError(f"batch must be 1 … 100000 scenarios, got {batch!r}")
    if partial is not None and Path(partial).exists() and not Path(partial).is_dir():
        raise ValueError(f"partial must be a folder for finished batches, got the file {partial}")


def check_entries(entries: Sequence[Entry]) -> None:
    """Raise a ValueError if entries cannot stand in one table: names, training seeds and rows must fit."""
    if isinstance(entries, (str, Entry)) or not all(isinstance(entry, Entry) for entry in entries):
        raise ValueError(f"entries must be a list of Entry, see load_entries(), got {entries!r}")
    names = [(entry.name, entry.training_seed) for entry in entries]
    doubled = sorted({name for name, seed in names if names.count((name, seed)) > 1})
    if doubled:
        raise ValueError(f"entries must have different names or training seeds; given more than once: {doubled}")
    rows: dict[str, Entry] = {}
    for entry in entries:
        first = rows.setdefault(entry.name, entry)
        if first is not entry:
            _check_row(first, entry)
        if entry.name in ANCHORS and (entry.policy is not None or entry.law != STRATEGIES[entry.name]):
            raise ValueError(f"the name {entry.name!r} is reserved for the strategy itself, which fixes the score")


def _check_row(first: Entry, other: Entry) -> None:
    """Entries of one name are one method, trained with several seeds: nobody joins another's row."""
    if None in (first.training_seed, other.training_seed):
        seeds = [first.training_seed, other.training_seed]
        raise ValueError(f"entries named {first.name!r} must all have a training seed, got {seeds}")
    one, two = first.to_dict(), other.to_dict()
    for key in ("kind", "strategy", "action_mode", "observation_mode", "source"):
        if one[key] != two[key]:
            raise ValueError(
                f"entries named {first.name!r} share a row and must agree on {key}, got {one[key]!r} and {two[key]!r}"
            )


def _with_anchors(entries: Sequence[Entry]) -> list[Entry]:
    """The entries with the anchors that are not among them, anchors of one's own making refused."""
    check_entries(entries)
    missing = [name for name in ANCHORS if name not in {entry.name for entry in entries}]
    return [*entries, *(Entry(name=name, strategy=name, description="Anchor of the score.") for name in missing)]


def _seeds(suite: str, split: str, seeds: Sequence[int] | None, draw: VerificationDraw | None) -> list[int]:
    if (split == VERIFICATION) != (draw is not None):
        raise ValueError(
            f"the split {VERIFICATION!r}, and no other, is played on the seeds of a draw, see draw_seeds(); got the "
            f"split {split!r} and {'no draw' if draw is None else 'a draw'}"
        )
    if draw is not None:
        if seeds is not None or draw.suite != suite:
            raise ValueError(
                f"a draw gives all seeds, of its own suite {draw.suite!r}; got the suite {suite!r}"
                f"{'' if seeds is None else ' and other seeds'}"
            )
        return list(draw.seeds)
    allowed = get_suite(suite).seeds(split)
    text = f"the {split} seeds of suite {suite!r} are {allowed.start} … {allowed.stop - 1}"
    if seeds is None:
        if len(allowed) > _LARGEST_SPLIT:
            raise ValueError(f"{text}: too many to play them all; choose some with seeds=")
        return list(allowed)
    wrong = [s for s in seeds if isinstance(s, bool) or not isinstance(s, (int, np.integer)) or s not in allowed]
    if wrong:
        raise ValueError(f"{text}; got {', '.join(map(repr, wrong[:5]))}{' …' if len(wrong) > 5 else ''}")
    if len(seeds) == 0:
        raise ValueError(f"no seeds were given; {text}")
    if twice := [seed for seed, times in Counter(seeds).items() if times > 1]:
        raise ValueError(f"every seed may be given once; given more often: {', '.join(map(str, twice[:5]))}")
    return [int(seed) for seed in seeds]


def shared_settings(settings: EnvSettings) -> dict[str, Any]:
    """Return what is the same for all entries, defaults filled in, as JSON-ready data."""
    return {
        "duration_s": settings.episode_duration_s(),
        "control_dt": float(settings.control_dt),
        "simulation_dt": float(settings.simulation_dt),
        "weights": {key: float(value) for key, value in dataclasses.asdict(settings.cost_weights()).items()},
        "groups": [{"bus": int(group.bus), "n_turbines": float(group.n_turbines)} for group in settings.wtg_groups()],
        "authority": {"k": COEFFICIENT_AUTHORITY, "tau": TIME_CONSTANT_RATIO},
        "machine_model": settings.machine_model,
        "on_failure": settings.on_failure,
    }


def _stored_and_played(
    store: PartialStore,
    parts: Sequence[_Part],
    settings: EnvSettings,
    n_threads: int | None,
    workers: Workers | None,
) -> Generator[tuple[int, Played], None, None]:
    """Yield (index, episodes) of every batch: what is stored, then what has to be played, stored as it comes."""
    paths = [store.path(entry.to_dict(), seeds) for entry, seeds in parts]
    missing = []
    for index, (_, seeds) in enumerate(parts):
        rows = store.load(paths[index], len(seeds))
        if rows is None:
            missing.append(index)
        else:
            yield index, rows
    with contextlib.closing(_played([parts[index] for index in missing], settings, n_threads, workers)) as batches:
        for number, played in batches:
            if not isinstance(played, PolicyError):
                store.save(paths[missing[number]], played)
            yield missing[number], played


def _played(
    parts: Sequence[_Part], settings: EnvSettings, n_threads: int | None, workers: Workers | None
) -> Generator[tuple[int, Played], None, None]:
    if workers is not None and parts:
        yield from workers.play(_play, settings, parts)
        return
    failures: dict[str, PolicyError] = {}
    playing: list[OnnxPolicy] = []

    def played(index: int, n_threads: int | None) -> tuple[int, Played]:
        entry, seeds = parts[index]
        if isinstance(entry.policy, OnnxPolicy):
            # A process of its own for every part, also of one entry.
            policy = copy.copy(entry.policy)
            entry = dataclasses.replace(entry, policy=policy)
            playing.append(policy)
        rows = failures.get(entry.name) or _play(entry, settings, seeds, n_threads)
        if isinstance(rows, PolicyError):
            # The row is left out whatever its other training seeds do, so nobody waits for them.
            failures[entry.name] = rows
        return index, rows

    # Laws share all threads by themselves, and a policy in Python is called by one thread only.
    apart = [index for index, (entry, _) in enumerate(parts) if isinstance(entry.policy, OnnxPolicy)]
    for index in sorted(set(range(len(parts))) - set(apart)):
        yield played(index, n_threads)
    pool = ThreadPoolExecutor(n_threads or os.cpu_count())
    try:
        for future in [pool.submit(played, index, 1) for index in apart]:
            yield future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for policy in playing:
            policy.close()
        pool.shutdown()


def _play(entry: Entry, settings: EnvSettings, seeds: Sequence[int], n_threads: int | None) -> Played:
    """Play one batch from start to end."""
    lanes = entry_lanes(entry, settings, len(seeds), n_threads)
    try:
        scenarios = lanes.scenarios(seeds)
        _start(lanes, scenarios, entry)
        recorder = Recorder(lanes, _n_steps(lanes))
        for stepped in play(entry, lanes):
            recorder.record(stepped)
        return [_episode(entry, lanes, recorder, lane, scenario) for lane, scenario in enumerate(scenarios)]
    except NotIsolatedError:
        raise
    except PolicyError as error:
        return error
    finally:
        lanes.simulator.close()


def entry_lanes(entry: Entry, settings: EnvSettings, n_lanes: int, n_threads: int | None = None) -> TaskLanes:
    """Return lanes with an entry's own law and modes, everything else as in `settings`."""
    # A law is no JSON, which is why the settings' own type is narrower than what they take.
    law: Any = entry.law
    own = dataclasses.replace(
        settings, strategy=law, action_mode=entry.action_mode, observation_mode=entry.observation_mode
    )
    return TaskLanes(own, n_lanes, n_threads)


def play(entry: Entry, lanes: TaskLanes) -> Iterator[npt.NDArray[np.bool_]]:
    """Play the started episodes of all lanes to their ends; after every step, yield which lanes made it, (n_lanes,).

    The process of an :class:`OnnxPolicy` is a new one, and ends with the episodes.

    Raises:
        PolicyError: the policy raises, ends, takes too long or returns no action.
    """
    actions = _Actions(entry, lanes)
    running = np.ones(lanes.n_lanes, dtype=np.bool_)
    playing: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
    if isinstance(entry.policy, OnnxPolicy):
        playing = entry.policy
    with playing:
        while running.any():
            lanes.step(actions.next(running))
            yield running
            terminated, truncated = lanes.ended()
            running = ~(terminated | truncated)


def _start(lanes: TaskLanes, scenarios: Sequence[Scenario], entry: Entry) -> None:
    try:
        lanes.start(range(len(scenarios)), scenarios)
    except ValueError as error:
        raise ValueError(f"entry {entry.label!r}: {error}") from error


def _n_steps(lanes: TaskLanes) -> int:
    return int(lanes.task_values("end_step").max()) // lanes.simulator.plant.n_substeps


def _episode(entry: Entry, lanes: TaskLanes, recorder: Recorder, lane: int, scenario: Scenario) -> Episode:
    metrics, failure = measure(lanes, recorder, lane, scenario)
    return Episode(
        entry=entry.name,
        training_seed=entry.training_seed,
        seed=int(lanes.scenario_seeds[lane]),
        scenario=scenario.name,
        duration_s=min(scenario.duration_s, lanes.duration_s),
        failure=failure,
        metrics=metrics,
    )


class _Actions:
    """Asks a policy for the actions of a batch, step by step, with its recurrent state."""

    def __init__(self, entry: Entry, lanes: TaskLanes) -> None:
        self._entry = entry
        self._lanes = lanes
        self._state: Any = None
        self._step = 0
        self._shape = (lanes.n_lanes, lanes.n_action)

    def next(self, running: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        """Return the actions (n_lanes, n_action) of the next step; zero for lanes that are over, (n_lanes,) bool."""
        policy = self._entry.policy
        if policy is None:
            return np.zeros(self._shape)
        start = np.full(self._shape[0], self._step == 0)
        try:
            answer = policy.predict(
                self._lanes.observations.copy(), state=self._state, episode_start=start, deterministic=True
            )
        except NotIsolatedError:
            raise
        except (Exception, SystemExit) as error:
            said = str(error) if isinstance(error, PolicyError) else f"predict() raised {_described(error)}"
            raise PolicyError(f"entry {self._entry.label!r}, step {self._step}: {said}") from error
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise self._complaint("predict() must return (actions, state)", type(answer).__name__)
        actions = self._checked(answer[0], running)
        self._state = answer[1]
        self._step += 1
        return actions

    def _checked(self, given: Any, running: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        try:
            raw = np.asarray(given)
        # A tensor with gradients raises a RuntimeError, other libraries' arrays what they like.
        except Exception as error:
            raise self._complaint("actions must be an array of numbers", _described(error)) from error
        if raw.dtype.kind not in "biuf":
            raise self._complaint("actions must be an array of numbers", f"one of {raw.dtype}")
        actions = raw.astype(np.float64)
        if actions.shape != self._shape:
            raise self._complaint(f"actions must have shape {self._shape} (lanes, values)", f"shape {actions.shape}")
        # What a policy answers to an episode that is over has no effect.
        actions[~running] = 0.0
        if not np.isfinite(actions).all():
            lane = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            seed = self._lanes.scenario_seeds[lane]
            wanted = f"actions of shape {actions.shape} must be finite, -1 … 1"
            raise self._complaint(wanted, f"{actions[lane].tolist()} in the scenario of seed {seed}")
        return actions

    def _complaint(self, wanted: str, got: str) -> PolicyError:
        return PolicyError(f"entry {self._entry.label!r}, step {self._step}: {wanted}, got {got}")


def _described(error: BaseException) -> str:
    """Return an exception on one line, with the place in the code that raised it."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    said = "".join(sign if sign.isprintable() else "?" for sign in " ".join(str(error).split())[:200])
    return f"{type(error).__name__}: {said} ({Path(place.filename).name}:{place.lineno})"


__all__ = ["check_entries", "entry_lanes", "evaluate", "play", "shared_settings"]
