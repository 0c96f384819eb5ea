"""`wtg-gym analyse aggregation`: groups of turbines against single ones."""

from __future__ import annotations

import argparse
import dataclasses

from wtg_gym.analysis.aggregation_study import STRATEGIES, AggregationStudy, aggregation_table, study_aggregation
from wtg_gym.cli.output import check_page, give_text
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.suites_command import DRAWN_SUITES, suite_name
from wtg_gym.physics.plant import PHYSICS
from wtg_gym.progress import Progress

_DESCRIPTION = f"""\
Plays random scenarios twice: with two groups of ten turbines, each in the mean wind of its turbines, and with twenty
groups of one turbine, each in its own wind. Counts captured energy, smallest tip-speed ratios, trips and nadirs under
{", ".join(STRATEGIES)}. A turbine or group whose rotor fails is disconnected. The twenty groups are compiled
once (about a minute); 60 scenarios take about a minute more."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse aggregation`."""
    parser = add_command(
        commands,
        "aggregation",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym analyse aggregation --scenarios 10\n  wtg-gym analyse aggregation --suite gust --json\n"
        "  wtg-gym analyse aggregation --page docs/physics.md",
    )
    parser.add_argument("--scenarios", type=int, default=60, metavar="N", help="validation scenarios (default: 60)")
    parser.add_argument(
        "--suite",
        type=suite_name,
        default="low-wind",
        choices=DRAWN_SUITES,
        help="of the scenarios (default: low-wind)",
    )
    parser.add_argument("--physics", default="paper", choices=PHYSICS, help="of the plant (default: paper)")
    parser.add_argument(
        "--page", metavar="FILE", help="Markdown file with markers 'aggregation' to put the table between"
    )
    parser.add_argument("--json", action="store_true", help="print the study as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse aggregation`."""
    page = check_page("--page", arguments.page, "aggregation")
    with Progress("strategies") as progress:
        study = study_aggregation(
            arguments.scenarios, suite=arguments.suite, physics=arguments.physics, on_progress=progress.update
        )
    text = f"{_summary(study)}\n\n{aggregation_table(study)}"
    give_text(page, "aggregation", text, dataclasses.asdict(study), as_json=arguments.json)
    return 0


def _summary(study: AggregationStudy) -> str:
    return (
        f"{len(study.seeds)} validation scenarios of {study.suite}, physics {study.physics}: two groups of ten "
        "turbines against twenty single ones in the same wind. The standard deviation of the wind is "
        f"{study.sigma_single:.2f} m/s at a rotor and {study.sigma_group:.2f} m/s in the mean of ten."
    )
