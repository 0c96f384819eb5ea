"""`wtg-gym evaluate`, `wtg-gym leaderboard` and `wtg-gym page`: entries scored on a suite, ranked, and shown."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib.util
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wtg_gym.cli.draw import add_split_options, chosen_draw
from wtg_gym.cli.output import (
    Progress,
    check_output_file,
    check_output_folder,
    check_page,
    note,
    print_json,
    print_table,
    require_extra,
    update_page,
    write_and_say,
)
from wtg_gym.cli.parser import Commands, add_command, add_plant_options
from wtg_gym.evaluation import (
    ANCHORS,
    Entry,
    NoScaleError,
    Policy,
    Results,
    evaluate,
    leaderboard_rows,
    load_entries,
    markdown_table,
    table_cells,
)
from wtg_gym.evaluation.entries import LoadArchive
from wtg_gym.evaluation.evaluator import check_entries
from wtg_gym.evaluation.leaderboard import COLUMNS
from wtg_gym.evaluation.workers import BACKENDS, Workers
from wtg_gym.plotting.page import N_SCENARIOS, SIZE_LIMIT, leaderboard_page, untraced
from wtg_gym.scenarios import SUITES, get_suite

#: The package with the entries of a checkout.
_DEFAULT_ENTRIES = "baselines"
#: Of finished parts, in the folder of the results.
PARTIAL_FOLDER = "partial"
_LARGEST_SEED_RANGE = 100_000
_ENTRIES_HELP = (
    "what to score, several allowed: a strategy by name, a .toml file with a law, a folder with entry.toml and "
    "policy.onnx, a package with entries, or "
    f"module:ATTRIBUTE, whose code is run (default: {_DEFAULT_ENTRIES}, the package in a checkout)"
)
_TRUST_HELP = (
    "also take folders with model.zip, an archive of Stable-Baselines3, in the place of policy.onnx, and the key "
    "algorithm in entry.toml. Loading one runs whatever code its maker put in the file, with your rights, and nothing "
    "can check that: only for files that you made yourself. The leaderboard never takes them"
)
_TRACED_HELP = f"whose traces to show, as for 'wtg-gym leaderboard' (default: {_DEFAULT_ENTRIES})"

_EVALUATE = """\
Plays entries through the scenarios of a suite, many at a time, and scores them: 0 is maximum power point tracking, 100
the reference strategy. Both are always played too, because they fix the scale. With --results, every episode is
written to <suite>-<split>.csv and the description and summary to <suite>-<split>.json; an interrupted evaluation goes
on from its finished parts. Use another folder than the leaderboard's for choices of your own."""

_EVALUATE_EXAMPLES = """\
  wtg-gym evaluate --entries deloaded-5 coordinated-linear --suite low-wind
  wtg-gym evaluate --entries my_law.toml --suite standard --seeds 20000:20010 --results my_results
  wtg-gym evaluate --entries my_package.controller:make_policy --split validation --json
  wtg-gym evaluate --entries runs/mine/best/* --trust-pickle
  wtg-gym evaluate --entries agents/policies/* --backend dask --address tcp://head:8786 --results my_results"""

_LEADERBOARD = """\
Ranks entries on all test scenarios of a suite. Stored results are used again where they are of the same suite, source
code and versions, and where replaying both anchors gives the same numbers; everything else is evaluated. The table is
printed, the results are written as JSON and CSV, and with --readme the table between the markers
<!-- leaderboard:SUITE:start --> and <!-- leaderboard:SUITE:end --> of that file is replaced. With --html the ranking
is written as one HTML file with charts, and with traces of the first scenarios; 'wtg-gym page' does that for several
suites at once."""

_LEADERBOARD_EXAMPLES = """\
  wtg-gym leaderboard --suite standard --results results --readme README.md
  wtg-gym leaderboard --suite weak-grid --entries baselines my_law.toml
  wtg-gym leaderboard --suite low-wind --html leaderboard.html
  wtg-gym leaderboard --suite paper --entries mppt deloaded-10 coordinated-piecewise --json"""

_PAGE = """\
Shows stored results as one HTML file that needs nothing but a browser, offline too: the ranking with its intervals,
performance profiles, physical metrics, and two entries side by side in one scenario, frequency, rotors, power, k, τ
and wind over one time axis. The traces are recorded anew from the entries given with --entries, as far as they are
those of the results; both anchors are always there."""

_PAGE_EXAMPLES = """\
  wtg-gym page results/standard-test.json --output leaderboard.html
  wtg-gym page results/*.json --entries baselines agents/policies/* --output leaderboard.html
  wtg-gym page results/standard-test.json --scenarios 0 --output small.html"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym evaluate`, `wtg-gym leaderboard` and `wtg-gym page`."""
    parser = add_command(
        commands,
        "evaluate",
        _run_evaluate,
        summary="score entries on scenarios of a suite",
        description=_EVALUATE,
        examples=_EVALUATE_EXAMPLES,
        after_interrupt="nothing was written; with --results DIR the finished parts are kept",
    )
    add_score_options(parser)
    add_worker_options(parser)
    add_split_options(parser)
    parser.add_argument(
        "--seeds", nargs="+", metavar="A:B", help="seeds of the split, N or A:B with B left out (default: all)"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="length of an episode [s] (default: the suite's)")
    parser.add_argument("--results", metavar="DIR", help="folder to write results to; made if missing (default: none)")
    parser.add_argument(
        "--resume",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="go on from the finished parts of an interrupted run in DIR, and keep them (default: --resume)",
    )
    parser.add_argument("--trust-pickle", action="store_true", help=_TRUST_HELP)
    add_plant_options(parser)
    parser = add_command(
        commands,
        "leaderboard",
        _run_leaderboard,
        summary="rank entries on a suite and write the table to a README",
        description=_LEADERBOARD,
        examples=_LEADERBOARD_EXAMPLES,
    )
    add_score_options(parser)
    add_worker_options(parser)
    parser.add_argument(
        "--results", metavar="DIR", default="results", help="folder of the results; made if missing (default: results)"
    )
    parser.add_argument("--readme", metavar="FILE", help="file with the markers to put the table between")
    parser.add_argument("--html", metavar="FILE", help="write the ranking as one HTML file with charts and traces")
    parser.add_argument("--fresh", action="store_true", help="evaluate everything, whatever is stored")
    parser = add_command(
        commands,
        "page",
        _run_page,
        summary="show stored results as one HTML file with charts and traces",
        description=_PAGE,
        examples=_PAGE_EXAMPLES,
    )
    parser.add_argument("results", nargs="+", metavar="RESULTS", help="JSON file of results, one of each suite")
    parser.add_argument("--entries", nargs="+", default=[_DEFAULT_ENTRIES], metavar="SPEC", help=_TRACED_HELP)
    parser.add_argument("--output", required=True, metavar="FILE", help="the HTML file to write")
    parser.add_argument(
        "--scenarios",
        type=int,
        metavar="N",
        help="traces of the first N scenarios of each suite; 0 for none "
        f"(default: as many of the first {N_SCENARIOS} as keep the file below {SIZE_LIMIT / 1e6:g} MB)",
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")


def add_score_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that every command shares that scores entries."""
    parser.add_argument("--entries", nargs="+", default=[_DEFAULT_ENTRIES], metavar="SPEC", help=_ENTRIES_HELP)
    parser.add_argument(
        "--suite", default="standard", metavar="NAME", help=f"suite: {', '.join(SUITES)} (default: standard)"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


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
        return Workers(arguments.backend, arguments.address, arguments.jobs)
    for option in ("address", "jobs"):
        if getattr(arguments, option) is not None:
            raise ValueError(f"--{option} is for workers: say which with --backend {', '.join(BACKENDS)}")
    return None


# --- evaluate --------------------------------------------------------------------------------------------------------


def _run_evaluate(arguments: argparse.Namespace) -> int:
    folder = None if arguments.results is None else check_output_folder("--results", arguments.results)
    partial = folder / PARTIAL_FOLDER if folder is not None and arguments.resume else None
    if partial is not None:
        arguments.after_interrupt = resumable(partial)
    workers = chosen_workers(arguments)
    entries = chosen_entries(arguments.entries, _load_trusted if arguments.trust_pickle else None)
    results = run_evaluation(
        entries,
        arguments,
        split=arguments.split,
        partial=partial,
        workers=workers,
        seeds=None if arguments.seeds is None else chosen_seeds(arguments.seeds),
        draw=chosen_draw(arguments),
        duration_s=arguments.duration,
        groups=2 if arguments.groups is None else arguments.groups,
        control_dt=arguments.control_dt,
        simulation_dt=arguments.simulation_dt,
        machine_model=arguments.machine_model,
        on_failure=arguments.on_failure,
    )
    finish(results, folder, as_json=arguments.json)
    return 0


def _load_trusted(folder: Path, algorithm: str) -> tuple[Policy, str]:
    # Here, because Stable-Baselines3 is another extra, and takes seconds to import.
    from wtg_gym.sb3_archive import load_archive

    note(f"running the code in the archive of {folder}, as --trust-pickle says")
    return load_archive(folder, algorithm)


def resumable(partial: Path) -> str:
    """Return what to say after Ctrl-C where finished parts are kept."""
    return f"finished parts are kept in {partial}: run the same command again to go on"


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
    if _DEFAULT_ENTRIES in specs and importlib.util.find_spec(_DEFAULT_ENTRIES) is None:
        raise ValueError(
            f"there is no package {_DEFAULT_ENTRIES!r} here: run the command in the root of a checkout, "
            "or say what to score with --entries"
        )
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


def finish(results: Results, folder: Path | None, *, as_json: bool) -> None:
    """Write the results, then print the ranking or all of the description as JSON."""
    if folder is not None:
        for path in results.write(folder):
            note(f"wrote {path}")
    if as_json:
        print_json(results.to_dict())
        return
    print(f"suite {results.suite} ({results.suite_hash[:12]}), {results.split}: {len(results.seeds)} scenarios\n")
    try:
        rows = leaderboard_rows(results)
    except NoScaleError as error:
        note(f"no ranking: {error}")
        return
    left = [index for index, is_number in enumerate(COLUMNS.values()) if not is_number]
    print_table(tuple(COLUMNS), table_cells(rows), left=left)
    if results.oracle.missing:
        note(f"no share of the oracle's gap: {results.oracle.missing}")


# --- leaderboard -----------------------------------------------------------------------------------------------------


def _run_leaderboard(arguments: argparse.Namespace) -> int:
    get_suite(arguments.suite)
    folder = check_output_folder("--results", arguments.results)
    section = f"leaderboard:{arguments.suite}"
    readme = check_page("--readme", arguments.readme, section)
    page = _check_html("--html", arguments.html)
    partial = folder / PARTIAL_FOLDER
    arguments.after_interrupt = resumable(partial)
    workers = chosen_workers(arguments)
    entries = chosen_entries(arguments.entries)
    anchors = run_evaluation([], arguments, partial=None)
    stored = None if arguments.fresh else _stored(folder / f"{anchors.name}.json", anchors)
    missing = [entry for entry in entries if stored is None or not _is_in(entry, stored)]
    if stored is not None:
        note(f"{len(entries) - len(missing)} of {len(entries)} entries are stored in {folder}")
    fresh = run_evaluation(missing, arguments, partial=partial, workers=workers) if missing else anchors
    results = _merged(entries, fresh, stored)
    finish(results, folder, as_json=arguments.json)
    if readme is not None:
        update_page(readme, {section: markdown_table(leaderboard_rows(results))})
    if page is not None:
        _write_html(page, [results], entries, None, arguments.threads)
    return 0


def _stored(path: Path, anchors: Results) -> Results | None:
    """Return stored results if they would come out the same today, else None with a note why not."""
    if not path.exists():
        return None
    try:
        stored = Results.read(path)
    except ValueError as error:
        note(f"not used: {error}")
        return None
    for key in ("suite_hash", "source_hash", "environment", "split", "seeds", "settings", "versions"):
        if getattr(stored, key) != getattr(anchors, key):
            note(f"not used: {path} is of another {key.replace('_', ' ')}; evaluating everything")
            return None
    if any(stored.episodes_of(name) != anchors.episodes_of(name) for name in ANCHORS):
        note(f"not used: {path} is not reproduced by a replay of {' and '.join(ANCHORS)}; evaluating everything")
        return None
    return stored


def _is_in(entry: Entry, stored: Results) -> bool:
    # Without an identity nobody can say whether it is still the same policy.
    return entry.identity is not None and entry.to_dict() in stored.entries


def _merged(entries: Sequence[Entry], fresh: Results, stored: Results | None) -> Results:
    """The entries' results, and the anchors', out of fresh and stored ones."""
    sources = [fresh] if stored is None else [stored, fresh]
    described = {(data["name"], data["training_seed"]): data for source in sources for data in source.entries}
    wanted = {(entry.name, entry.training_seed): entry.to_dict() for entry in entries}
    for name in ANCHORS:
        wanted.setdefault((name, None), dict(described[name, None]))
    episodes = {}
    for source in sources:
        for key in wanted:
            own = [episode for episode in source.episodes if episode.run == key]
            if own:
                episodes[key] = own
    return dataclasses.replace(
        fresh, entries=tuple(wanted.values()), episodes=tuple(episode for key in wanted for episode in episodes[key])
    )


# --- page ------------------------------------------------------------------------------------------------------------


def _run_page(arguments: argparse.Namespace) -> int:
    page = _check_html("--output", arguments.output)
    assert page is not None
    results = [Results.read(path) for path in arguments.results]
    entries = [] if arguments.scenarios == 0 else chosen_entries(arguments.entries)
    _write_html(page, results, entries, arguments.scenarios, arguments.threads)
    return 0


def _check_html(option: str, text: str | None) -> Path | None:
    path = check_output_file(option, text, (".html", ".htm"))
    if path is not None:
        require_extra("bokeh", option)
    return path


def _write_html(
    path: Path, results: Sequence[Results], entries: Sequence[Entry], n_scenarios: int | None, n_threads: int | None
) -> None:
    with Progress("entries") as progress:
        page = leaderboard_page(
            results, entries, n_scenarios=n_scenarios, n_threads=n_threads, on_progress=progress.update
        )
    missing = [] if n_scenarios == 0 else untraced(results, entries)
    if missing:
        note(f"no traces of {', '.join(missing)}: not among the entries given, or changed since the results")
    write_and_say(path, page.text)
    traced = ", ".join(f"{name} {number}" for name, number in page.n_traced.items())
    note(f"{page.size / 1e6:.2f} MB; scenarios with traces: {traced}")
    if page.size > SIZE_LIMIT:
        note(f"that is more than {SIZE_LIMIT / 1e6:g} MB: show fewer suites or entries, or fewer --scenarios")
