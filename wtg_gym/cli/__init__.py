"""The command `wtg-gym`: one module a command or group of commands.

Exit codes: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the output's reader is gone. Results go to
stdout; progress, notes and errors go to stderr.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from wtg_gym import __version__
from wtg_gym.cli import (
    accuracy,
    aggregation,
    bench,
    compare,
    environment,
    estimation,
    evaluate,
    explore,
    influence,
    parameters,
    physics,
    play,
    reproduce,
    results,
    simulate,
    small_signal,
    statics,
    submission,
    suites,
    warmup,
)
from wtg_gym.cli.output import note, one_line
from wtg_gym.cli.parser import Parser, add_group

_DESCRIPTION = """\
Primary frequency regulation with grid-forming wind turbine generators on the modified IEEE 14-bus system: simulate
single scenarios, score controllers on frozen suites of scenarios, and rank them."""

_EPILOG = """\
first steps:
  wtg-gym simulate                                   the paper's load increase under the reference strategy
  wtg-gym simulate --strategy all --plot run.png     under every strategy, with a figure
  wtg-gym play                                       hold the frequency by hand, in the browser
  wtg-gym suites                                     the suites of scenarios
  wtg-gym evaluate --suite standard-v1               score the baselines of version v1
  wtg-gym leaderboard --suite paper                  rank the baselines on the paper's cases
  wtg-gym reproduce                                  the paper's figures and claims, measured

'wtg-gym COMMAND --help' explains a command and gives examples.
exit codes: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the output's reader is gone
"""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(prog="wtg-gym", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("--version", action="version", version=f"wtg-gym {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in (simulate, play, explore, evaluate, results, submission, suites):
        module.add_commands(commands)
    analyse = add_group(
        commands,
        "analyse",
        summary="equilibria, margins and modes of the system, omissions, parameters, the error of the time step",
        description="Analyses the system, and measures what its model leaves out, what follows its parameters, and the "
        "error of the time step.",
    )
    for module in (statics, small_signal, physics, aggregation, accuracy, influence, estimation):
        module.add_commands(analyse)
    for module in (reproduce, compare, environment, parameters, bench, warmup):
        module.add_commands(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments without the program's name; None takes those of the process.

    Returns:
        The exit code: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the output's reader is gone.
    """
    arguments = argparse.Namespace(after_interrupt="nothing was written")
    try:
        build_parser().parse_args(argv, arguments)
        code: int = arguments.run(arguments)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        # Below the ^C of a terminal.
        print(file=sys.stderr)
        note(f"wtg-gym: interrupted; {arguments.after_interrupt}")
        return 130
    except BrokenPipeError:
        # The reader of a pipe has seen enough; the interpreter must not complain when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (ValueError, OSError) as error:
        note(f"wtg-gym: error: {one_line(error)}")
        return 2
    except MemoryError:
        note("wtg-gym: error: there is not enough memory for this")
        return 2


__all__ = ["build_parser", "main"]
