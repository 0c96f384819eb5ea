"""Scoring on the command line: the options, one evaluation, and the printed ranking."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.cli.parser import add_json_option, add_threads_option
from wtg_gym.cli.suites_command import suite_name, suites_by_version
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
from wtg_gym.policies.load import LoadArchive
from wtg_gym.policies.names import BASELINES
from wtg_gym.progress import Progress
from wtg_gym.scenarios import DEFAULT_SUITE, FRESH, SPLITS, FreshDraw, draw_seeds, get_suite

#: Heads of columns that are too wide for a terminal of 120 columns.
_SHORT_HEADS = {MEDIAN_DEVIATION: "Δf [mHz]", LOST_OR_BEYOND: "or > 0.8 Hz [%]"}
_LARGEST_SEED_RANGE = 100_000
_LARGEST_SECRET = 4096
_ENTRIES_HELP = (
    "entries, several allowed: 'baselines'; 'policies', the trained ones that come with the package; one of "
    "either by its name in the leaderboard, such as linear-feedback or 'PPO (k)'; a .toml file with a law; a folder "
    "with entry.toml and policy.onnx; a package with entries, or module:ATTRIBUTE, whose code is run "
    f"(default: {BASELINES})"
)


# --- options ---------------------------------------------------------------------------------------------------------


def add_entries_option(parser: argparse.ArgumentParser, text: str = _ENTRIES_HELP) -> None:
    """Add `--entries`."""
    parser.add_argument("--entries", nargs="+", default=[BASELINES], metavar="SPEC", help=text)


def add_suite_option(parser: argparse.ArgumentParser) -> None:
    """Add `--suite`."""
    parser.add_argument(
        "--suite",
        type=suite_name,
        default=DEFAULT_SUITE,
        metavar="NAME",
        help=f"suite, of {suites_by_version()} (default: {DEFAULT_SUITE})",
    )


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add `--threads` and `--json`."""
    add_threads_option(parser)
    add_json_option(parser)


def add_split_options(parser: argparse.ArgumentParser, default: str) -> None:
    """Add `--split` with its default, `--seeds`, and the options that the split "fresh" needs."""
    parser.add_argument(
        "--split",
        choices=(*SPLITS, FRESH),
        default=default,
        help=f"which seeds of the suite; fresh: seeds drawn from a commit and a secret (default: {default})",
    )
    parser.add_argument(
        "--seeds", nargs="+", metavar="A:B", help="seeds of the split, N or A:B with B left out (default: all)"
    )
    parser.add_argument(
        "--scenarios",
        type=int,
        metavar="N",
        help=f"the first N of the split (default: all); with --split {FRESH} how many to draw (default: as test has)",
    )
    group = parser.add_argument_group("fresh scenarios", f"for --split {FRESH}")
    group.add_argument("--commit", metavar="HASH", help="full hash of the git commit with the entries")
    group.add_argument("--secret-file", metavar="FILE", help="file with the secret, 16 bytes or more")


def add_result_options(parser: argparse.ArgumentParser) -> None:
    """Add `--results` and `--resume`."""
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


# --- values of options: a ValueError says what is wrong with one -----------------------------------------------------


def chosen_entries(
    specs: Sequence[str], suite: str = DEFAULT_SUITE, load_archive: LoadArchive | None = None, *, others: bool = True
) -> list[Entry]:
    """Return the entries of `--entries` for a suite; without `others` only those that play in its version."""
    benchmark = get_suite(suite).benchmark
    # A console script, unlike `python -m`, does not look into the working folder: a checkout's packages are there.
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    entries = [entry for spec in specs for entry in load_entries(spec, load_archive, benchmark)]
    if not others:
        entries = [entry for entry in entries if entry.environment in (None, benchmark.env_id)]
    # Stored ones among them are not evaluated, but stand in the same table.
    check_entries(entries)
    return entries


def chosen_scenarios(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the suite, the split, and the seeds or the draw of fresh ones, as arguments of `evaluate`."""
    get_suite(arguments.suite)
    chosen = {"suite": arguments.suite, "split": arguments.split}
    options = {"--commit": arguments.commit, "--secret-file": arguments.secret_file}
    given = [option for option, value in options.items() if value is not None]
    if arguments.split != FRESH:
        if given:
            raise ValueError(f"{', '.join(given)}: for --split {FRESH} only, the split is {arguments.split}")
        if arguments.scenarios is not None:
            if arguments.seeds is not None:
                raise ValueError("--scenarios takes the first of the split, --seeds others: give one of the two")
            return {**chosen, "seeds": first_seeds(arguments.suite, arguments.split, arguments.scenarios)}
        return {**chosen, "seeds": None if arguments.seeds is None else _seeds(arguments.seeds)}
    missing = [option for option in ("--commit", "--secret-file") if option not in given]
    if missing or arguments.seeds is not None:
        raise ValueError(
            f"--split {FRESH} draws its seeds from --commit and --secret-file, without --seeds; "
            f"missing: {', '.join(missing) or 'none'}"
        )
    secret = read_secret(arguments.secret_file)
    draw: FreshDraw = draw_seeds(arguments.suite, arguments.commit, secret, arguments.scenarios)
    return {**chosen, "draw": draw}


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


def read_secret(path: str) -> bytes:
    """Return the secret of `--secret-file`, without blanks around it."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST_SECRET + 1)
    except OSError as error:
        raise ValueError(f"--secret-file {path}: {error.strerror}") from error
    if len(content) > _LARGEST_SECRET:
        raise ValueError(f"--secret-file {path}: larger than {_LARGEST_SECRET} bytes")
    return content.strip()


def chosen_workers(arguments: argparse.Namespace) -> Workers | None:
    """Return the workers of `--backend`."""
    if arguments.backend is not None:
        if arguments.threads not in (None, 1):
            raise ValueError(f"--threads {arguments.threads}: a worker steps with one thread; say how many with --jobs")
        return Workers(arguments.backend, arguments.address, arguments.jobs)
    for option in ("address", "jobs"):
        if getattr(arguments, option) is not None:
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


def kept_parts(folder: Path, arguments: argparse.Namespace) -> Path:
    """Return the folder of finished parts in that of the results; after Ctrl-C it is named."""
    partial = folder / "partial"
    arguments.after_interrupt = f"finished parts are kept in {partial}: run the same command again to go on"
    return partial


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
