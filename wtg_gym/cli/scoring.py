"""Scoring on the command line: the values of options, one evaluation, and the printed ranking."""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wtg_gym.cli.options import SeedOptions, WorkerOptions
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, Results, evaluate, evaluator, load_entries, table, table_cells, workers
from wtg_gym.policies.entry import check_entries, run_label
from wtg_gym.progress import Progress
from wtg_gym.ranges import require_range
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.suite import MOST_SCENARIOS

#: Heads of columns that are too wide for a terminal of 120 columns.
_SHORT_HEADS = {"median deviation [mHz]": "Δf [mHz]", "lost or beyond 0.8 Hz [%]": "lost or > 0.8 Hz [%]"}


def chosen_entries(specs: Sequence[str], suite: str) -> list[Entry]:
    """Return the entries of `--entries` for a suite."""
    look_into_working_folder(specs)
    entries = load_entries(specs, get_suite(suite).task)
    # `evaluate` checks them too, but after the simulator was compiled.
    check_entries(entries)
    return entries


def look_into_working_folder(specs: Sequence[str]) -> None:
    """Let modules there be entries, as `python -m` does and a console script does not, where one is asked for.

    Otherwise a file there of the name of a package that is not installed would be run.
    """
    if any(":" in spec for spec in specs) and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def chosen_scenarios(suite: str, split: str, options: SeedOptions) -> dict[str, Any]:
    """Return the suite, the split and the seeds, as arguments of `evaluate`."""
    chosen = {"suite": suite, "split": split}
    if options.scenarios is None:
        return {**chosen, "seeds": options.seeds}
    if options.seeds is not None:
        raise ValueError("--scenarios takes the first of the split, --seeds others: give one of the two")
    seeds = get_suite(suite).seeds(split)
    require_range("--scenarios", options.scenarios, 1, min(len(seeds), MOST_SCENARIOS), "")
    return {**chosen, "seeds": list(seeds[: options.scenarios])}


def chosen_workers(options: WorkerOptions, threads: int | None = None) -> workers.Workers | None:
    """Return the workers of `--backend`, which `--threads` is not for."""
    if options.backend is None:
        if unused := [name for name in ("address", "jobs") if getattr(options, name) is not None]:
            raise ValueError(f"--{unused[0]} is for workers: say which with --backend {', '.join(workers.BACKENDS)}")
        return None
    if threads not in (None, 1):
        raise ValueError(f"--threads {threads}: a worker steps with one thread; say how many with --jobs")
    return workers.Workers(**vars(options))


def check_stored(folder: Path | None, planned: Mapping[str, Any]) -> None:
    """Refuse a folder whose results of the same suite and split are of other settings or seeds."""
    suite, split = planned["suite"], planned["split"]
    path = Path(folder or "") / f"{get_suite(suite).name}-{split}.json"
    if folder is None or not path.exists():
        return
    try:
        stored = Results.read(path)
    except ValueError as error:
        note(f"will be replaced: {error}")
        return
    settings = {key: value for key, value in planned.items() if key != "seeds"}
    now = {
        "suite_hash": get_suite(suite).hash,
        "settings": evaluator.shared_settings(EnvSettings(**settings)),
        "seeds": tuple(evaluator.chosen_seeds(suite, split, planned.get("seeds"))),
    }
    if other := [key for key, value in now.items() if getattr(stored, key) != value]:
        raise ValueError(
            f"--results {folder}: its {path.name} is of other {' and '.join(other)} and would be lost; "
            "give another folder"
        )


def run_evaluation(entries: Sequence[Entry], folder: Path | None, **options: Any) -> Results:
    """Evaluate with progress on stderr, and leave out an entry whose policy fails; `options` are those of `evaluate`.

    Finished parts are kept beside the results in a folder, if there is one; after Ctrl-C, it is named if it holds some.
    """
    partial = None if folder is None else folder / "partial"
    try:
        with Progress("episodes") as progress:
            return evaluate(entries, on_progress=progress.update, partial=partial, keep_going=True, **options)
    except KeyboardInterrupt:
        if partial is not None and any(partial.glob("*.json")):
            note(f"finished parts are kept in {partial}: run the same command again to go on")
        raise


def finish(results: Results, folder: Path | None, *, as_json: bool) -> int:
    """Write the results, print the ranking or the description as JSON; return 1 if an entry failed, else 0."""
    for entry in results.failed:
        note(f"failed, and left out: {run_label(entry['name'], entry['training_seed'])}: {entry['reason']}")
    code = int(bool(results.failed))
    if folder is not None:
        for path in results.write(folder):
            note(f"wrote {path}")
    if as_json:
        print_json(results.to_dict())
    else:
        print_ranking(results)
    return code


def print_ranking(results: Results) -> None:
    """Print the ranking, and what its columns and marks mean."""
    say(f"suite {results.suite} ({results.suite_hash[:12]}), {results.split}: {len(results.seeds)} scenarios", "")
    rows = results.ranking
    columns = table.columns_of("terminal", rows)
    heads = [_SHORT_HEADS.get(column, column) for column in columns]
    print_table(heads, table_cells(rows, columns), left=(1,))
    say(
        "", "in brackets: 95 % interval; Δf: largest deviation of a run's frequency, the median; lost: runs that failed"
    )
    if results.task.variates and not results.unadjusted:
        say(f"scores of {' and '.join(results.task.variates)} are their known means, by which others are adjusted")
    say(*table.notes_on_marks(rows))
    for text in filter(None, (results.no_score, results.unadjusted)):
        note(text)
