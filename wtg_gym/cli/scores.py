"""What the commands that score entries have in common: their options, the evaluation, and what it prints."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wtg_gym.cli.output import Progress, note, print_json, print_table, say
from wtg_gym.evaluation import (
    Entry,
    NoScaleError,
    Results,
    evaluate,
    leaderboard_rows,
    load_entries,
    table_cells,
)
from wtg_gym.evaluation.entries import LoadArchive
from wtg_gym.evaluation.evaluator import check_entries
from wtg_gym.evaluation.leaderboard import COLUMNS, SHORT_COLUMNS
from wtg_gym.evaluation.shipped import BASELINES
from wtg_gym.evaluation.workers import BACKENDS, Workers
from wtg_gym.scenarios import SUITES

DEFAULT_ENTRIES = BASELINES
#: Unit of the columns of points.
_POINTS = " [points]"
#: Of finished parts, in the folder of the results.
_PARTIAL_FOLDER = "partial"
_LARGEST_SEED_RANGE = 100_000
_ENTRIES_HELP = (
    "what to score, several allowed: 'baselines'; 'policies', the trained ones that come with the package; one of "
    "either by its name in the leaderboard, such as linear-feedback or 'PPO (k)'; a .toml file with a law; a folder "
    "with entry.toml and policy.onnx; a package with entries, or module:ATTRIBUTE, whose code is run "
    f"(default: {DEFAULT_ENTRIES})"
)


def add_score_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that every command shares that scores entries."""
    parser.add_argument("--entries", nargs="+", default=[DEFAULT_ENTRIES], metavar="SPEC", help=_ENTRIES_HELP)
    parser.add_argument(
        "--suite", default="standard", metavar="NAME", help=f"suite: {', '.join(SUITES)} (default: standard)"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def add_result_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where results go, and whether an interrupted command goes on."""
    parser.add_argument("--results", metavar="DIR", help="folder to write results to; made if missing (default: none)")
    parser.add_argument(
        "--resume",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="go on from the finished parts of an interrupted run in DIR, and keep them (default: --resume)",
    )


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that have other processes play."""
    group = parser.add_argument_group("workers, see docs/performance.md")
    group.add_argument(
        "--backend",
        choices=BACKENDS,
        help="other processes play: loky's on this machine, or those of Dask or Ray (default: this process)",
    )
    group.add_argument(
        "--address",
        metavar="ADDRESS",
        help="of a cluster: tcp://host:8786 for dask, host:6379 or auto for ray (default: workers on this machine)",
    )
    group.add_argument("--jobs", type=int, metavar="N", help="number of workers (default: one per processor)")


def chosen_workers(arguments: argparse.Namespace) -> Workers | None:
    """Return the workers that the options name; a ValueError says what is wrong with one."""
    if arguments.backend is not None:
        if arguments.threads not in (None, 1):
            raise ValueError(f"--threads {arguments.threads}: a worker steps with one thread; say how many with --jobs")
        return Workers(arguments.backend, arguments.address, arguments.jobs)
    for option in ("address", "jobs"):
        if getattr(arguments, option) is not None:
            raise ValueError(f"--{option} is for workers: say which with --backend {', '.join(BACKENDS)}")
    return None


def kept_parts(folder: Path | None, arguments: argparse.Namespace) -> Path | None:
    """Return where finished parts are kept, which is then said after Ctrl-C; None for nowhere.

    Args:
        folder: of the results; None for none.
        arguments: of the command; one without `--resume` keeps its parts.
    """
    if folder is None or not getattr(arguments, "resume", True):
        return None
    partial = folder / _PARTIAL_FOLDER
    arguments.after_interrupt = f"finished parts are kept in {partial}: run the same command again to go on"
    return partial


def run_evaluation(
    entries: Sequence[Entry], arguments: argparse.Namespace, *, partial: Path | None, **settings: Any
) -> Results:
    """Return the results of entries on the suite that the arguments name, with progress on stderr."""
    with Progress("episodes") as progress:
        results = evaluate(
            entries,
            arguments.suite,
            n_threads=arguments.threads,
            on_progress=progress.update,
            partial=partial,
            keep_going=True,
            **settings,
        )
    if partial is not None:
        # Parts of other runs may still be in it.
        with contextlib.suppress(OSError):
            partial.rmdir()
    return results


def chosen_entries(specs: Sequence[str], load_archive: LoadArchive | None = None) -> list[Entry]:
    """Return the entries that the values of `--entries` name; a ValueError says what is wrong with one.

    Archives of Stable-Baselines3 are refused, unless `load_archive` loads them.
    """
    # A console script, unlike `python -m`, does not look into the working folder: a checkout's packages are there.
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    entries = [entry for spec in specs for entry in load_entries(spec, load_archive)]
    names = [(entry.name, entry.training_seed) for entry in entries]
    doubled = sorted({name for name, seed in names if names.count((name, seed)) > 1})
    if doubled:
        raise ValueError(f"--entries gives {', '.join(doubled)} more than once; names must be unique")
    # The stored ones among them are not evaluated, but stand in the same table.
    check_entries(entries)
    return entries


def chosen_seeds(texts: Sequence[str]) -> list[int]:
    """Return the seeds that the values of `--seeds` name; a ValueError says what is wrong with one."""
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


def finish(results: Results, folder: Path | None, *, as_json: bool) -> int:
    """Write the results, then print the ranking or all of the description as JSON.

    Entries that failed are named on stderr; the exit code, which is returned, is 1 then.
    """
    code = int(bool(results.failed))
    for entry in results.failed:
        seed = "" if entry["training_seed"] is None else f" (training seed {entry['training_seed']})"
        note(f"failed, and left out: {entry['name']}{seed}: {entry['reason']}")
    if folder is not None:
        for path in results.write(folder):
            note(f"wrote {path}")
    if as_json:
        print_json(results.to_dict())
        return code
    say(f"suite {results.suite} ({results.suite_hash[:12]}), {results.split}: {len(results.seeds)} scenarios", "")
    try:
        rows = leaderboard_rows(results)
    except NoScaleError as error:
        note(f"no ranking: {error}")
        return code
    left = [index for index, column in enumerate(SHORT_COLUMNS) if not COLUMNS[column]]
    # Without their unit, which the line below gives, the heads fit into 120 columns.
    heads = [column.removesuffix(_POINTS) for column in SHORT_COLUMNS]
    print_table(heads, table_cells(rows, SHORT_COLUMNS), left=left)
    terms = ", ".join(head for head, column in zip(heads, SHORT_COLUMNS, strict=True) if column != head)
    say("", f"{terms}: points by terms of the cost, which add up to score - 100; --json prints more")
    if results.oracle.missing:
        note(f"no share of the oracle's gap: {results.oracle.missing}")
    return code


__all__ = [
    "DEFAULT_ENTRIES",
    "add_result_options",
    "add_score_options",
    "add_worker_options",
    "chosen_entries",
    "chosen_seeds",
    "chosen_workers",
    "finish",
    "kept_parts",
    "run_evaluation",
]
