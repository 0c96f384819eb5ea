"""`wtg-gym verify`: results computed anew."""

from __future__ import annotations

import argparse

from wtg_gym.cli.draw import read_secret
from wtg_gym.cli.output import Progress, note, print_json, print_table, say
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.scores import DEFAULT_ENTRIES, add_worker_options, chosen_entries, chosen_workers
from wtg_gym.evaluation import Results
from wtg_gym.evaluation.verification import departures, verify

_SHOWN = 20

_DESCRIPTION = """\
Evaluates the entries of a results file again, on the same scenarios with the same settings, and compares every number
of every episode to the last bit, the policies' sha256, kinds and laws, and the suite's hash. Says that the results are
identical, or what differs; the exit code is then 1. Other versions of source code or packages, and other texts about an
entry, are named, but are no difference by themselves: laws give the same bits on one kind of processor, a policy's last
digits may depend on onnxruntime. The environment's fingerprint says whether this machine computes the same as the one
before. Where the results are not those of the benchmark, with fewer scenarios, shorter episodes or weights of one's
own, that is named too."""
_EXAMPLES = """\
  wtg-gym verify results/standard-test.json --entries baselines policies
  wtg-gym verify results/paper-test.json --json"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym verify`."""
    parser = add_command(
        commands,
        "verify",
        run,
        summary="compute results anew, and say whether they are identical",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("results", metavar="RESULTS.json", help="what evaluate or leaderboard wrote, its CSV beside it")
    parser.add_argument(
        "--entries",
        nargs="+",
        default=[DEFAULT_ENTRIES],
        metavar="SPEC",
        help="as for evaluate, without archives of Stable-Baselines3 (default: baselines)",
    )
    parser.add_argument(
        "--secret-file", metavar="FILE", help="also check that the seeds of a verification were drawn with this secret"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")
    add_worker_options(parser)
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym verify`."""
    stored = Results.read(arguments.results)
    secret = None if arguments.secret_file is None else read_secret(arguments.secret_file)
    workers = chosen_workers(arguments)
    entries = chosen_entries(arguments.entries)
    with Progress("episodes") as progress:
        found = verify(
            stored, entries, secret=secret, n_threads=arguments.threads, workers=workers, on_progress=progress.update
        )
    if arguments.json:
        print_json(
            {
                "identical": not found.differences,
                "differences": [difference._asdict() for difference in found.differences],
                "circumstances": [difference._asdict() for difference in found.circumstances],
                "departures": departures(stored),
                "numbers": found.n_numbers,
            }
        )
        return 1 if found.differences else 0
    for difference in found.circumstances:
        note(f"{difference.where} was {difference.stored}, is {difference.now}")
    for text in departures(stored):
        note(f"not the benchmark's own: {text}")
    if stored.draw is not None and secret is None:
        note("whether these seeds were drawn or chosen is not known: check them with --secret-file")
    if not found.differences:
        say(f"identical: {found.n_numbers} values of {len(stored.episodes)} episodes")
        return 0
    say(f"not identical: {len(found.differences)} differences, the first {min(_SHOWN, len(found.differences))}", "")
    print_table(("where", "stored", "now"), found.differences[:_SHOWN], left=(0, 1, 2))
    return 1


__all__ = ["add_commands", "run"]
