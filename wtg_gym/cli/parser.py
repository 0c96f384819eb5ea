"""Parsers of commands, and options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, NoReturn

from wtg_gym.cli.output import FIGURE_FORMATS

#: The return value of `add_subparsers`, to which commands are added.
Commands = Any


class Parser(argparse.ArgumentParser):
    """A parser whose help keeps its line breaks, and whose errors are a ValueError of one line."""

    def __init__(self, **arguments: Any) -> None:
        arguments.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(allow_abbrev=False, **arguments)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Refuse unknown arguments here, where the help of the command they were given to is known."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Raise a ValueError instead of printing the usage."""
        raise ValueError(f"{message} (see: {self.prog} --help)")


def add_group(commands: Commands, name: str, *, description: str) -> Commands:
    """Add a command with sub-commands; return the object that these are added to."""
    parser = commands.add_parser(name, description=description)
    return parser.add_subparsers(title="commands", metavar="COMMAND", required=True)


def add_command(
    commands: Commands,
    name: str,
    run: Callable[[argparse.Namespace], int],
    *,
    description: str,
    examples: str,
    summary: str | None = None,
    after_interrupt: str = "nothing was written",
) -> argparse.ArgumentParser:
    """Add a command.

    Args:
        summary: one line for the list of commands; None for those that `wtg_gym.cli` lists.
        after_interrupt: printed after Ctrl-C: the files that are left, and how to go on.

    Returns:
        The command's parser, for its options.
    """
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=description, epilog=f"examples:\n{examples}"
    )
    parser.set_defaults(run=run, after_interrupt=after_interrupt)
    return parser


def add_threads_option(parser: argparse.ArgumentParser) -> None:
    """Add `--threads`."""
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add `--json`."""
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def add_output_options(
    parser: argparse.ArgumentParser, *, output: str, page: str, json: str, default: str | None = None
) -> None:
    """Add the options of what a study writes besides a table on stdout; by default no files, or those in `default`."""
    out = parser.add_argument_group("output")
    out.add_argument("--output", default=default, metavar="FOLDER", help=output)
    out.add_argument(
        "--formats", nargs="+", choices=FIGURE_FORMATS, default=["svg", "png"], help="of the figures (default: svg png)"
    )
    out.add_argument("--page", metavar="FILE", help=page)
    out.add_argument("--json", action="store_true", help=json)


def add_plant_options(parser: argparse.ArgumentParser, *, default_groups: str = "the suite's") -> None:
    """Add the options of the plant and of the time steps; `default_groups` describes the default of `--groups`."""
    # They bring the simulator, which the list of commands does without.
    from wtg_gym.envs.settings import FAILURE_MODES, MACHINE_MODELS
    from wtg_gym.physics.plant import PHYSICS

    plant = parser.add_argument_group("plant and time steps")
    plant.add_argument(
        "--groups",
        type=int,
        metavar="N",
        help=f"number of WTG groups at bus 2 that share 20 turbines of 5 MW (default: {default_groups})",
    )
    plant.add_argument("--control-dt", type=float, default=0.1, metavar="S", help="control interval [s] (default: 0.1)")
    plant.add_argument(
        "--simulation-dt",
        type=float,
        default=0.025,
        metavar="S",
        help="integration step, at most 0.04 s (default: 0.025)",
    )
    plant.add_argument(
        "--machine-model",
        choices=MACHINE_MODELS,
        default="genrou",
        help="synchronous machines: genrou with exciters, or classical (default: genrou)",
    )
    plant.add_argument(
        "--on-failure",
        choices=FAILURE_MODES,
        default="terminate",
        help="the failure of a rotor (stall, over-speed, under-speed) ends the run, or disconnects its group (default: "
        "terminate)",
    )
    plant.add_argument(
        "--physics",
        choices=PHYSICS,
        help="the paper's model; extended by what it leaves out (rotor energy, current, power and reactive limits, "
        "voltage control, dead band, load shedding, under-speed trip); or that with the NREL 5 MW turbine (default: "
        "the suite's)",
    )
