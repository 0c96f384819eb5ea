"""The command `wtg-gym`: one module a command or group of commands.

Exit codes: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the output's reader is gone. Results go to
stdout; progress, notes and errors go to stderr.
"""

import os
import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError

from wtg_gym import __version__
from wtg_gym.cli.output import note
from wtg_gym.files import one_line
from wtg_gym.ranges import require_count

#: The commands in the order of the help: where each is, and what it does.
_COMMANDS = {
    "simulate": ("simulate:simulate_scenario", "one scenario under one or several laws: key figures, figure"),
    "play": ("play:play", "hold the frequency by hand, in the browser, against the reference"),
    "evaluate": ("evaluate:evaluate", "score entries on scenarios of a suite"),
    "leaderboard": ("evaluate:leaderboard", "rank entries on a suite and write the table to a README"),
    "report": ("report:report", "one page about one entry: score, worst scenarios, operators' tests, damping"),
    "results": ("evaluate:results_app", "stored results: compute them again and compare"),
    "submission": ("submission:app", "policies of others: write a template, check a folder, score it in isolation"),
    "suites": ("suites:suites", "the suites of scenarios, or one scenario"),
    "grid": ("grid:app", "grids of your own: bring one in, check it"),
    "warmup": ("warmup:warmup", "compile the simulator before its first use"),
}

#: Words of a command line at most; all scenarios of a split by their seeds are 300.
_MOST_WORDS = 2000

_DESCRIPTION = """\
Primary frequency regulation with grid-forming wind turbine generators on the modified IEEE 14-bus system and other
grids: simulate single scenarios, score controllers on frozen suites of scenarios, and rank them."""

_EPILOGUE = """\
first steps:
  wtg-gym simulate                              the paper's load increase
  wtg-gym simulate --strategy all --plot a.png  under every law, drawn
  wtg-gym play                                  hold the frequency by hand
  wtg-gym suites                                the suites of scenarios
  wtg-gym evaluate --suite standard-v1          score the baselines of v1
  wtg-gym leaderboard --suite paper             rank them on the paper's cases

'wtg-gym COMMAND --help' explains a command and gives examples.
exit codes: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 the
reader of the output is gone
"""


def build_app(words: Sequence[str]) -> App:
    """Return the program for a command line; of the commands only the one that it names is imported.

    Each needs other packages, some of which take half a second to import.
    """
    named = next((word for word in words if not word.startswith("-")), None)
    app = App(
        name="wtg-gym",
        version=f"wtg-gym {__version__}",
        help=_DESCRIPTION,
        help_format="plaintext",
        suppress_keyboard_interrupt=False,
    )
    if named is None:
        app.help_epilogue = _EPILOGUE
    for order, (name, (place, summary)) in enumerate(_COMMANDS.items()):
        # Its own docstring is the longer help of a command.
        text = {} if name == named else {"help": summary}
        app.command(f"wtg_gym.cli.{place}", name=name, sort_key=order, **text)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code, see above."""
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        # Twice as many take four times as long.
        require_count("the command line", len(words), _MOST_WORDS)
        code = build_app(words)(words, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
        return int(code or 0)
    except KeyboardInterrupt:
        # Below the ^C of a terminal.
        print(file=sys.stderr)
        note("wtg-gym: interrupted")
        return 130
    except BrokenPipeError:
        # The reader of a pipe has seen enough; the interpreter must not complain when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except SystemExit as end:
        # What rich makes of it, which prints the help.
        if isinstance(end.__context__, BrokenPipeError):
            return 141
        raise
    except CycloptsError as error:
        command = " ".join(("wtg-gym", *(error.command_chain or ())))
        note(f"wtg-gym: error: {one_line(error)} (see: {command} --help)")
        return 2
    except (ValueError, OSError) as error:
        note(f"wtg-gym: error: {one_line(error)}")
        return 2
    except MemoryError:
        note("wtg-gym: error: there is not enough memory for this")
        return 2
