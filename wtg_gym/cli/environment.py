"""`wtg-gym environment`: actions, observations, rewards and arguments of the environments."""

from __future__ import annotations

import argparse

from wtg_gym.analysis.environment_page import environment_page
from wtg_gym.cli.output import check_page, say, update_page
from wtg_gym.cli.parser import Commands, add_command

_DESCRIPTION = """\
Describes the environments as Markdown: spaces with every entry's name, unit and bounds, rewards, info, ends and
arguments. With --page a Markdown file is renewed instead, between <!-- environment:start --> and
<!-- environment:end -->."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym environment`."""
    parser = add_command(
        commands,
        "environment",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym environment\n  wtg-gym environment --page docs/environment.md",
    )
    parser.add_argument("--page", metavar="FILE", help="Markdown file with the markers to put the text between")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym environment`."""
    page = check_page("--page", arguments.page, "environment")
    if page is None:
        say(*environment_page().splitlines())
    else:
        update_page(page, {"environment": environment_page()})
    return 0
