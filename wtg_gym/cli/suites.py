"""`wtg-gym suites`: the suites and their scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from wtg_gym.cli.options import Flag, Json, SuiteName, Whole
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.cli.scenario_text import describe_scenario
from wtg_gym.scenarios import FROZEN_HASHES, SPLITS, SUITES, Suite, get_suite


def suites(
    name: SuiteName | None = None, /, *, seed: Whole | None = None, check: Flag = False, json: Json = False
) -> int:
    """List the frozen suites of scenarios, show or dump one scenario, or recompute the hashes.

    Train on the seeds of the split "train", select on "validation", rank on "test". A suite never changes; another hash
    means another version of the benchmark. Suites of version v1 have a grid, sensors and a cost of their own, which are
    shown with a suite.

    examples:
      wtg-gym suites                                       all suites
      wtg-gym suites standard                              one suite and what its scenarios are drawn from
      wtg-gym suites standard --seed 20003                 one scenario in words
      wtg-gym suites standard --seed 20003 --json > s.json the same as a file for `wtg-gym simulate --scenario s.json`
      wtg-gym suites --check                               compare the hashes with the frozen ones

    Args:
        name: one suite; default: all
        seed: show the scenario of this seed of the suite
        check: compare the hashes with the frozen ones; exit 1 if one differs
    """
    chosen = list(SUITES.values()) if name is None else [get_suite(name)]
    if seed is not None:
        if name is None or check:
            raise ValueError(f"--seed {seed} needs a suite, without --check: wtg-gym suites NAME --seed {seed}")
        scenario = chosen[0].scenario(seed)
        if json:
            print_json(scenario.to_dict())
        else:
            say(*describe_scenario(scenario))
        return 0
    if check:
        return _check(chosen, as_json=json)
    if json:
        print_json([_summary(suite) for suite in chosen])
    elif name is None:
        _print_suites(chosen)
    else:
        _print_suite(chosen[0])
    return 0


def _check(suites: list[Suite], *, as_json: bool) -> int:
    # A suite that is not frozen yet may change.
    frozen = {suite.name: FROZEN_HASHES.get(suite.name, suite.hash) for suite in suites}
    rows = [{"name": s.name, "hash": s.hash, "agrees": s.hash == frozen[s.name]} for s in suites]
    differing = [str(row["name"]) for row in rows if not row["agrees"]]
    if as_json:
        print_json(rows)
    else:
        verdicts = [(s.name, s.hash, "DIFFERS" if s.name in differing else "ok") for s in suites]
        print_table(("suite", "hash", ""), verdicts)
    if differing:
        note(f"wtg-gym: the hash of {', '.join(differing)} differs from the frozen one: scores here cannot be compared")
    return int(bool(differing))


def _summary(suite: Suite) -> dict[str, Any]:
    distribution, benchmark = suite.distribution, suite.benchmark
    sensors = None if suite.sensors is None else asdict(suite.sensors)
    return {
        "name": suite.name,
        "environment": benchmark.env_id,
        "description": suite.description,
        "hash": suite.hash,
        "duration_s": suite.duration_s,
        "splits": {split: [suite.seeds(split).start, suite.seeds(split).stop - 1] for split in SPLITS},
        "cases": [case.name for case in suite.cases],
        "distribution": None if distribution is None else distribution.to_dict(),
        "benchmark": benchmark.to_dict(),
        "plant": suite.plant.to_dict(),
        "sensors": sensors,
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
    width = max(len(suite.name) for suite in suites)
    for suite in suites:
        say(f"{suite.name:<{width}} {suite.description}")


def _print_suite(suite: Suite) -> None:
    for key, value in _summary(suite).items():
        if isinstance(value, Mapping):
            say(f"{key}:", *(f"  {name:<26} {_text(own)}" for name, own in value.items()))
        else:
            say(f"{key:<28} {_text(value)}")


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(own)}" for name, own in value.items())
    return "; ".join(map(_text, value)) if isinstance(value, (list, tuple)) else str(value)
