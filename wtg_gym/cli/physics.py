"""`wtg-gym analyse physics`: the paper's conclusions in its own plant and in more honest ones."""

from __future__ import annotations

import argparse
import dataclasses

from wtg_gym.analysis.physics_study import COMPARED, FURTHER_SUITES, SUITES_OF_ALL, PhysicsStudy, as_data, study_physics
from wtg_gym.analysis.physics_tables import physics_sections
from wtg_gym.cli.output import check_page, plain_json, print_json, print_table, study_folder, update_page, write_study
from wtg_gym.cli.parser import Commands, add_command, add_output_options
from wtg_gym.evaluation.limited_converters import LimitedPlay, limited_table, play_limited
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.policies.load import load_entries
from wtg_gym.progress import Progress
from wtg_gym.ranges import require_range
from wtg_gym.scenarios import get_suite

#: The suite whose wind brings policies to their converters' limits.
_SUITE = "gust"
_SECTIONS = ("survival", "cases", "parts", "suites", "rotor-energy", "margins", "policies", "loads")

_DESCRIPTION = f"""\
Plays the paper's cases and validation scenarios in plants that add to the paper's what it leaves out, one part at a
time and together; measures how stiffly the groups hold to the grid, what policies do that were trained without limits,
and what loads of constant current or power change. Within five minutes it writes

  physics.json                      all numbers
  load-increase, parts, margins     figures

With --page sections of a Markdown file are renewed, each between <!-- NAME:start --> and <!-- NAME:end -->.
Sections: {", ".join(_SECTIONS)}"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse physics`."""
    parser = add_command(
        commands,
        "physics",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym analyse physics --scenarios 10\n"
        "  wtg-gym analyse physics --output docs/physics --formats svg --page docs/physics.md",
    )
    parser.add_argument(
        "--scenarios", type=int, default=100, metavar="N", help="validation scenarios of each suite (default: 100)"
    )
    parser.add_argument(
        "--entries",
        nargs="+",
        default=["linear-feedback", "ppo-k-0"],
        metavar="NAME",
        help="policies to play with limits (default: linear-feedback ppo-k-0)",
    )
    add_output_options(
        parser,
        output="write the figures and physics.json there",
        page="Markdown file whose sections are renewed",
        json="print physics.json on stdout instead of the table",
    )


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse physics`."""
    most = min(len(get_suite(name).validation) for name in (*SUITES_OF_ALL, *FURTHER_SUITES))
    require_range("the number of scenarios", arguments.scenarios, 1, most, "")
    page = check_page("--page", arguments.page, *_SECTIONS)
    folder = study_folder(arguments.output)
    entries = [entry for name in (REFERENCE_STRATEGY, *arguments.entries) for entry in load_entries(name)]
    with Progress("plants") as progress:
        study = study_physics(arguments.scenarios, progress.update)
    plays = [
        play_limited(entry, _SUITE, arguments.scenarios, limited=limited)
        for entry in entries
        for limited in (False, True)
    ]
    data = plain_json({**as_data(study), "policies": [dataclasses.asdict(play) for play in plays]})
    if folder is not None:
        from wtg_gym import plotting

        figures = {
            "load-increase": plotting.plot_plant_runs(study),
            "parts": plotting.plot_plant_parts(study),
            "margins": plotting.plot_stiffness(study),
        }
        write_study(folder, "physics", data, figures, arguments.formats)
    if page is not None:
        update_page(page, {**physics_sections(study), "policies": limited_table(plays, _SUITE)})
    if arguments.json:
        print_json(data)
    else:
        _print(study, plays)
    return 0


def _print(study: PhysicsStudy, plays: list[LimitedPlay]) -> None:
    rows = [
        (
            plant,
            f"{runs[REFERENCE_STRATEGY].nadir_hz:.3f}",
            *(f"{runs[s].end_s:.1f}" if runs[s].failed else "none" for s in COMPARED),
        )
        for plant, runs in study.increase.items()
    ]
    print_table(("plant", "nadir [Hz]", *(f"{s}: failure [s]" for s in COMPARED)), rows)
    print_table(
        ("policy", "limits", "largest p [p.u.]", "overloaded runs", "failures"),
        [
            (p.entry, "yes" if p.limited else "no", f"{p.peak_power_pu:.2f}", f"{p.overloaded}", f"{p.failures}")
            for p in plays
        ],
        left=(0, 1),
    )
