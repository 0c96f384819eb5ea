"""`wtg-gym suites`: which scenarios there are."""

from __future__ import annotations

import argparse
from typing import Any

from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.scenario import describe_scenario
from wtg_gym.scenarios import FROZEN_HASHES, SPLITS, SUITES, Suite, get_suite

_DESCRIPTION = """\
Lists the frozen suites of scenarios with their seeds and hashes, shows or dumps one scenario, or recomputes the hashes.
Train on the seeds of the split "train", select on "validation", rank on "test". A suite never changes: another hash is
another version of the benchmark."""

_EXAMPLES = """\
  wtg-gym suites                                       all suites
  wtg-gym suites standard                              one suite and what its scenarios are drawn from
  wtg-gym suites standard --seed 20003                 one scenario in words
  wtg-gym suites standard --seed 20003 --json > s.json the same as a file for `wtg-gym simulate --scenario s.json`
  wtg-gym suites --check                               do the hashes still hold here?"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym suites`."""
    parser = add_command(
        commands,
        "suites",
        run,
        summary="the suites of scenarios, one scenario, or a check of the hashes",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help=f"one suite: {', '.join(SUITES)} (default: all)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--seed", type=int, metavar="N", help="show the scenario of this seed of the suite")
    what.add_argument(
        "--check", action="store_true", help="compare the hashes with the frozen ones; exit 1 if one differs"
    )
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym suites`; return 1 if a hash differs from the frozen one."""
    suites = list(SUITES.values()) if arguments.name is None else [get_suite(arguments.name)]
    if arguments.seed is not None:
        if arguments.name is None:
            raise ValueError(f"--seed {arguments.seed} needs a suite: wtg-gym suites NAME --seed {arguments.seed}")
        return _show_scenario(suites[0], arguments.seed, as_json=arguments.json)
    if arguments.check:
        return _check(suites, as_json=arguments.json)
    if arguments.json:
        print_json([_summary(suite) for suite in suites])
    elif arguments.name is None:
        _print_suites(suites)
    else:
        _print_suite(suites[0])
    return 0


def _show_scenario(suite: Suite, seed: int, *, as_json: bool) -> int:
    scenario = suite.scenario(seed)
    if as_json:
        print_json(scenario.to_dict())
    else:
        say(*describe_scenario(scenario))
    return 0


def _check(suites: list[Suite], *, as_json: bool) -> int:
    rows = [
        {"name": s.name, "hash": s.hash, "frozen": FROZEN_HASHES[s.name], "agrees": s.hash == FROZEN_HASHES[s.name]}
        for s in suites
    ]
    differing = [str(row["name"]) for row in rows if not row["agrees"]]
    if as_json:
        print_json(rows)
    else:
        print_table(
            ("suite", "hash", ""), [(str(r["name"]), str(r["hash"]), "ok" if r["agrees"] else "DIFFERS") for r in rows]
        )
    if differing:
        note(f"wtg-gym: the hash of {', '.join(differing)} differs from the frozen one: scores here cannot be compared")
    return int(bool(differing))


def _summary(suite: Suite) -> dict[str, Any]:
    distribution = suite.distribution
    return {
        "name": suite.name,
        "description": suite.description,
        "hash": suite.hash,
        "duration_s": suite.duration_s,
        "splits": {split: [suite.seeds(split).start, suite.seeds(split).stop - 1] for split in SPLITS},
        "cases": [case.name for case in suite.cases],
        "distribution": None if distribution is None else distribution.to_dict(),
    }


def _seeds(suite: Suite, split: str) -> str:
    seeds = suite.seeds(split)
    return f"{seeds.start} … {seeds.stop - 1}"


def _print_suites(suites: list[Suite]) -> None:
    header = ("suite", "hash", "length [s]", *(f"{split} seeds" for split in SPLITS), "test runs")
    rows = [
        (
            suite.name,
            suite.hash[:12],
            f"{suite.duration_s:g}",
            *(_seeds(suite, split) for split in SPLITS),
            str(len(suite.test)),
        )
        for suite in suites
    ]
    print_table(header, rows, left=(0, 1))
    say("")
    for suite in suites:
        say(f"{suite.name:<10} {suite.description}")


def _print_suite(suite: Suite) -> None:
    say(f"suite {suite.name}: {suite.description}")
    say(f"  hash         {suite.hash}")
    say(f"  length       {suite.duration_s:g} s")
    for split in SPLITS:
        say(f"  {split:<12} {len(suite.seeds(split))} scenarios, seeds {_seeds(suite, split)}")
    for seed, case in enumerate(suite.cases):
        say(f"  case {seed:<7} {case.name}")
    if suite.distribution is not None:
        say("drawn from:")
        for key, value in suite.distribution.to_dict().items():
            say(f"  {key:<26} {value}")
