"""`python docs/studies/one_event.py`: entries and a planner side by side in one scenario, as a figure."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from planner import KNOWLEDGE, Planning, plan

from agents.command import (
    FIGURE_FORMATS,
    Parser,
    check_output_file,
    chosen_entries,
    note,
    print_table,
    require_extra,
    run_command,
    suite_name,
)
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.recording import Recording, record, recorded
from wtg_gym.scenarios import SPLITS, get_suite

_DESCRIPTION = """\
Plays one scenario of version v1 with each entry and with a planner, and draws the frequency, the power of all turbines
and the slowest rotor of any group over time, beside the limits at which a run fails."""
_EXAMPLES = """\
examples:
  python docs/studies/one_event.py --entries coordinated-piecewise coordinated-tuned --output event.svg
  python docs/studies/one_event.py --suite gusty-v1 --seed 20003 --entries fast-droop --output event.png"""


def side_by_side(specs: Sequence[str], settings: EnvSettings, seed: int, knowledge: str | None) -> dict[str, Recording]:
    """Return the recordings of entries and of a planner in one scenario, by name; of several seeds the first plays."""
    scenarios = get_suite(settings.suite).scenarios([seed])
    runs: dict[str, Recording] = {}
    for entry in chosen_entries(specs, settings.suite):
        if entry.name not in runs:
            runs[entry.name] = record(entry, settings, scenarios)
    if knowledge is not None:
        note("planning")
        lanes = TaskLanes(replace(settings, action_mode="k+tau", observation_mode="privileged"), 1)
        with closing(lanes.simulator):
            lanes.start([0], scenarios)
            runs[f"planner-{knowledge}"] = recorded(lanes, plan(lanes, Planning(knowledge=knowledge)))
    return runs


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python docs/studies/one_event.py", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--entries", nargs="+", required=True, metavar="ENTRY", help="as for wtg-gym evaluate")
    parser.add_argument("--planner", choices=KNOWLEDGE, help="a planner besides, which knows the wind so")
    parser.add_argument(
        "--suite", type=suite_name, default="paper-v1", metavar="NAME", help="of version v1 (default: paper-v1)"
    )
    parser.add_argument("--split", default="test", choices=SPLITS, help="(default: test)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the scenario (default: 0)")
    parser.add_argument("--output", required=True, metavar="FILE", help=f"figure, .{', .'.join(FIGURE_FORMATS)}")

    def work() -> None:
        given = parser.parse_args(argv)
        require_extra("matplotlib", "python docs/studies/one_event.py")
        output = check_output_file("--output", given.output, tuple(f".{suffix}" for suffix in FIGURE_FORMATS))
        settings = EnvSettings(suite=given.suite, split=given.split)
        runs = side_by_side(given.entries, settings, given.seed, given.planner)
        (scenario,) = get_suite(given.suite).scenarios([given.seed])
        plant = settings.plant()
        from side_by_side import plot_one_event

        from wtg_gym.plotting import save_figure

        save_figure(plot_one_event(scenario, runs, plant), Path(output).with_suffix(""), [output.suffix[1:]])
        note(f"wrote {output}")
        rows = []
        for name, run in runs.items():
            largest = 1000.0 * float(np.nanmax(np.abs(run.frequency_hz - 50.0)))
            slowest = float(np.nanmin(run.rotor_speed_pu))
            rows.append((name, f"{largest:.0f}", f"{slowest:.3f}", f"{run.cost_terms.sum():.1f}"))
        print_table(("entry", "largest deviation [mHz]", "slowest rotor [p.u.]", "cost"), rows)

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
