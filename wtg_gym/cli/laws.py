"""The laws a command is asked about."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any, NoReturn

from wtg_gym.cli.output import say
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw, get_law
from wtg_gym.policies.load import example_law


class _PrintExample(argparse.Action):
    """Print the example of a law file, and end the command."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        say(*example_law().splitlines())
        parser.exit()


def add_law_option(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the option `--law` (or `--strategy`): names of strategies, law files, or all; may be repeated.

    And `--example-law`, which prints a law file to start from.
    """
    parser.add_argument(
        "--law",
        "--strategy",
        nargs="+",
        action="extend",
        metavar="NAME",
        help=f"strategies by name, 'all', or .toml files with a law; may be repeated (default: {default})",
    )
    parser.set_defaults(default_law=default)
    parser.add_argument(
        "--example-law",
        nargs=0,
        action=_PrintExample,
        help="print a law file to start from, and do nothing else: --example-law > my_law.toml",
    )


def chosen_laws(
    arguments: argparse.Namespace, turbine: TurbineParameters | None = None, every: Iterable[str] = STRATEGIES
) -> list[TrackingLaw]:
    """Return the laws of `--law`, each once, for a turbine; by default the paper's. `every` are those of "all".

    Raises:
        ValueError: a name is unknown, or two laws have the same one.
    """
    laws: dict[str, TrackingLaw] = {}
    names = arguments.law or [arguments.default_law]
    given = [expanded for name in names for expanded in (every if name == "all" else (name,))]
    for name in dict.fromkeys(given):
        law = get_law(name, turbine)
        if law.name in laws:
            raise ValueError(f"two strategies are called {law.name!r}; give the law in {name} another name")
        laws[law.name] = law
    return list(laws.values())
