"""`python -m agents.oracle`: how much better than the reference can anything be?"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from agents.command import run_command
from agents.foresight import Search, find_oracle, read_gains
from agents.linear import make_linear_feedback
from agents.simple_policies import simple_policies
from wtg_gym.cli.output import check_output_file, check_output_folder, note, print_json, print_table, say
from wtg_gym.cli.parser import Parser
from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.evaluation import load_entries
from wtg_gym.evaluation.oracle import OracleCosts

_DESCRIPTION = """\
How much better than the reference can anything be? Policies found by search, with and without foresight, by CMA-ES.

linear     tunes one linear feedback of a group's own observation on training scenarios, judges it on the validation
           scenarios, and writes it as an entry of the leaderboard: what a simple learner must beat
simple     plays constant actions and actions that jump with the sign of one observation: none may gain much
foresight  searches every scenario on its own, knowing all of it; the cheapest that is found is the oracle's cost"""
_LINEAR = """\
Tunes a = clip(G o + b) of a group's own observation o, the same G and b in every group, on training scenarios. Writes
entry.toml and policy.onnx, which make the folder an entry of the leaderboard, and with --gains the gains, how they were
found, and what the policy costs on all validation scenarios."""
_FORESIGHT = """\
Searches for every scenario on its own, knowing all of it, the cheapest course of actions over time (knots, linear in
between), and with --gains the cheapest course on top of a linear feedback whose gains are searched as well. The
oracle's cost of a scenario is the least of these, of the reference's, and of the given entries'. It is what was found,
not a bound: a longer search may find better.

Written are <suite>-<split>.csv with a row per scenario, and <suite>-<split>.json with suite, settings and search. The
leaderboard's share of the gap that an entry closes comes from such files in wtg_gym/evaluation/oracle_costs.

Finished searches are kept in the folder --parts, chunk by chunk: the same command goes on after an interruption and
writes the same files as an undisturbed one on the same machine; another one, with more scenarios or entries, searches
only what is missing. A change of the physics, the cost or the search makes them stale."""
_EXAMPLES = """\
examples:
  python -m agents.oracle linear --output agents/policies/linear-feedback --gains agents/linear_feedback_gains.json
  wtg-gym evaluate --entries agents/policies/linear-feedback --suite standard"""
_FORESIGHT_EXAMPLES = """\
examples:
  python -m agents.oracle foresight --split validation --scenarios 24 --output results
  python -m agents.oracle foresight --gains agents/linear_feedback_gains.json \\
      --entries agents/policies/* --output wtg_gym/evaluation/oracle_costs"""


_SIMPLE = """\
Plays policies without any thought: a grid of constant actions, and actions that jump with the sign of one observation
around its quartiles under the reference, between the limits (bang-bang) or by a part of that (relay). Neither constants
nor bang-bang may beat the reference by much, else the benchmark would reward a mere change of settings."""


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="python -m agents.oracle", description=_DESCRIPTION)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    linear = commands.add_parser("linear", help="tune a linear feedback", description=_LINEAR, epilog=_EXAMPLES)
    linear.set_defaults(run=_linear)
    linear.add_argument("--output", required=True, metavar="FOLDER", help="folder of the entry; made if missing")
    linear.add_argument("--gains", metavar="FILE", help="JSON file to write the gains to (default: none)")
    linear.add_argument("--name", default="linear-feedback", help="of the entry (default: linear-feedback)")
    linear.add_argument("--authors", nargs="+", default=[], metavar="NAME", help="who tuned it")
    linear.add_argument("--scenarios", type=int, default=64, metavar="N", help="training scenarios (default: 64)")
    _add_search_options(linear)
    _add_shared_options(linear)
    simple = commands.add_parser("simple", help="play constant and bang-bang actions", description=_SIMPLE)
    simple.set_defaults(run=_simple)
    simple.add_argument("--split", choices=("validation", "test"), default="validation", help="(default: validation)")
    simple.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    _add_shared_options(simple)
    foresight = commands.add_parser(
        "foresight", help="search every scenario", description=_FORESIGHT, epilog=_FORESIGHT_EXAMPLES
    )
    foresight.set_defaults(run=_foresight)
    foresight.add_argument("--output", required=True, metavar="FOLDER", help="folder of the result; made if missing")
    foresight.add_argument("--split", choices=("validation", "test"), default="test", help="(default: test)")
    foresight.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    foresight.add_argument("--gains", metavar="FILE", help="what `linear` wrote: search on top of it as well")
    foresight.add_argument(
        "--entries",
        nargs="+",
        default=[],
        metavar="SPEC",
        help="known policies, which an oracle must not be worse than",
    )
    foresight.add_argument(
        "--chunk", type=int, default=25, metavar="N", help="scenarios searched and kept together (default: 25)"
    )
    foresight.add_argument(
        "--parts",
        default="results/oracle-parts",
        metavar="FOLDER",
        help="where finished chunks are kept (default: results/oracle-parts)",
    )
    _add_search_options(foresight)
    _add_shared_options(foresight)
    return parser


def _add_search_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--action-mode", choices=tuple(ACTION_MODES), default="k+tau", help="(default: k+tau)")
    parser.add_argument("--generations", type=int, default=150, metavar="N", help="of a search (default: 150)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the search (default: 0)")


def _add_shared_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--suite", metavar="NAME", default="standard", help="(default: standard)")
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def _linear(given: argparse.Namespace) -> None:
    output = check_output_folder("--output", given.output)
    data = make_linear_feedback(
        output,
        gains_file=check_output_file("--gains", given.gains, (".json",)),
        suite=given.suite,
        action_mode=given.action_mode,
        n_scenarios=given.scenarios,
        generations=given.generations,
        seed=given.seed,
        name=given.name,
        authors=given.authors,
        n_threads=given.threads,
    )
    note(f"wrote {output}" if given.gains is None else f"wrote {output} and {given.gains}")
    if given.json:
        print_json(data)
        return
    rows = [
        (split, data[split]["scenarios"], data[split]["reference"], data[split]["policy"])
        for split in ("training", "validation")
    ]
    print_table(
        ("split", "scenarios", "reference's mean cost", "linear feedback's", "difference [%]"),
        [(split, str(n), f"{ref:.2f}", f"{cost:.2f}", _difference(cost, ref)) for split, n, ref, cost in rows],
    )


def _simple(given: argparse.Namespace) -> None:
    reference, policies = simple_policies(given.suite, given.split, given.scenarios, given.threads)
    if given.json:
        print_json({"reference": reference, "policies": [asdict(policy) for policy in policies]})
        return
    shown = [
        row for family in ("constant", "bang-bang", "relay") for row in [p for p in policies if p.family == family][:3]
    ]
    counts = Counter(policy.family for policy in policies)
    say(
        f"suite {given.suite}, {given.split}: mean cost of the reference {reference:.2f}; the best three of each kind",
        "",
    )
    print_table(
        ("kind", "tried", "policy", "mean cost", "difference [%]"),
        [
            (p.family, str(counts[p.family]), p.description, f"{p.cost:.2f}", _difference(p.cost, reference))
            for p in shown
        ],
    )


def _foresight(given: argparse.Namespace) -> None:
    output = check_output_folder("--output", given.output)
    parts = check_output_folder("--parts", given.parts)
    search = Search(
        suite=given.suite,
        split=given.split,
        n_scenarios=given.scenarios,
        action_mode=given.action_mode,
        generations=given.generations,
        chunk=given.chunk,
        seed=given.seed,
        gains=None if given.gains is None else read_gains(Path(given.gains), given.action_mode),
    )
    entries = [entry for spec in given.entries for entry in load_entries(spec)]
    costs = find_oracle(search, entries, parts, given.threads)
    for path in costs.write(output):
        note(f"wrote {path}")
    rows = _table(costs)
    if given.json:
        print_json([{"costs": name, "mean_cost": mean, "cheapest_in": count} for name, mean, count in rows])
        return
    say(f"suite {costs.suite} ({costs.suite_hash[:12]}), {costs.split}: {len(costs.seeds)} scenarios", "")
    reference = rows[0][1]
    print_table(
        ("costs", "mean", "difference [%]", "cheapest in"),
        [(name, f"{mean:.2f}", _difference(mean, reference), str(count)) for name, mean, count in rows],
    )


def _table(costs: OracleCosts) -> list[tuple[str, float, int]]:
    """Name, mean cost, and in how many scenarios nothing was cheaper; the reference first, the oracle last."""
    columns = {"reference": costs.reference, **costs.found, "oracle": costs.oracle}
    return [
        (name.replace("_", " "), float(np.mean(values)), int(np.sum(np.array(values) <= np.array(costs.oracle))))
        for name, values in columns.items()
    ]


def _difference(cost: float, reference: float) -> str:
    return f"{100.0 * (cost / reference - 1.0):+.1f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = _parser()

    def work() -> None:
        given = parser.parse_args(argv)
        given.run(given)

    return run_command(work, "the same command goes on from the searches that are finished")


if __name__ == "__main__":
    sys.exit(main())
