"""`wtg-gym environment` and `wtg-gym parameters`: the reference pages, printed or put into a Markdown file."""

from __future__ import annotations

import argparse

from wtg_gym.analysis.environment_page import environment_page
from wtg_gym.analysis.parameter_list import COLUMNS, parameter_rows, parameters_page
from wtg_gym.cli.output import check_page, print_json, print_table, say, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.physics.sources import SOURCES

_ENVIRONMENT = """\
Describes the environments as Markdown: spaces with every entry's name, unit and bounds, rewards, info, ends and
arguments. With --page a Markdown file is renewed instead, between <!-- environment:start --> and
<!-- environment:end -->."""

_PARAMETERS = """\
Lists every parameter of turbine, control, protection, machines, network and cost, with its unit, its source and what
it is. With --page the table of a Markdown file is renewed, between <!-- parameters:start --> and
<!-- parameters:end -->."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym environment` and `wtg-gym parameters`."""
    examples = "  wtg-gym environment\n  wtg-gym environment --page docs/environment.md"
    parser = add_command(commands, "environment", _run_environment, description=_ENVIRONMENT, examples=examples)
    parser.add_argument("--page", metavar="FILE", help="Markdown file with the markers to put the text between")
    examples = "  wtg-gym parameters\n  wtg-gym parameters --json\n  wtg-gym parameters --page docs/parameters.md"
    parser = add_command(commands, "parameters", _run_parameters, description=_PARAMETERS, examples=examples)
    parser.add_argument("--page", metavar="FILE", help="Markdown file with the markers to put the table between")
    parser.add_argument("--json", action="store_true", help="print the table as JSON, and nothing else, on stdout")


def _run_environment(arguments: argparse.Namespace) -> int:
    page = check_page("--page", arguments.page, "environment")
    if page is None:
        say(*environment_page().splitlines())
    else:
        update_page(page, {"environment": environment_page()})
    return 0


def _run_parameters(arguments: argparse.Namespace) -> int:
    page = check_page("--page", arguments.page, "parameters")
    rows = parameter_rows()
    if page is not None:
        update_page(page, {"parameters": parameters_page()})
    if arguments.json:
        print_json({"parameters": [dict(zip(COLUMNS, row, strict=True)) for row in rows], "sources": SOURCES})
    elif page is None:
        print_table(COLUMNS, rows, left=(0, 1, 3, 4, 5))
    return 0
