"""`wtg-gym suites`: the suites and their scenarios, the latter in words too."""

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from wtg_gym.cli.options import Json, SuiteName, Whole
from wtg_gym.cli.output import print_json, print_table, say

if TYPE_CHECKING:
    from wtg_gym.physics.scenario import Scenario
    from wtg_gym.scenarios import Suite


def suites(name: SuiteName | None = None, /, *, seed: Whole | None = None, json: Json = False) -> int:
    """List the frozen suites of scenarios, or show one of them or one scenario.

    Train on the seeds of the split "train", select on "validation", rank on "test". A suite never changes: another hash
    is another version of the benchmark.

    examples:
      wtg-gym suites                                       all suites
      wtg-gym suites standard                              what its scenarios are drawn from, as JSON
      wtg-gym suites standard --seed 20003                 one scenario in words
      wtg-gym suites standard --seed 20003 --json > s.json the same as a file for `wtg-gym simulate --scenario s.json`

    Args:
        name: one suite; default: all
        seed: show the scenario of this seed of the suite
    """
    from wtg_gym.scenarios import FROZEN_HASHES, SPLITS, SUITES, get_suite

    chosen = list(SUITES.values()) if name is None else [get_suite(name)]
    if seed is not None:
        if name is None:
            raise ValueError(f"--seed {seed} needs a suite: wtg-gym suites NAME --seed {seed}")
        scenario = chosen[0].scenario(seed)
        if json:
            print_json(scenario.to_dict())
        else:
            say(*describe_scenario(scenario, chosen[0]))
    elif json or name is not None:
        print_json([_summary(suite) for suite in chosen])
    else:
        header = ("suite", "hash", "length [s]", *(f"{split} seeds" for split in SPLITS), "test runs")
        rows = []
        for suite in chosen:
            seeds = (f"{suite.seeds(split).start} … {suite.seeds(split).stop - 1}" for split in SPLITS)
            digest, n_runs = FROZEN_HASHES[suite.name][:12], str(len(suite.test))
            rows.append((suite.name, digest, f"{suite.duration_s:g}", *seeds, n_runs))
        print_table(header, rows, left=(0, 1))
        width = max(len(suite.name) for suite in chosen)
        say("", *(f"{suite.name:<{width}} {suite.description}" for suite in chosen))
    return 0


def _summary(suite: "Suite") -> dict[str, Any]:
    from wtg_gym.scenarios import SPLITS

    return {
        "name": suite.name,
        "environment": suite.env_id,
        "description": suite.description,
        "hash": suite.hash,
        "duration_s": suite.duration_s,
        "splits": {split: [suite.seeds(split).start, suite.seeds(split).stop - 1] for split in SPLITS},
        "cases": [case.name for case in suite.cases],
        "margins": {name: [low, None if math.isinf(high) else high] for name, (low, high) in suite.margins.items()},
        "drawn_from": {name: [draw.to_dict() for draw in draws] for name, draws in suite.drawn_from.items()},
        "benchmark": suite.task.to_dict(),
        "plant": {"groups": [group.to_dict() for group in suite.plant.groups], **suite.plant_data},
        "sensors": None if suite.sensors is None else asdict(suite.sensors),
    }


def describe_scenario(scenario: "Scenario", suite: "Suite") -> list[str]:
    """Return a scenario of a suite in words: wind, grid strength, events and reserve, with units."""
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
        f"  grid         governor droop {droop}, {100.0 * scenario.committed:.3g} % of the machines' units on line, "
        f"inertia of each {100.0 * scenario.inertia_scale:.3g} %, load {100.0 * scenario.load_level:.3g} %",
        f"  load noise   {noise}",
    ]
    if suite.margins:
        lines.append(f"  reserve      {100.0 * suite.margin(scenario):.1f} % of the load, at its least")
    events = sorted(scenario.events, key=lambda event: event.time_s)
    for head, event in zip(["events", *[""] * len(events)], events, strict=False):
        late = " (after the end of the run)" if event.time_s >= scenario.duration_s else ""
        lines.append(f"  {head:<12} {event.time_s:g} s: {event.words}{late}")
    return lines if events else [*lines, "  events       none"]
