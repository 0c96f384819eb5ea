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
from wtg_gym.policies.entry import run_label
from wtg_gym.scenarios import get_suite

#: The settings of results that are arguments of the environment, as they are called there.
_ARGUMENTS = (
    *("duration_s", "control_dt", "simulation_dt", "weights", "groups"),
    *("machine_model", "on_failure", "physics", "sensors"),
)
#: Data of an entry that decide its numbers; the others are texts about it.
_PLAYED = ("action_mode", "kind", "observation_mode", "policy_sha256", "sha256", "strategy")


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
    n_threads: int | None = None,
    workers: Workers | None = None,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Recomputed:
    """Evaluate the entries of stored results again, on the same scenarios with the same settings, and compare.

    Args:
        stored: the results.
        entries: all of their entries, without the anchors; others are ignored.
        n_threads, workers, on_progress: as for :func:`wtg_gym.evaluation.evaluate`.

    Raises:
        ValueError: an entry is missing, or the results are of a suite, seeds or settings that no longer exist.
    """
    given = {(entry.name, entry.training_seed): entry for entry in entries}
    wanted = [(entry["name"], entry["training_seed"]) for entry in (*stored.entries, *stored.failed)]
    missing = [name for name, seed in wanted if (name, seed) not in given and name not in stored.benchmark.anchors]
    if missing:
        raise ValueError(f"the results hold entries that were not given: {', '.join(dict.fromkeys(missing))}")
    now = evaluate(
        [given[run] for run in wanted if run in given],
        stored.suite,
        stored.split,
        seeds=stored.seeds,
        n_threads=n_threads,
        workers=workers,
        on_progress=on_progress,
        keep_going=True,
        **{name: stored.settings[name] for name in _ARGUMENTS if name in stored.settings},
    )
    differences = _compared(_deciding(stored), _deciding(now))
    cells, others = _cells(stored), _cells(now)
    # Where one side alone has an entry's episodes, that is the difference.
    shared = [where for where in cells if where in others]
    differences += [Difference(where, cells[where], others[where]) for where in shared if cells[where] != others[where]]
    return Recomputed(differences, _compared(_circumstances(stored), _circumstances(now)), len(cells))


def departures(stored: Results) -> list[str]:
    """Return how results depart from the benchmark's own: other settings, or not as many scenarios."""
    found = []
    # Results of the paper's physics do not name it.
    own = {"physics": "paper", **stored.settings}
    usual = {"physics": "paper", **shared_settings(EnvSettings(suite=stored.suite, split=stored.split))}
    for key, value in usual.items():
        if own.get(key) != value:
            found.append(f"{key} is {own.get(key)}, that of the benchmark {value}")
    n_all = len(get_suite(stored.suite).seeds(stored.split))
    if len(stored.seeds) != n_all:
        found.append(f"{len(stored.seeds)} scenarios, those of the benchmark are {n_all}")
    return found


def _deciding(results: Results) -> dict[str, Any]:
    """Return what decides the numbers, by where it stands."""
    found = {"suite_hash": results.suite_hash, **{f"settings.{key}": value for key, value in results.settings.items()}}
    for label, entry in _by_label(results).items():
        found |= {f"{label}: {key}": entry[key] for key in _PLAYED}
        found[f"{label}: played to the end"] = "reason" not in entry
    return found


def _cells(results: Results) -> dict[str, str]:
    """Return every value of every episode, by where it stands."""
    return {
        f"{run_label(*episode.run)}, seed {episode.seed}: {column}": cell
        for episode in results.episodes
        for column, cell in zip(COLUMNS, episode.cells(), strict=True)
    }


def _circumstances(results: Results) -> dict[str, Any]:
    """Return what need not change a number, by where it stands: the words of a failure may depend on the machine."""
    found = {"source_hash": results.source_hash}
    found |= {f"environment.{key}": value for key, value in results.environment.items()} | dict(results.versions)
    for label, entry in _by_label(results).items():
        if entry["name"] not in results.benchmark.anchors:
            found |= {f"{label}: {key}": value for key, value in entry.items() if key not in _PLAYED}
    return found


def _compared(stored: Mapping[str, Any], now: Mapping[str, Any]) -> list[Difference]:
    pairs = ((where, stored.get(where), now.get(where)) for where in {**stored, **now})
    return [Difference(where, str(one), str(other)) for where, one, other in pairs if one != other]


def _by_label(results: Results) -> dict[str, Mapping[str, Any]]:
    return {run_label(each["name"], each["training_seed"]): each for each in (*results.entries, *results.failed)}
