"""Results computed again and compared, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.episodes import COLUMNS
from wtg_gym.evaluation.evaluator import evaluate, shared_settings
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.workers import Workers
from wtg_gym.policies import Entry
from wtg_gym.scenarios import FreshDraw, get_suite

#: The settings of results that are arguments of the environment, as they are called there.
_ARGUMENTS = ("control_dt", "simulation_dt", "weights", "groups", "machine_model", "on_failure", "physics", "sensors")
#: Data of an entry that decide its numbers; the others are texts about it.
_PLAYED = ("kind", "strategy", "action_mode", "observation_mode", "sha256", "policy_sha256")


class Difference(NamedTuple):
    """One difference: where, the stored value, and the value now."""

    where: str
    stored: str
    now: str


class Recomputed(NamedTuple):
    """The findings of :func:`recompute`."""

    #: Numbers, policies, seeds, suite and settings that differ; empty where the results are reproduced.
    differences: list[Difference]
    #: Source code, versions, the environment's answers and texts about entries that differ; they need not change a
    #: number.
    circumstances: list[Difference]
    n_numbers: int  # how many numbers were compared


def recompute(
    stored: Results,
    entries: Sequence[Entry],
    *,
    secret: bytes | None = None,
    n_threads: int | None = None,
    workers: Workers | None = None,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Recomputed:
    """Evaluate the entries of stored results again, on the same scenarios with the same settings, and compare.

    Args:
        stored: the results.
        entries: all of their entries, without the anchors; others are ignored.
        secret: the one that the seeds of the split "fresh" were drawn with; None does not check them.
        n_threads, workers, on_progress: as for :func:`wtg_gym.evaluation.evaluate`.

    Raises:
        ValueError: an entry is missing, a secret is too short or given for seeds that were not drawn, or the results
            are of a suite, seeds or settings that no longer exist.
    """
    draw = None if stored.draw is None else FreshDraw(suite=stored.suite, seeds=stored.seeds, **stored.draw)
    if secret is not None and draw is None:
        raise ValueError(f"the seeds of the split {stored.split!r} were not drawn: there is no secret to check")
    differences = []
    if secret is not None and draw is not None and not draw.is_of(secret):
        differences = [Difference("seeds", f"those of {draw.secret_sha256[:12]}", "others: not of this secret")]
    given = {(entry.name, entry.training_seed): entry for entry in entries}
    wanted = {_key(entry): entry for entry in (*stored.entries, *stored.failed)}
    missing = [name for name, seed in wanted if (name, seed) not in given and name not in stored.benchmark.anchors]
    if missing:
        raise ValueError(f"the results hold entries that were not given: {', '.join(dict.fromkeys(missing))}")
    now = evaluate(
        [given[key] for key in wanted if key in given],
        stored.suite,
        stored.split,
        seeds=stored.seeds if draw is None else None,
        draw=draw,
        duration_s=stored.settings["duration_s"],
        n_threads=n_threads,
        workers=workers,
        on_progress=on_progress,
        keep_going=True,
        **{name: stored.settings[name] for name in _ARGUMENTS if name in stored.settings},
    )
    differences += _compared("suite_hash", stored.suite_hash, get_suite(stored.suite).hash)
    differences += _compared_each("settings.", stored.settings, now.settings)
    texts: list[Difference] = []
    described = {_key(entry): entry for entry in (*now.entries, *now.failed)}
    for key, entry in wanted.items():
        label, other = _label(*key), described[key]
        if ("reason" in entry) != ("reason" in other):
            differences.append(Difference(label, entry.get("reason", "played"), other.get("reason", "played")))
            continue
        # The reason of a failure is a text too: its words may depend on the machine.
        for name in sorted({*entry, *other}):
            found = _compared(f"{label}: {name}", entry.get(name), other.get(name))
            if name in _PLAYED:
                differences += found
            elif key[0] not in stored.benchmark.anchors:
                texts += found
    differences += _compared_episodes(stored, now)
    circumstances = _compared("source_hash", stored.source_hash, now.source_hash)
    circumstances += _compared_each("environment.", stored.environment, now.environment)
    circumstances += _compared_each("", stored.versions, now.versions)
    return Recomputed(differences, circumstances + texts, len(stored.episodes) * len(COLUMNS))


def departures(stored: Results) -> list[str]:
    """Return how results depart from the benchmark's own: other settings, or not as many scenarios."""
    found = []
    # Results of the paper's physics do not name it.
    own = {"physics": "paper", **stored.settings}
    usual = {"physics": "paper", **shared_settings(EnvSettings(suite=stored.suite, split=stored.split))}
    for key, value in usual.items():
        if own.get(key) != value:
            found.append(f"{key} is {own.get(key)}, that of the benchmark {value}")
    n_all = len(get_suite(stored.suite).seeds(stored.split if stored.draw is None else "test"))
    if len(stored.seeds) != n_all:
        found.append(f"{len(stored.seeds)} scenarios, those of the benchmark are {n_all}")
    return found


def _compared_episodes(stored: Results, now: Results) -> list[Difference]:
    differences: list[Difference] = []
    played = {(*episode.run, episode.seed): episode for episode in now.episodes}
    for episode in stored.episodes:
        other = played.get((*episode.run, episode.seed))
        # The episodes of an entry that fails now are missing, which is said already.
        if other is not None:
            where = f"{_label(*episode.run)}, seed {episode.seed}"
            for column, one, another in zip(COLUMNS, episode.cells(), other.cells(), strict=True):
                differences += _compared(f"{where}: {column}", one, another)
    return differences


def _compared_each(where: str, stored: Mapping[str, Any], now: Mapping[str, Any]) -> list[Difference]:
    keys = sorted({*stored, *now})
    return [found for key in keys for found in _compared(where + key, stored.get(key), now.get(key))]


def _compared(where: str, stored: object, now: object) -> list[Difference]:
    return [] if stored == now else [Difference(where, str(stored), str(now))]


def _key(entry: Mapping[str, Any]) -> tuple[str, int | None]:
    return entry["name"], entry["training_seed"]


def _label(name: str, training_seed: int | None) -> str:
    return name if training_seed is None else f"{name} (training seed {training_seed})"
