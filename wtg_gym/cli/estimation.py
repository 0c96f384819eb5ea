"""`wtg-gym analyse estimate`: inertia and droop from a record of the frequency."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from wtg_gym.analysis.estimation_study import (
    UNKNOWNS,
    EstimationStudy,
    Noise,
    estimation_table,
    study_own_run,
    study_recorded_run,
)
from wtg_gym.cli.output import check_page, give_text
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.progress import Progress

_DESCRIPTION = f"""\
Finds parameters of a plant from a record of its frequency: least squares by Gauss-Newton, with derivatives from
wtg_gym.gradients, and 95 % confidence intervals from the Jacobian at the solution. The record is that of a known
plant with noise, so that the answer can be checked: the noise is drawn many times, and the table counts how many
intervals hold the true value. About 95 in 100 should. Two quantities that a record hardly tells apart, such as the
inertia of machines and that of converters, have long intervals.

Without --recorded the run is one of the benchmark's plant after a load step. With it, it is the trace of another
simulator, such as ANDES: WTG groups under a constant set-point stand for the classical machines at --units-at.

unknowns: inertia (kinetic energy of all synchronous machines), and the parameters that wtg_gym.gradients knows, such as
{", ".join(UNKNOWNS[1:])}; docs/gradients.md.
The gradient is compiled once (half a minute); a draw takes a second or two."""

_EXAMPLES = """\
  wtg-gym analyse estimate --draws 5
  wtg-gym analyse estimate --unknown inertia control.droop_gain_pu --noise 5 --json
  wtg-gym analyse estimate --recorded tests/golden/grid-forming/params.json tests/golden/grid-forming/a.csv"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse estimate`."""
    parser = add_command(commands, "estimate", run, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "--unknown",
        nargs="+",
        default=list(UNKNOWNS),
        metavar="NAME",
        help=f"what to find (default: {' '.join(UNKNOWNS)})",
    )
    parser.add_argument("--noise", type=float, default=1.0, metavar="MHZ", help="of the record [mHz] (default: 1)")
    parser.add_argument("--draws", type=int, default=100, metavar="N", help="of the noise (default: 100)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the noise (default: 0)")
    parser.add_argument(
        "--duration", type=float, metavar="S", help="of the record [s] (default: 20; 25 with --recorded)"
    )
    own = parser.add_argument_group("a run of the benchmark's plant")
    own.add_argument("--power", type=float, metavar="MW", help="load step at bus 4 after 1 s (default: 60)")
    case = parser.add_argument_group("a trace of another simulator")
    case.add_argument("--recorded", nargs=2, metavar=("PARAMS.json", "TRACE.csv"), help="as for 'wtg-gym compare'")
    case.add_argument(
        "--events", metavar="NAME", help="event list of the parameter file (default: as 'wtg-gym compare')"
    )
    case.add_argument("--column", metavar="NAME", help="of the trace: a machine's speed (default: w1)")
    case.add_argument("--units-at", type=int, metavar="BUS", help="classical machines to be WTG groups (default: 2)")
    out = parser.add_argument_group("output")
    out.add_argument(
        "--page",
        metavar="FILE",
        help="Markdown file with markers 'estimate', or 'estimate-recorded', to put the table between",
    )
    out.add_argument("--json", action="store_true", help="print the study as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse estimate`."""
    section = "estimate" if arguments.recorded is None else "estimate-recorded"
    page = check_page("--page", arguments.page, section)
    study = _study(arguments)
    text = f"{_summary(study)}\n\n{estimation_table(study)}"
    give_text(page, section, text, dataclasses.asdict(study), as_json=arguments.json)
    return 0


def _study(arguments: argparse.Namespace) -> EstimationStudy:
    options = {"power": "power_mw", "events": "events", "column": "column", "units_at": "bus", "duration": "duration_s"}
    given = {to: getattr(arguments, option) for option, to in options.items() if getattr(arguments, option) is not None}
    of_case = [option for option in ("events", "column", "units_at") if getattr(arguments, option) is not None]
    if arguments.recorded is None and of_case:
        raise ValueError(f"--{of_case[0].replace('_', '-')} is for --recorded")
    if arguments.recorded is not None and arguments.power is not None:
        raise ValueError("--power is that of a run of the benchmark's plant: leave out --recorded")
    shared = {"noise": Noise(arguments.noise, arguments.draws, arguments.seed), **given}
    with Progress("draws") as progress:
        shared["on_progress"] = lambda done: progress.update("noise", done, arguments.draws)
        if arguments.recorded is None:
            return study_own_run(arguments.unknown, **shared)
        parameters, trace = (Path(path) for path in arguments.recorded)
        return study_recorded_run(parameters, trace, arguments.unknown, **shared)


def _summary(study: EstimationStudy) -> str:
    most = f" Most correlated: {' and '.join(study.correlated)} ({study.correlation:.2f})." if study.correlated else ""
    return (
        f"Record: {study.record}, {study.n_values} values in {study.duration_s:g} s. White noise: {study.noise_mhz:g} "
        f"mHz, drawn {study.n_draws} times (seed {study.seed}). First search: {study.n_runs} runs, residuals "
        f"{study.residual_mhz:.3g} mHz.{most}"
    )
