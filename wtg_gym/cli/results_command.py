"""`wtg-gym results`: stored results shown, computed again, compared; other suites and sensors."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from wtg_gym.cli import output, scoring
from wtg_gym.cli.parser import Commands, add_command, add_group, add_json_option
from wtg_gym.cli.results_matrix import add_matrix
from wtg_gym.evaluation import Results, generalisation, leaderboard_rows
from wtg_gym.evaluation.recompute import departures, recompute
from wtg_gym.plotting import figure_bytes, plot_front
from wtg_gym.plotting.front import MOST_FAILURES_PERCENT, undominated
from wtg_gym.plotting.page import leaderboard_page
from wtg_gym.policies.names import BASELINES
from wtg_gym.progress import Progress

#: Differences that are printed.
_SHOWN = 20

_PAGE = """\
Shows stored results as one HTML file that needs nothing but a browser, offline too: each suite's ranking with its
intervals, to sort and to filter, the scores as a chart, and the deviation of the frequency against the failures. The
scores on several suites stand side by side in a table, too, and beside them those that 'wtg-gym results matrix' played
with other sensors. Suites of the latest version of the benchmark come first."""

_RECOMPUTE = """\
Evaluates the entries of a results file again, on the same scenarios with the same settings, and compares every number
of every episode to the last bit, the policies' sha256, kinds and laws, and the suite's hash. Says that the results are
identical, or what differs; the exit code is then 1. Other versions of source code or packages, and other texts about an
entry, are named, but are no difference by themselves: laws give the same bits on one kind of processor, a policy's last
digits may depend on onnxruntime. The environment's fingerprint says whether this machine computes the same as the one
before. Fewer scenarios, shorter episodes or other weights than those of the benchmark are named too."""

_GAP = """\
Compares the scores of entries on the public test scenarios with those on fresh ones, which were drawn after the entries
were submitted. An entry that was fitted to the public scenarios, by mistake or on purpose, is better there. All entries
are a little better or worse by the luck of the draw: a set of scenarios that suits one good controller suits the
others. The gap is the public score minus the fresh one. A learned entry has an excess too: the part of its gap that the
controllers made by hand in the same results do not share (by a regression on their gains). Both have a bootstrap 95 %
interval over scenarios; that of the gap is over training seeds too. An excess whose interval lies above zero is marked,
which happens to one honest entry in forty by chance.

Fresh scenarios are played by 'wtg-gym evaluate' or 'wtg-gym submission score' with --split fresh, --commit, the full
hash of the commit with the entries, and --secret-file. Publish the sha256 of the secret before anybody submits and the
secret afterwards: then 'wtg-gym results recompute --secret-file' shows that the seeds were not chosen."""

_FRONT = f"""\
Draws what frequency and RoCoF add to a score of 100 against the captured share of the available energy, one marker for
each entry. A line joins the entries that no other one beats in both. Entries that fail in more than
{MOST_FAILURES_PERCENT:g} % of the scenarios are hollow and not joined: a run that fails pays for the frequency only
until it ends."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym results` with its commands."""
    own = add_group(
        commands,
        "results",
        description="Works with the stored results of 'wtg-gym evaluate' and 'wtg-gym leaderboard'.",
    )
    for add in (_add_page, _add_recompute, _add_gap, add_matrix, _add_front):
        add(own)


# --- page ------------------------------------------------------------------------------------------------------------


def _add_page(own: Commands) -> None:
    parser = add_command(
        own,
        "page",
        _run_page,
        summary="show stored results as one HTML file with charts",
        description=_PAGE,
        examples="  wtg-gym results page results/standard-test.json --output leaderboard.html\n"
        "  wtg-gym results page results/*.json --output leaderboard.html",
    )
    parser.add_argument("results", nargs="+", metavar="RESULTS", help="JSON file of results, one of each suite")
    parser.add_argument("--output", required=True, metavar="FILE", help="the HTML file to write")


def _run_page(arguments: argparse.Namespace) -> int:
    page = check_html("--output", arguments.output)
    results = [Results.read(path) for path in arguments.results]
    for each in results:
        if not each.has_scale:
            output.note(
                f"no ranking of {each.name}, where {each.benchmark.hundred} is no better than {each.benchmark.zero}"
            )
    write_html(page, results)
    return 0


def check_html(option: str, text: str) -> Path:
    """Return the path of an HTML file to write, or raise a ValueError now rather than after the work."""
    path = output.check_output_file(option, text, (".html", ".htm"))
    output.require_extra("bokeh", option)
    return path


def write_html(path: Path, results: Sequence[Results]) -> None:
    """Write results as one HTML file."""
    output.write_and_say(path, leaderboard_page(results))


# --- recompute -------------------------------------------------------------------------------------------------------


def _add_recompute(own: Commands) -> None:
    parser = add_command(
        own,
        "recompute",
        _run_recompute,
        summary="compute results again, and say whether they are identical",
        description=_RECOMPUTE,
        examples="  wtg-gym results recompute results/standard-test.json --entries baselines policies\n"
        "  wtg-gym results recompute results/paper-test.json --json",
    )
    parser.add_argument("results", metavar="RESULTS.json", help="results of evaluate or leaderboard, the CSV beside it")
    scoring.add_entries_option(parser, f"as for evaluate, without archives of Stable-Baselines3 (default: {BASELINES})")
    parser.add_argument("--secret-file", metavar="FILE", help="also check that fresh seeds were drawn with this secret")
    scoring.add_run_options(parser)
    scoring.add_worker_options(parser)


def _run_recompute(arguments: argparse.Namespace) -> int:
    stored = Results.read(arguments.results)
    secret = None if arguments.secret_file is None else scoring.read_secret(arguments.secret_file)
    workers = scoring.chosen_workers(arguments)
    entries = scoring.chosen_entries(arguments.entries, stored.suite)
    with Progress("episodes") as progress:
        found = recompute(
            stored, entries, secret=secret, n_threads=arguments.threads, workers=workers, on_progress=progress.update
        )
    if arguments.json:
        output.print_json(
            {
                "identical": not found.differences,
                "differences": [difference._asdict() for difference in found.differences],
                "circumstances": [difference._asdict() for difference in found.circumstances],
                "departures": departures(stored),
                "numbers": found.n_numbers,
            }
        )
        return int(bool(found.differences))
    for difference in found.circumstances:
        output.note(f"{difference.where} was {difference.stored}, is {difference.now}")
    for text in departures(stored):
        output.note(f"not the benchmark's own: {text}")
    if stored.draw is not None and secret is None:
        output.note("whether these seeds were drawn or chosen is not known: check them with --secret-file")
    if not found.differences:
        output.say(f"identical: {found.n_numbers} values of {len(stored.episodes)} episodes")
        return 0
    output.say(
        f"not identical: {len(found.differences)} differences, the first {min(_SHOWN, len(found.differences))}", ""
    )
    output.print_table(("where", "stored", "now"), found.differences[:_SHOWN], left=(0, 1, 2))
    return 1


# --- gap -------------------------------------------------------------------------------------------------------------


def _add_gap(own: Commands) -> None:
    parser = add_command(
        own,
        "gap",
        _run_gap,
        summary="compare scores on public and on fresh scenarios",
        description=_GAP,
        examples="  wtg-gym results gap results/standard-test.json results/standard-fresh.json",
    )
    parser.add_argument("public", metavar="PUBLIC.json", help="results on the test scenarios")
    parser.add_argument("fresh", metavar="FRESH.json", help="results on the split fresh")
    parser.add_argument(
        "--page", metavar="FILE", help="Markdown file with markers 'gap:SUITE' to put the table between"
    )
    add_json_option(parser)


def _run_gap(arguments: argparse.Namespace) -> int:
    public, fresh = Results.read(arguments.public), Results.read(arguments.fresh)
    section = f"gap:{public.suite}"
    page = output.check_page("--page", arguments.page, section)
    gaps = generalisation.generalisation_gaps(public, fresh)
    missing = generalisation.left_out(public, fresh)
    if arguments.json:
        output.print_json({"draw": fresh.draw, "gaps": [gap.to_dict() for gap in gaps], "left_out": missing})
    else:
        output.say(generalisation.describe(public, fresh), "")
        left = [index for index, is_number in enumerate(generalisation.COLUMNS.values()) if not is_number]
        output.print_table(tuple(generalisation.COLUMNS), generalisation.gap_cells(gaps), left=left)
    if missing:
        output.note(f"left out, not the same policy in both results: {', '.join(missing)}")
    if page is not None:
        output.update_page(page, {section: generalisation.gap_page(public, fresh, gaps)})
    return 0


# --- front ------------------------------------------------------------------------------------------------------------


def _add_front(own: Commands) -> None:
    parser = add_command(
        own,
        "front",
        _run_front,
        summary="draw points of frequency and RoCoF against captured energy",
        description=_FRONT,
        examples="  wtg-gym results front results/standard-v1-test.json --plot front.svg",
    )
    parser.add_argument("results", metavar="RESULTS.json", help="results of evaluate or leaderboard, the CSV beside it")
    parser.add_argument("--plot", required=True, metavar="FILE", help=f"the figure: {', '.join(output.PLOT_SUFFIXES)}")


def _run_front(arguments: argparse.Namespace) -> int:
    plot = output.check_plot_file(arguments.plot)
    assert plot is not None
    rows = leaderboard_rows(Results.read(arguments.results))
    output.write_and_say(plot, figure_bytes(plot_front(rows), plot.suffix))
    best = ", ".join(row.name for row in undominated(rows))
    output.say(f"no other entry has more support and more energy than: {best}")
    return 0
