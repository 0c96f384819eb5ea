"""Scoring on the command line: the values of options, one evaluation, and the printed ranking."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from wtg_gym.cli.options import SeedOptions, WorkerOptions
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.envs.compile_ahead import compile_ahead
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, Results, evaluate, load_entries, table_cells
from wtg_gym.evaluation.evaluator import chosen_seeds, shared_settings
from wtg_gym.evaluation.leaderboard import (
    LOST_OR_BEYOND,
    MEDIAN_DEVIATION,
    TERMINAL_COLUMNS,
    no_score_note,
    privileged_note,
    table_rows,
    text_columns,
)
from wtg_gym.evaluation.workers import BACKENDS, Workers
from wtg_gym.policies.entry import check_entries
from wtg_gym.progress import Progress
from wtg_gym.scenarios import FRESH, draw_seeds, get_suite

#: Heads of columns that are too wide for a terminal of 120 columns.
_SHORT_HEADS = {MEDIAN_DEVIATION: "Δf [mHz]", LOST_OR_BEYOND: "or > 0.8 Hz [%]"}
_LARGEST_SEED_RANGE = 100_000
_LARGEST_SECRET = 4096


# --- values of options: a ValueError says what is wrong with one -----------------------------------------------------


def chosen_entries(specs: Sequence[str], suite: str) -> list[Entry]:
    """Return the entries of `--entries` for a suite."""
    benchmark = get_suite(suite).benchmark
    # A console script, unlike `python -m`, does not look into the working folder: a checkout's packages are there.
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    entries = [entry for spec in specs for entry in load_entries(spec, benchmark)]
    # Stored ones among them are not evaluated, but stand in the same table.
    check_entries(entries)
    return entries


def chosen_scenarios(suite: str, split: str, given: SeedOptions) -> dict[str, Any]:
    """Return the suite, the split, and the seeds or the draw of fresh ones, as arguments of `evaluate`."""
    chosen = {"suite": suite, "split": split}
    options = {"--commit": given.commit, "--secret-file": given.secret_file}
    drawn = [option for option, value in options.items() if value is not None]
    if split != FRESH:
        if drawn:
            raise ValueError(f"{', '.join(drawn)}: for --split {FRESH} only, the split is {split}")
        if given.scenarios is not None:
            if given.seeds is not None:
                raise ValueError("--scenarios takes the first of the split, --seeds others: give one of the two")
            return {**chosen, "seeds": first_seeds(suite, split, given.scenarios)}
        return {**chosen, "seeds": None if given.seeds is None else _seeds(given.seeds)}
    if given.commit is None or given.secret_file is None or given.seeds is not None:
        missing = [option for option in options if option not in drawn]
        raise ValueError(
            f"--split {FRESH} draws its seeds from --commit and --secret-file, without --seeds; "
            f"missing: {', '.join(missing) or 'none'}"
        )
    return {**chosen, "draw": draw_seeds(suite, given.commit, read_secret(given.secret_file), given.scenarios)}


def first_seeds(suite: str, split: str, n: int, *, last: bool = False) -> list[int]:
    """Return the first n seeds of a split, or the last ones, as many as `--scenarios` says."""
    seeds = get_suite(suite).seeds(split)
    largest = min(len(seeds), _LARGEST_SEED_RANGE)
    if not 1 <= n <= largest:
        raise ValueError(f"--scenarios = {n} is outside the allowed range 1 … {largest} of the split {split}")
    return list(seeds[-n:] if last else seeds[:n])


def _seeds(texts: Sequence[str]) -> list[int]:
    seeds: list[int] = []
    for text in texts:
        if re.fullmatch(r"\d{1,12}(:\d{1,12})?", text) is None:
            raise ValueError(f"--seeds {text}: expected a seed such as 20003, or a range such as 20000:20010")
        first, _, stop = text.partition(":")
        part = range(int(first), int(stop) if stop else int(first) + 1)
        if not 0 < len(part) <= _LARGEST_SEED_RANGE:
            raise ValueError(f"--seeds {text}: {len(part)} seeds, a range must hold 1 … {_LARGEST_SEED_RANGE}")
        seeds += part
    return seeds


def read_secret(path: Path) -> bytes:
    """Return the secret of `--secret-file`, without blanks around it."""
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST_SECRET + 1)
    except OSError as error:
        raise ValueError(f"--secret-file {path}: {error.strerror}") from error
    if len(content) > _LARGEST_SECRET:
        raise ValueError(f"--secret-file {path}: larger than {_LARGEST_SECRET} bytes")
    return content.strip()


def chosen_workers(given: WorkerOptions, threads: int | None) -> Workers | None:
    """Return the workers of `--backend`."""
    if given.backend is not None:
        if threads not in (None, 1):
            raise ValueError(f"--threads {threads}: a worker steps with one thread; say how many with --jobs")
        return Workers(given.backend, given.address, given.jobs)
    for option in ("address", "jobs"):
        if getattr(given, option) is not None:
            raise ValueError(f"--{option} is for workers: say which with --backend {', '.join(BACKENDS)}")
    return None


def check_stored(folder: Path | None, planned: Mapping[str, Any]) -> None:
    """Refuse a folder whose results of the same suite and split are of other settings, seeds or another draw."""
    suite, split = planned["suite"], planned["split"]
    if folder is None or not (folder / f"{suite}-{split}.json").exists():
        return
    try:
        stored = Results.read(folder / f"{suite}-{split}.json")
    except ValueError as error:
        note(f"will be replaced: {error}")
        return
    seeds, draw = planned.get("seeds"), planned.get("draw")
    known = {key: value for key, value in planned.items() if key in {field.name for field in fields(EnvSettings)}}
    now = {
        "settings": shared_settings(EnvSettings(**known)),
        "seeds": tuple(chosen_seeds(suite, split, seeds, draw)),
        "draw": None if draw is None else {"commit": draw.commit, "secret_sha256": draw.secret_sha256},
    }
    if other := [key for key, value in now.items() if getattr(stored, key) != value]:
        raise ValueError(
            f"--results {folder}: its {suite}-{split}.json is of other {' and '.join(other)} and would be lost; "
            "give another folder"
        )


# --- evaluation ------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def kept_parts(folder: Path | None) -> Iterator[Path | None]:
    """Give the folder of finished parts in that of the results; after Ctrl-C, name it."""
    partial = None if folder is None else folder / "partial"
    try:
        yield partial
    except KeyboardInterrupt:
        if partial is not None:
            note(f"finished parts are kept in {partial}: run the same command again to go on")
        raise


def run_evaluation(entries: Sequence[Entry], *, partial: Path | None = None, **options: Any) -> Results:
    """Evaluate with progress on stderr; a policy that fails is left out; `options` are arguments of `evaluate`."""
    compile_ahead(EnvSettings(suite=options["suite"]))
    with Progress("episodes") as progress:
        results = evaluate(entries, on_progress=progress.update, partial=partial, keep_going=True, **options)
    if partial is not None:
        # Parts of other runs may still be in it.
        with contextlib.suppress(OSError):
            partial.rmdir()
    return results


def note_failures(results: Results) -> int:
    """Name the entries that failed, with their reasons; return 1 if there are some, else 0."""
    for entry in results.failed:
        seed = "" if entry["training_seed"] is None else f" (training seed {entry['training_seed']})"
        note(f"failed, and left out: {entry['name']}{seed}: {entry['reason']}")
    return int(bool(results.failed))


def finish(results: Results, folder: Path | None, *, as_json: bool, kept: Results | None = None) -> int:
    """Write the results, print the ranking or the description as JSON; return 1 if an entry failed, else 0.

    `kept` is what is written, if not the same: stored results beside those that were asked for.
    """
    code = note_failures(results)
    if folder is not None:
        for path in (results if kept is None else kept).write(folder):
            note(f"wrote {path}")
    if as_json:
        print_json(results.to_dict())
        return code
    say(f"suite {results.suite} ({results.suite_hash[:12]}), {results.split}: {len(results.seeds)} scenarios", "")
    rows = table_rows(results)
    heads = [_SHORT_HEADS.get(column, column) for column in TERMINAL_COLUMNS]
    print_table(heads, table_cells(rows, TERMINAL_COLUMNS), left=text_columns(TERMINAL_COLUMNS))
    say("", "Δf: largest deviation of a run's frequency, the median; lost runs: those that failed, counted in the next")
    say("column with those whose Δf is above 0.8 Hz; pinned cost: a lost run costs as if it had failed at its start")
    say(*filter(None, [privileged_note(rows)]), "--json prints more")
    if not results.has_scale:
        note(no_score_note(results))
    if results.oracle.missing:
        note(f"no share of the oracle's gap: {results.oracle.missing}")
    return code
