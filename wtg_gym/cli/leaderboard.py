"""`wtg-gym leaderboard` and `wtg-gym page`: entries ranked, and shown."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from wtg_gym.cli.output import (
    Progress,
    check_output_file,
    check_output_folder,
    check_page,
    note,
    require_extra,
    update_page,
    write_and_say,
)
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.scores import (
    DEFAULT_ENTRIES,
    add_score_options,
    add_worker_options,
    chosen_entries,
    chosen_workers,
    finish,
    kept_parts,
    run_evaluation,
)
from wtg_gym.evaluation import ANCHORS, Entry, Results, leaderboard_rows, markdown_table
from wtg_gym.plotting.page import N_SCENARIOS, SIZE_LIMIT, leaderboard_page, untraced
from wtg_gym.scenarios import get_suite

_TRACED_HELP = f"whose traces to show, as for 'wtg-gym leaderboard' (default: {DEFAULT_ENTRIES})"

_LEADERBOARD = """\
Ranks entries on all test scenarios of a suite. Stored results are used again where they are of the same suite, source
code and versions, and where replaying both anchors gives the same numbers; everything else is evaluated. An entry that
fails is named with its reason and left out with all training seeds of its name; the exit code is 1 then. The table is
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
  wtg-gym page results/*.json --entries baselines policies --output leaderboard.html
  wtg-gym page results/standard-test.json --scenarios 0 --output small.html"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym leaderboard` and `wtg-gym page`."""
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
    parser.add_argument("--fresh", action="store_true", help="evaluate everything, whatever is stored, from the start")
    parser = add_command(
        commands,
        "page",
        _run_page,
        summary="show stored results as one HTML file with charts and traces",
        description=_PAGE,
        examples=_PAGE_EXAMPLES,
    )
    parser.add_argument("results", nargs="+", metavar="RESULTS", help="JSON file of results, one of each suite")
    parser.add_argument("--entries", nargs="+", default=[DEFAULT_ENTRIES], metavar="SPEC", help=_TRACED_HELP)
    parser.add_argument("--output", required=True, metavar="FILE", help="the HTML file to write")
    parser.add_argument(
        "--scenarios",
        type=int,
        metavar="N",
        help="traces of the first N scenarios of each suite; 0 for none "
        f"(default: as many of the first {N_SCENARIOS} as keep the file below {SIZE_LIMIT / 1e6:g} MB)",
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")


def _run_leaderboard(arguments: argparse.Namespace) -> int:
    get_suite(arguments.suite)
    folder = check_output_folder("--results", arguments.results)
    section = f"leaderboard:{arguments.suite}"
    readme = check_page("--readme", arguments.readme, section)
    page = _check_html("--html", arguments.html)
    # Nor are finished parts believed with --fresh: they are stored results too.
    partial = None if arguments.fresh else kept_parts(folder, arguments)
    workers = chosen_workers(arguments)
    entries = chosen_entries(arguments.entries)
    anchors = run_evaluation([], arguments, partial=None)
    stored = None if arguments.fresh else _stored(folder / f"{anchors.name}.json", anchors)
    missing = [entry for entry in entries if stored is None or not _is_in(entry, stored)]
    if stored is not None:
        note(f"{len(entries) - len(missing)} of {len(entries)} entries are stored in {folder}")
    fresh = run_evaluation(missing, arguments, partial=partial, workers=workers) if missing else anchors
    results = _merged(entries, fresh, stored)
    code = finish(results, folder, as_json=arguments.json)
    if readme is not None:
        update_page(readme, {section: markdown_table(leaderboard_rows(results))})
    if page is not None:
        _write_html(page, [results], entries, None, arguments.threads)
    return code


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
    merged = dataclasses.replace(
        fresh,
        entries=tuple(wanted.values()),
        episodes=tuple(episode for key in wanted for episode in episodes.get(key, ())),
        failed=(),
    )
    # Training seeds that are stored are left out with the one that has failed now.
    return merged.without({(data["name"], data["training_seed"]): data["reason"] for data in fresh.failed})


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


__all__ = ["add_commands"]
