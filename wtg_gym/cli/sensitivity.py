"""`wtg-gym sensitivity`: how scores and ranking depend on each weight of the cost."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

from wtg_gym.cli.output import Progress, check_page, print_json, print_table, say, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.scores import add_score_options, chosen_entries
from wtg_gym.evaluation.sensitivity import (
    COLUMNS,
    FACTORS,
    WEIGHTS,
    describe_idle,
    sensitivity_cells,
    sensitivity_page,
    study_sensitivity,
)
from wtg_gym.scenarios import SPLITS

_DESCRIPTION = f"""\
Evaluates entries with the weights of the cost as they are, and with each one multiplied by each factor, all others as
they are. Shown are the ranks that change, and the scores that change by a point or more. The scale is made anew each
time: maximum power point tracking has 0 and the reference strategy 100 with any weights, and a score that rises says
that the entry gains on these two, not that it does anything else. Nobody learns anew: a trained policy does what it
learned for the weights as they are.

A weight whose change moves the ranking decides what the benchmark asks for. One that moves no score by a point and no
rank is named at the end: among these entries it decides nothing; it may still keep others from something.

weights: {", ".join(WEIGHTS)}"""
_EXAMPLES = """\
  wtg-gym sensitivity --entries baselines
  wtg-gym sensitivity --entries deloaded-5 coordinated-linear --weights duty --factors 0.5 2 4 --scenarios 20
  wtg-gym sensitivity --entries baselines agents/policies/ppo-0 --page docs/benchmark.md"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym sensitivity`."""
    parser = add_command(
        commands,
        "sensitivity",
        run,
        summary="how scores and ranking depend on each weight of the cost",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    add_score_options(parser)
    parser.add_argument("--split", choices=SPLITS, default="validation", help="(default: validation)")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    parser.add_argument("--weights", nargs="+", choices=WEIGHTS, default=WEIGHTS, metavar="NAME", help="(default: all)")
    parser.add_argument(
        "--factors", nargs="+", type=float, default=FACTORS, metavar="X", help="0 … 1000, but 1 (default: 0 2)"
    )
    parser.add_argument(
        "--page", metavar="FILE", help="Markdown file with markers 'sensitivity' to put the table between"
    )


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym sensitivity`."""
    page = check_page("--page", arguments.page, "sensitivity")
    entries = chosen_entries(arguments.entries)
    with Progress("episodes") as progress:
        study = study_sensitivity(
            entries,
            arguments.suite,
            arguments.split,
            n_scenarios=arguments.scenarios,
            weights=arguments.weights,
            factors=arguments.factors,
            n_threads=arguments.threads,
            on_progress=progress.update,
        )
    if page is not None:
        update_page(page, {"sensitivity": sensitivity_page(study)})
    if arguments.json:
        print_json(study.to_dict())
        return 0
    say(f"suite {study.suite} ({study.suite_hash[:12]}), {study.split}: {study.n_scenarios} scenarios", "")
    print_table(("rank", "entry", "score"), _ranking(study.scores), left=(1,))
    say("")
    print_table(COLUMNS, sensitivity_cells(study), left=(0, 2, 3))
    say("", describe_idle(study))
    return 0


def _ranking(scores: Mapping[str, float]) -> list[tuple[str, str, str]]:
    return [
        (str(rank), name, f"{round(score, 1) + 0.0:.1f}") for rank, (name, score) in enumerate(scores.items(), start=1)
    ]
