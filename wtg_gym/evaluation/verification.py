"""Results computed anew: identical, or what differs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.entries import ANCHORS, Entry
from wtg_gym.evaluation.episodes import COLUMNS
from wtg_gym.evaluation.evaluator import evaluate, shared_settings
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.workers import Workers
from wtg_gym.scenarios import N_DRAWN, VerificationDraw, get_suite

#: The settings of results that are arguments of the environment, as they are called there.
_ARGUMENTS = ("control_dt", "simulation_dt", "weights", "groups", "machine_model", "on_failure")
#: What an entry's data say of what was played; all else in them are texts about it.
_PLAYED = ("kind", "strategy", "action_mode", "observation_mode", "sha256", "policy_sha256")


class Difference(NamedTuple):
    """Something that came out otherwise: where, as it is stored, and as it is now."""

    where: str
    stored: str
    now: str


class Verification(NamedTuple):
    """What :func:`verify` found.

    Args:
        differences: numbers, policies, seeds, suite and settings that differ; empty where the results are reproduced.
        circumstances: source code, versions, the environment's answers and texts about entries that differ; they need
            not change a number.
        n_numbers: how many numbers were compared.
    """

    differences: list[Difference]
    circumstances: list[Difference]
    n_numbers: int


def verify(
    stored: Results,
    entries: Sequence[Entry],
    *,
    secret: bytes | None = None,
    n_threads: int | None = None,
    workers: Workers | None = None,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Verification:
    """Evaluate the entries of stored results again, on the same scenarios with the same settings, and compare.

    Args:
        stored: the results.
        entries: all of their entries, but for the anchors; further ones are left out.
        secret: what the seeds of the split "verification" were drawn with; None does not check them.
        n_threads, workers, on_progress: as for :func:`wtg_gym.evaluation.evaluate`.

    Raises:
        ValueError: an entry is missing, a secret is too short or given for seeds that were not drawn, or the results
            are of a suite, seeds or settings that there are no more.
    """
    draw = None if stored.draw is None else VerificationDraw(suite=stored.suite, seeds=stored.seeds, **stored.draw)
    differences = _seeds_compared(stored, draw, secret)
    given = {(entry.name, entry.training_seed): entry for entry in entries}
    wanted = [(entry["name"], entry["training_seed"]) for entry in (*stored.entries, *stored.failed)]
    missing = [name for name, seed in wanted if (name, seed) not in given and name not in ANCHORS]
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
    for key in sorted({*stored.settings, *now.settings}):
        differences += _compared(f"settings.{key}", stored.settings.get(key), now.settings.get(key))
    texts: list[Difference] = []
    described = {(entry["name"], entry["training_seed"]): entry for entry in (*now.entries, *now.failed)}
    for entry in (*stored.entries, *stored.failed):
        label = _label(entry["name"], entry["training_seed"])
        other = described[entry["name"], entry["training_seed"]]
        if ("reason" in entry) != ("reason" in other):
            differences.append(Difference(label, entry.get("reason", "played"), other.get("reason", "played")))
            continue
        # Why a policy failed is a text too: how it is said may depend on the machine.
        for key in sorted({*entry, *other}):
            (differences if key in _PLAYED else texts).extend(
                _compared(f"{label}: {key}", entry.get(key), other.get(key))
            )
    differences += _episodes_compared(stored, now)
    circumstances = _compared("source_hash", stored.source_hash, now.source_hash)
    for key in ("id", "fingerprint"):
        circumstances += _compared(f"environment.{key}", stored.environment[key], now.environment[key])
    for key in sorted({*stored.versions, *now.versions}):
        circumstances += _compared(key, stored.versions.get(key), now.versions.get(key))
    # Whoever is given as MPPT or the reference needs no citation.
    circumstances += [text for text in texts if text.where.partition(":")[0] not in ANCHORS]
    return Verification(differences, circumstances, len(stored.episodes) * len(COLUMNS))


def _episodes_compared(stored: Results, now: Results) -> list[Difference]:
    differences: list[Difference] = []
    played = {(*episode.run, episode.seed): episode for episode in now.episodes}
    for episode in stored.episodes:
        if (*episode.run, episode.seed) not in played:
            continue
        other_cells = played[*episode.run, episode.seed].cells()
        where = f"{_label(*episode.run)}, seed {episode.seed}"
        for column, one, other_cell in zip(COLUMNS, episode.cells(), other_cells, strict=True):
            differences += _compared(f"{where}: {column}", one, other_cell)
    return differences


def departures(stored: Results) -> list[str]:
    """Return in what results are not those of the benchmark: other settings, or not as many scenarios."""
    found = []
    settings = EnvSettings(suite=stored.suite, split=stored.split)
    for key, usual in shared_settings(settings).items():
        if stored.settings.get(key) != usual:
            found.append(f"{key} is {stored.settings.get(key)}, that of the benchmark {usual}")
    n_all = len(get_suite(stored.suite).seeds(stored.split)) if stored.draw is None else N_DRAWN
    if len(stored.seeds) != n_all:
        found.append(f"{len(stored.seeds)} scenarios, those of the benchmark are {n_all}")
    return found


def _seeds_compared(stored: Results, draw: VerificationDraw | None, secret: bytes | None) -> list[Difference]:
    if secret is None:
        return []
    if draw is None:
        raise ValueError(f"the seeds of the split {stored.split!r} were not drawn: there is no secret to check")
    if draw.is_of(secret):
        return []
    return [Difference("seeds", f"those of {draw.secret_sha256[:12]}", "others: not of this secret")]


def _label(name: str, training_seed: int | None) -> str:
    return name if training_seed is None else f"{name} (training seed {training_seed})"


def _compared(where: str, stored: object, now: object) -> list[Difference]:
    return [] if stored == now else [Difference(where, str(stored), str(now))]


__all__ = ["Difference", "Verification", "departures", "verify"]
