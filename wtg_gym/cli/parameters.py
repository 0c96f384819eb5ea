"""`wtg-gym parameters`: every number of the model with its unit and source."""

from __future__ import annotations

import argparse

from wtg_gym.analysis.parameter_list import COLUMNS, parameter_rows, parameters_page
from wtg_gym.cli.output import check_page, print_json, print_table, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.physics.parameters import SOURCES

_DESCRIPTION = """\
Lists every parameter of turbine, control, protection, machines, network and cost, with its unit, its source and what
it is. With --page the table of a Markdown file is renewed, between <!-- parameters:start --> and
<!-- parameters:end -->."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym parameters`."""
    parser = add_command(
        commands,
        "parameters",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym parameters\n  wtg-gym parameters --json\n  wtg-gym parameters --page docs/parameters.md",
    )
    parser.add_argument("--page", metavar="FILE", help="Markdown file with the markers to put the table between")
    parser.add_argument("--json", action="store_true", help="print the table as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym parameters`."""
    page = check_page("--page", arguments.page, "parameters")
    rows = parameter_rows()
    if page is not None:
        update_page(page, {"parameters": parameters_page()})
    if arguments.json:
        print_json({"parameters": [dict(zip(COLUMNS, row, strict=True)) for row in rows], "sources": SOURCES})
    elif page is None:
        print_table(COLUMNS, rows, left=(0, 1, 3, 4, 5))
    return 0
