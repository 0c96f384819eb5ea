"""`wtg-gym suites`: the suites and their scenarios; scenarios as text, for other commands."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.cli.parser import Commands, add_command, add_json_option
from wtg_gym.envs.rendering.diagram import describe_event
from wtg_gym.files import read_json
from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios import FROZEN_HASHES, SPLITS, SUITES, Suite, get_suite
from wtg_gym.scenarios.benchmark import V0

_DESCRIPTION = """\
Lists the frozen suites of scenarios with their seeds and hashes, shows or dumps one scenario, or recomputes the hashes.
Train on the seeds of the split "train", select on "validation", rank on "test". A suite never changes; another hash
means another version of the benchmark. Suites of version v1 have a grid, sensors and a cost of their own, which are
shown with a suite."""

_EXAMPLES = """\
  wtg-gym suites                                       all suites
  wtg-gym suites standard                              one suite and what its scenarios are drawn from
  wtg-gym suites standard --seed 20003                 one scenario in words
  wtg-gym suites standard --seed 20003 --json > s.json the same as a file for `wtg-gym simulate --scenario s.json`
  wtg-gym suites --check                               compare the hashes with the frozen ones"""


def suites_by_version() -> str:
    """Return the names of all suites, those of each version of the benchmark together."""
    found: dict[str, list[str]] = {}
    for suite in SUITES.values():
        found.setdefault(suite.benchmark.version, []).append(suite.name)
    return "; ".join(f"{version}: {', '.join(names)}" for version, names in found.items())


def suite_name(text: str) -> str:
    """Return the full name of the suite that an option names: "faults" is "faults-v1", as v0 has no such suite."""
    full = [name for name, suite in SUITES.items() if name == f"{text}-{suite.benchmark.version}"]
    return full[0] if text not in SUITES and len(full) == 1 else text


def case_seed(name: str | None) -> int:
    """Return the seed of one of the paper's cases, by default of the first; a ValueError lists them."""
    cases = [case.name for case in get_suite("paper").cases]
    name = name or cases[0]
    if name not in cases:
        raise ValueError(f"unknown case {name!r}; known cases: {', '.join(cases)}")
    return cases.index(name)


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym suites`."""
    parser = add_command(commands, "suites", run, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "name",
        nargs="?",
        type=suite_name,
        metavar="NAME",
        help=f"one suite, of {suites_by_version()} (default: all)",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--seed", type=int, metavar="N", help="show the scenario of this seed of the suite")
    what.add_argument(
        "--check", action="store_true", help="compare the hashes with the frozen ones; exit 1 if one differs"
    )
    add_json_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym suites`; return 1 if a hash differs from the frozen one."""
    suites = list(SUITES.values()) if arguments.name is None else [get_suite(arguments.name)]
    if arguments.seed is not None:
        if arguments.name is None:
            raise ValueError(f"--seed {arguments.seed} needs a suite: wtg-gym suites NAME --seed {arguments.seed}")
        scenario = suites[0].scenario(arguments.seed)
        if arguments.json:
            print_json(scenario.to_dict())
        else:
            say(*describe_scenario(scenario))
        return 0
    if arguments.check:
        return _check(suites, as_json=arguments.json)
    if arguments.json:
        print_json([_summary(suite) for suite in suites])
    elif arguments.name is None:
        _print_suites(suites)
    else:
        _print_suite(suites[0])
    return 0


def _check(suites: list[Suite], *, as_json: bool) -> int:
    rows = [
        {"name": s.name, "hash": s.hash, "frozen": (f := FROZEN_HASHES.get(s.name)), "agrees": f in (None, s.hash)}
        for s in suites
    ]
    # A suite that is not frozen yet may change.
    differing = [str(row["name"]) for row in rows if not row["agrees"]]
    verdicts = ["not frozen" if row["frozen"] is None else "ok" if row["agrees"] else "DIFFERS" for row in rows]
    if as_json:
        print_json(rows)
    else:
        print_table(
            ("suite", "hash", ""), [(str(r["name"]), str(r["hash"]), v) for r, v in zip(rows, verdicts, strict=True)]
        )
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
    say(f"suite {suite.name}: {suite.description}")
    say(f"  environment  {suite.benchmark.env_id}")
    say(f"  hash         {suite.hash}")
    say(f"  length       {suite.duration_s:g} s")
    for split in SPLITS:
        say(f"  {split:<12} {len(suite.seeds(split))} scenarios, seeds {_seeds(suite, split)}")
    for seed, case in enumerate(suite.cases):
        say(f"  case {seed:<7} {case.name}")
    if suite.distribution is not None:
        _print_values("drawn from:", suite.distribution.to_dict())
    if suite.benchmark is not V0:
        plant = suite.plant.to_dict()
        groups = [f"{group['n_turbines']:g} turbines at bus {group['bus']}" for group in plant["groups"]]
        governor = ", ".join(f"{key} {value}" for key, value in (plant["governor"] or {}).items())
        _print_values("plant:", {**plant, "groups": ", ".join(groups), "governor": governor})
        _print_values("sensors:", {} if suite.sensors is None else asdict(suite.sensors))
        benchmark = suite.benchmark
        _print_values(
            "task:",
            {
                "anchors": f"0 {benchmark.zero}, 100 {benchmark.hundred}",
                "k_authority": benchmark.k_authority,
                "duty_time_s": benchmark.duty_time_s,
                "weights": ", ".join(f"{key} {value:g}" for key, value in benchmark.weights),
            },
        )


def _print_values(head: str, values: Mapping[str, Any]) -> None:
    say(head)
    for key, value in values.items():
        say(f"  {key:<26} {value}")


# --- scenarios as text -----------------------------------------------------------------------------------------------


def read_scenario(path: Path) -> Scenario:
    """Read a scenario from a JSON file.

    Raises:
        ValueError: the file cannot be read or is not a scenario; the message names the file and what is wrong.
    """
    data = read_json(path, "scenario file")
    try:
        return Scenario.from_dict(data)
    except ValueError as error:
        raise ValueError(f"scenario file {path}: {error}") from error


def scenario_summary(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as JSON-ready data, with its series reduced to the mean wind per group [m/s]."""
    data = scenario.to_dict()
    for series in ("wind_speed", "wind_dt_s", "load_noise_mw"):
        del data[series]
    data["mean_wind_m_s"] = [round(float(mean), 6) for mean in scenario.wind_speed.mean(axis=1)]
    return data


def describe_scenario(scenario: Scenario) -> list[str]:
    """Return a scenario in words: wind, grid strength and events, with units."""
    winds = [
        f"{wind.mean():.4g}" + (f" ({wind.min():.3g} … {wind.max():.3g})" if wind.size > 1 else "")
        for wind in scenario.wind_speed[:4]
    ]
    more = f" and {scenario.n_wtg - 4} more" if scenario.n_wtg > 4 else ""
    droop = "of the case" if scenario.governor_droop is None else f"{scenario.governor_droop:.3g} p.u."
    noise = "none"
    if scenario.load_noise_mw.any():
        noise = f"{scenario.load_noise_mw.std():.2g} MW rms at bus {scenario.load_noise_bus}"
    lines = [
        f"scenario {scenario.name}: {scenario.duration_s:g} s",
        f"  mean wind    {', '.join(winds)}{more} m/s",
        f"  grid         governor droop {droop}, inertia {100.0 * scenario.inertia_scale:.3g} %, "
        f"load {100.0 * scenario.load_level:.3g} %",
        f"  load noise   {noise}",
    ]
    events = sorted(scenario.events, key=lambda event: event.time_s)
    for head, event in zip(["events", *[""] * len(events)], events, strict=False):
        late = " (after the end of the run)" if event.time_s >= scenario.duration_s else ""
        lines.append(f"  {head:<12} {event.time_s:g} s: {describe_event(event)}{late}")
    return lines if events else [*lines, "  events       none"]
