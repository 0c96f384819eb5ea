"""The command `wtg-gym`: one module a command or group of commands.

Exit codes: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the output's reader is gone. Results go to
stdout; progress, notes and errors go to stderr.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module

from wtg_gym import __version__
from wtg_gym.cli.output import note, one_line
from wtg_gym.cli.parser import Commands, Parser

#: What commands do, by module and name, in the order of the help.
_COMMANDS = {
    "simulate": {"simulate": "one scenario under one or several strategies: key figures, figure, traces"},
    "live": {
        "play": "hold the frequency by hand, in the browser, against the reference",
    },
    "evaluate": {
        "evaluate": "score entries on scenarios of a suite",
        "leaderboard": "rank entries on a suite and write the table to a README",
    },
    "results_command": {
        "results": "stored results: show them, compute them again, compare; all suites, other sensors and weights"
    },
    "submission": {"submission": "policies of others: write a template, check a folder, score it in isolation"},
    "suites_command": {"suites": "the suites of scenarios, one scenario, or a check of the hashes"},
    "reproduce": {"reproduce": "the paper's figures and claims, measured"},
    "warmup": {"warmup": "compile the simulator before its first use"},
}

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


def build_parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of a command line; of the commands only the one that it names has more than a summary.

    Each needs other packages, some of which take half a second to import.
    """
    words = [word for word in argv if not word.startswith("-")]
    parser = Parser(prog="wtg-gym", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("--version", action="version", version=f"wtg-gym {__version__}")
    _add(parser.add_subparsers(title="commands", metavar="COMMAND", required=True), _COMMANDS, words)
    return parser


def _add(commands: Commands, modules: Mapping[str, Mapping[str, str]], words: Sequence[str]) -> None:
    for module, summaries in modules.items():
        if not words or words[0] not in summaries:
            for name, summary in summaries.items():
                commands.add_parser(name, help=summary)
        else:
            import_module(f"wtg_gym.cli.{module}").add_commands(commands)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        The exit code: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the output's reader is gone.
    """
    arguments = argparse.Namespace(after_interrupt="nothing was written")
    try:
        given = sys.argv[1:] if argv is None else argv
        build_parser(given).parse_args(given, arguments)
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
