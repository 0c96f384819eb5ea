"""`wtg-gym results matrix`: entries played on every suite of a version, and with other sensors."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from wtg_gym.cli import scoring
from wtg_gym.cli.output import check_output_folder, check_page, note, print_json, print_table, say, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.stored import stored_or_played
from wtg_gym.cli.suites_command import suite_name
from wtg_gym.evaluation.matrix import PERTURBATIONS, SCALE, Matrix, matrix_of, score_text, suites_of, worst_text
from wtg_gym.policies.entry import check_version
from wtg_gym.scenarios import SPLITS, get_suite
from wtg_gym.scenarios.benchmark import V1

#: Where `--page` puts the tables.
_SECTION = "matrix"
_DESCRIPTION = f"""\
Plays entries on every suite of a version of the benchmark, and on one of them with its sensors changed: one and two
control steps (0.1 s each) later, and with twice the constant error of the wind. Prints the scores and the mean pinned
cost of the worst tenth of the scenarios, one column for each set of scenarios.

{SCALE}

Results are stored as by 'wtg-gym leaderboard', in DIR, and used again; those with changed sensors lie in folders of
their own there: {", ".join(PERTURBATIONS)}. 'wtg-gym results page' shows all of them as one matrix."""
_EXAMPLES = """\
  wtg-gym results matrix --entries baselines --split validation --scenarios 50 --results my_results
  wtg-gym results matrix --entries baselines policies --page docs/benchmark.md
  wtg-gym results matrix --suites standard-v1 gusty-v1 --json"""


def add_matrix(commands: Commands) -> None:
    """Add `wtg-gym results matrix`."""
    parser = add_command(
        commands,
        "matrix",
        _run,
        summary="play entries on every suite and with other sensors, and show the scores side by side",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    scoring.add_entries_option(parser)
    parser.add_argument(
        "--suites",
        type=suite_name,
        nargs="+",
        metavar="NAME",
        help="suites of one version with sensors (default: all of v1)",
    )
    parser.add_argument(
        "--perturb",
        type=suite_name,
        default="standard-v1",
        metavar="NAME",
        help="suite that is also played with changed sensors, where it is among the suites (default: standard-v1)",
    )
    parser.add_argument("--split", choices=SPLITS[1:], default="test", help="(default: test)")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of each suite's split (default: all)")
    scoring.add_run_options(parser)
    scoring.add_worker_options(parser)
    parser.add_argument(
        "--results", metavar="DIR", default="results", help="folder of the results; made if missing (default: results)"
    )
    parser.add_argument("--page", metavar="FILE", help=f"Markdown file with markers '{_SECTION}' for the tables")


def _run(arguments: argparse.Namespace) -> int:
    page = check_page("--page", arguments.page, _SECTION)
    folder = check_output_folder("--results", arguments.results)
    suites = arguments.suites or suites_of(V1.version)
    benchmark = get_suite(suites[0]).benchmark
    if any(get_suite(name).benchmark is not benchmark for name in suites):
        raise ValueError(f"--suites are of two versions of the benchmark: {', '.join(suites)}")
    get_suite(arguments.perturb)
    planned = list(_planned(folder, suites, arguments))
    for place, scenarios in planned:
        scoring.check_stored(place, scenarios)
    partial = scoring.kept_parts(folder, arguments)
    workers = scoring.chosen_workers(arguments)
    entries = scoring.chosen_entries(arguments.entries, suites[0])
    check_version(entries, benchmark)
    played, code = [], 0
    for place, scenarios in planned:
        note(f"{scenarios['suite']} into {place}")
        results, kept = stored_or_played(
            entries, place, fresh=False, partial=partial, workers=workers, n_threads=arguments.threads, **scenarios
        )
        kept.write(place)
        code |= scoring.note_failures(results)
        played.append(results)
    matrix = matrix_of(played)
    if page is not None:
        update_page(page, {_SECTION: matrix.page()})
    if arguments.json:
        print_json(matrix.to_dict())
        return code
    _print(matrix)
    return code


def _planned(folder: Path, suites: list[str], arguments: argparse.Namespace) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield the folder of the results and the arguments of `evaluate` of each column."""
    for suite in suites:
        seeds = None
        if arguments.scenarios is not None:
            # A suite of fixed cases has fewer.
            most = len(get_suite(suite).seeds(arguments.split))
            seeds = scoring.first_seeds(suite, arguments.split, min(arguments.scenarios, most))
        scenarios = {"suite": suite, "split": arguments.split, "seeds": seeds}
        yield folder, scenarios
        own = get_suite(suite).sensors
        if suite == arguments.perturb and own is not None:
            for name, change in PERTURBATIONS.items():
                yield folder / name, {**scenarios, "sensors": change(own)}


def _print(matrix: Matrix) -> None:
    say(f"Scores on {matrix.describe()}", "")
    print_table(matrix.header(), matrix.texts(score_text))
    say("", "Mean pinned cost of the worst tenth of the scenarios:", "")
    print_table(matrix.header(), matrix.texts(worst_text))
