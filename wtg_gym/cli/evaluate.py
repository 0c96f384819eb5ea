"""`wtg-gym evaluate` and `wtg-gym leaderboard`: entries scored on scenarios of a suite, and ranked."""

from __future__ import annotations

import argparse
from pathlib import Path

from wtg_gym.cli import scoring
from wtg_gym.cli.output import check_output_folder, check_page, note, update_page
from wtg_gym.cli.parser import Commands, add_command, add_plant_options
from wtg_gym.cli.results_command import check_html, write_html
from wtg_gym.cli.stored import stored_or_played
from wtg_gym.evaluation import Policy
from wtg_gym.evaluation.leaderboard import markdown_section, whole_section
from wtg_gym.policies.entry import check_version
from wtg_gym.scenarios import get_suite

_TRUST_HELP = (
    "also take folders with model.zip, an archive of Stable-Baselines3, in the place of policy.onnx, and the key "
    "algorithm in entry.toml. Loading one runs whatever code its maker put in the file, with your rights, and nothing "
    "can check that: only for files that you made yourself. The leaderboard never takes them"
)

_EVALUATE = """\
Plays entries through the scenarios of a suite, many at a time, and scores them: in suites of version v0, 0 is maximum
power point tracking (mppt) and 100 the reference strategy (coordinated-piecewise); in those of v1, 0 is the reference
strategy and 100 the same law tuned to that grid (coordinated-tuned). Both are always played too, because they fix the
scale. A policy plays in the version whose observations it takes. With --results, every episode is written to
<suite>-<split>.csv and the description and summary to <suite>-<split>.json; an interrupted evaluation goes on from its
finished parts. An entry whose policy raises, ends, takes too long or gives no action, or whose law has no equilibrium
in a scenario, is named with its reason and left out with all training seeds of its name; the others are ranked, and the
exit code is 1. A policy.onnx plays one scenario at a time, in a process of its own that can only compute and answer.

The default split is the one to choose policies on; 'wtg-gym leaderboard' and 'wtg-gym submission score' play the test
scenarios. --results refuses a folder whose <suite>-<split>.json is of other settings, seeds or another draw; results of
the same scenarios and settings are replaced, whatever their entries."""

_EVALUATE_EXAMPLES = """\
  wtg-gym evaluate --entries deloaded-5 coordinated-linear --suite low-wind
  wtg-gym evaluate --entries coordinated-piecewise fast-droop --suite standard-v1 --scenarios 20
  wtg-gym evaluate --entries my_law.toml --suite standard --scenarios 10 --results my_results
  wtg-gym evaluate --entries my_package.controller:make_policy --split test --json
  wtg-gym evaluate --entries runs/mine/best/* --trust-pickle
  wtg-gym evaluate --entries policies --backend dask --address tcp://head:8786 --results my_results"""

_LEADERBOARD = """\
Ranks entries on all test scenarios of a suite. Stored results are used again where they are of the same suite, source
code and versions, and where replaying both anchors gives the same numbers; everything else is evaluated. An entry that
fails is named with its reason and left out with all training seeds of its name; the exit code is 1 then. The table is
printed and the results are written as JSON and CSV. Stored results of entries that were not asked for are kept in these
files where they can be used again, but not printed; --fresh drops them. With --readme the table between the markers
<!-- leaderboard:SUITE:start --> and <!-- leaderboard:SUITE:end --> of that file is replaced; with --page, tables of all
columns replace what is between <!-- whole-leaderboard:SUITE:start --> and <!-- whole-leaderboard:SUITE:end --> there.
With --html the ranking is written as one HTML file with charts; 'wtg-gym results page'
does that for several suites at once.

Where the entry at 100 is no better than that at 0, as on paper-v1, there is no score: the mean pinned cost ranks."""

_LEADERBOARD_EXAMPLES = """\
  wtg-gym leaderboard --suite standard --results results --readme README.md
  wtg-gym leaderboard --suite weak-grid --entries baselines my_law.toml
  wtg-gym leaderboard --suite low-wind --html leaderboard.html
  wtg-gym leaderboard --suite paper --entries mppt deloaded-10 coordinated-piecewise --json"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym evaluate` and `wtg-gym leaderboard`."""
    parser = add_command(
        commands,
        "evaluate",
        _run_evaluate,
        description=_EVALUATE,
        examples=_EVALUATE_EXAMPLES,
        after_interrupt="nothing was written; with --results DIR the finished parts are kept",
    )
    scoring.add_entries_option(parser)
    scoring.add_suite_option(parser)
    scoring.add_run_options(parser)
    scoring.add_worker_options(parser)
    scoring.add_split_options(parser, "validation")
    parser.add_argument("--duration", type=float, metavar="S", help="length of an episode [s] (default: the suite's)")
    scoring.add_result_options(parser)
    parser.add_argument("--trust-pickle", action="store_true", help=_TRUST_HELP)
    add_plant_options(parser)
    parser = add_command(
        commands, "leaderboard", _run_leaderboard, description=_LEADERBOARD, examples=_LEADERBOARD_EXAMPLES
    )
    scoring.add_entries_option(parser)
    scoring.add_suite_option(parser)
    scoring.add_run_options(parser)
    scoring.add_worker_options(parser)
    parser.add_argument(
        "--results", metavar="DIR", default="results", help="folder of the results; made if missing (default: results)"
    )
    parser.add_argument("--readme", metavar="FILE", help="file with the markers to put the table between")
    parser.add_argument("--page", metavar="FILE", help="file with the markers to put the whole table between")
    parser.add_argument("--html", metavar="FILE", help="write the ranking as one HTML file with charts")
    parser.add_argument("--fresh", action="store_true", help="evaluate everything, whatever is stored, from the start")


def _run_evaluate(arguments: argparse.Namespace) -> int:
    folder = None if arguments.results is None else check_output_folder("--results", arguments.results)
    partial = scoring.kept_parts(folder, arguments) if folder is not None and arguments.resume else None
    workers = scoring.chosen_workers(arguments)
    planned = {
        **scoring.chosen_scenarios(arguments),
        "duration_s": arguments.duration,
        "groups": arguments.groups,
        "control_dt": arguments.control_dt,
        "simulation_dt": arguments.simulation_dt,
        "machine_model": arguments.machine_model,
        "on_failure": arguments.on_failure,
        "physics": arguments.physics,
    }
    scoring.check_stored(folder, planned)
    # Last, because it takes longest, and may run code.
    entries = scoring.chosen_entries(
        arguments.entries, arguments.suite, _load_trusted if arguments.trust_pickle else None
    )
    results = scoring.run_evaluation(entries, **planned, partial=partial, n_threads=arguments.threads, workers=workers)
    return scoring.finish(results, folder, as_json=arguments.json)


def _load_trusted(folder: Path, algorithm: str) -> tuple[Policy, str]:
    # Here, because Stable-Baselines3 is another extra, and takes seconds to import.
    from wtg_gym.policies.sb3_archive import load_archive

    note(f"running the code in the archive of {folder}, as --trust-pickle says")
    return load_archive(folder, algorithm)


# --- leaderboard -----------------------------------------------------------------------------------------------------


def _run_leaderboard(arguments: argparse.Namespace) -> int:
    benchmark = get_suite(arguments.suite).benchmark
    folder = check_output_folder("--results", arguments.results)
    section, whole = f"leaderboard:{arguments.suite}", f"whole-leaderboard:{arguments.suite}"
    readme = check_page("--readme", arguments.readme, section)
    wider = check_page("--page", arguments.page, whole)
    page = None if arguments.html is None else check_html("--html", arguments.html)
    # Finished parts are stored results too.
    partial = None if arguments.fresh else scoring.kept_parts(folder, arguments)
    workers = scoring.chosen_workers(arguments)
    entries = scoring.chosen_entries(arguments.entries, arguments.suite)
    check_version(entries, benchmark)
    scenarios = {"suite": arguments.suite, "split": "test", "n_threads": arguments.threads}
    results, kept = stored_or_played(
        entries, folder, fresh=arguments.fresh, partial=partial, workers=workers, **scenarios
    )
    code = scoring.finish(results, folder, as_json=arguments.json, kept=kept)
    if readme is not None:
        update_page(readme, {section: markdown_section(results)})
    if wider is not None:
        update_page(wider, {whole: whole_section(results)})
    if page is not None:
        write_html(page, [results])
    return code
