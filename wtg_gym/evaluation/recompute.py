"""Results computed again and compared, to the last bit."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.episodes import COLUMNS
from wtg_gym.evaluation.evaluator import evaluate, shared_settings
from wtg_gym.evaluation.results import Results
from wtg_gym.policies import Entry
from wtg_gym.policies.entry import run_label
from wtg_gym.scenarios import get_suite

#: The settings of results that are arguments of the environment, and what these are called.
_ARGUMENTS = {name: name for name in ("duration_s", "control_dt", "weights", "groups", "on_failure", "sensors")}
_ARGUMENTS["replaced"] = "plant"
#: What need not change a number: the words of a failure, for example, may depend on the machine.
_CIRCUMSTANCES = {"source_hash", "environment", "versions", "description", "source", "reason"}


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
