"""Results computed again and compared, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.episodes import COLUMNS
from wtg_gym.evaluation.evaluator import evaluate, shared_settings
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.workers import Workers
from wtg_gym.policies import Entry
from wtg_gym.policies.entry import run_label
from wtg_gym.scenarios import get_suite

#: The settings of results that are arguments of the environment.
_ARGUMENTS = ("duration_s", "control_dt", "weights", "groups", "on_failure", "sensors", "replaced")
#: What need not change a number: the words of a failure, for example, may depend on the machine.
_CIRCUMSTANCES = {"source_hash", "environment", "versions", "description", "source", "reason"}


class Difference(NamedTuple):
    """One difference: where, the stored value, and the value now."""

    where: str
    stored: str
    now: str


class Comparison(NamedTuple):
    """The findings of :func:`compare`."""

    #: Numbers, policies, suite and settings that differ; empty where the results are reproduced.
    differences: list[Difference]
    #: Source code, versions, the environment's answers and texts about entries that differ; they need not change a
    #: number.
    circumstances: list[Difference]


def recompute(
    stored: Results,
    entries: Sequence[Entry],
    *,
    n_threads: int | None = None,
    workers: Workers | None = None,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Comparison:
    """Evaluate the entries of stored results again, on the same scenarios with the same settings, and compare.

    Entries that the results do not hold are ignored; a ValueError names one that is missing. The other arguments are
    those of :func:`wtg_gym.evaluation.evaluate`.
    """
    by_run = {(entry.name, entry.training_seed): entry for entry in entries}
    wanted = [(entry["name"], entry["training_seed"]) for entry in (*stored.entries, *stored.failed)]
    missing = [name for name, seed in wanted if (name, seed) not in by_run and name not in stored.task.references]
    if missing:
        raise ValueError(f"the results hold entries that were not given: {', '.join(dict.fromkeys(missing))}")
    now = evaluate(
        [by_run[run] for run in wanted if run in by_run],
        stored.suite,
        stored.split,
        seeds=stored.seeds,
        n_threads=n_threads,
        workers=workers,
        on_progress=on_progress,
        keep_going=True,
        **{
            "plant" if name == "replaced" else name: value
            for name, value in stored.settings.items()
            if name in _ARGUMENTS
        },
    )
    return compare(stored, now)


def compare(stored: Results, now: Results) -> Comparison:
    """Compare two results on the same scenarios, to the last bit."""
    comparison = Comparison([], [])
    one, other = _facts(stored), _facts(now)
    # Where one side alone has an entry's episodes, that it was not played to the end is the difference.
    cells, others = _cells(stored), _cells(now)
    one |= {where: cells[where] for where in cells if where in others}
    other |= {where: others[where] for where in others if where in cells}
    for where in {**one, **other}:
        if one.get(where) != other.get(where):
            differences = comparison.circumstances if _CIRCUMSTANCES & {*where} else comparison.differences
            differences.append(Difference(": ".join(where), str(one.get(where)), str(other.get(where))))
    return comparison


def _facts(results: Results) -> dict[tuple[str, ...], Any]:
    """Return what results say of themselves and of their entries, by where it stands."""
    facts: dict[tuple[str, ...], Any] = {(key,): getattr(results, key) for key in ("suite_hash", "source_hash")}
    for part in ("settings", "environment", "versions"):
        facts |= {(part, key): value for key, value in getattr(results, part).items()}
    for entry in (*results.entries, *results.failed):
        label = f"entry {run_label(entry['name'], entry['training_seed'])}"
        # The texts about a reference depend on whether it was asked for.
        left_out = _CIRCUMSTANCES if entry["name"] in results.task.references else ()
        facts |= {(label, key): value for key, value in entry.items() if key not in left_out}
        facts[label, "played to the end"] = "reason" not in entry
    return facts


def _cells(results: Results) -> dict[tuple[str, ...], str]:
    """Return every value of every episode, by where it stands."""
    return {
        (f"{run_label(*episode.run)}, seed {episode.seed}", column): cell
        for episode in results.episodes
        for column, cell in zip(COLUMNS, episode.cells(), strict=True)
    }


def departures(stored: Results) -> list[str]:
    """Return how results depart from the benchmark's own: other settings, or not as many scenarios."""
    usual = shared_settings(EnvSettings(suite=stored.suite, split=stored.split))
    departures = [
        f"{key} is {stored.settings.get(key)}, that of the benchmark {usual.get(key)}"
        for key in {**usual, **stored.settings}
        if stored.settings.get(key) != usual.get(key)
    ]
    n_all = len(get_suite(stored.suite).seeds(stored.split))
    if len(stored.seeds) != n_all:
        departures.append(f"{len(stored.seeds)} scenarios, those of the benchmark are {n_all}")
    return departures
