"""`wtg-gym analyse accuracy`: the error of the integration step against its cost."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np

from wtg_gym.analysis import step_error
from wtg_gym.analysis.explicit_methods import METHODS
from wtg_gym.cli import output
from wtg_gym.cli.parser import Commands, add_command, add_output_options
from wtg_gym.cli.suites_command import DRAWN_SUITES, suite_name
from wtg_gym.progress import Progress

_STEPS = ", ".join(f"{1e3 * step:g}" for step in step_error.STEPS)
_DESCRIPTION = f"""\
Integrates random scenarios with several explicit methods and steps, and compares frequency, rotor speed and power of
every WTG group with scipy's DOP853 at rtol 1e-10 on the same right-hand side: the median and the worst error over the
scenarios against the time that a simulated second takes. Without --output only the table is printed.

methods: {", ".join(method.name for method in METHODS)}; steps: {_STEPS} ms"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse accuracy`."""
    parser = add_command(
        commands,
        "accuracy",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym analyse accuracy --scenarios 5\n  wtg-gym analyse accuracy --suite gust --json\n"
        "  wtg-gym analyse accuracy --output docs/validation --page docs/validation.md",
    )
    parser.add_argument(
        "--scenarios", type=int, default=100, metavar="N", help="the first N of the validation split (default: 100)"
    )
    parser.add_argument(
        "--suite", type=suite_name, choices=DRAWN_SUITES, default="standard", help="(default: standard)"
    )
    add_output_options(
        parser,
        output="write the figure 'accuracy' and accuracy.json there",
        page="Markdown file with markers 'accuracy' to put the tables between",
        json="print the study as JSON, and nothing else, on stdout",
    )


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse accuracy`; return 1 if the default step did not stay finite."""
    page = output.check_page("--page", arguments.page, "accuracy")
    folder = output.study_folder(arguments.output)
    with Progress("scenarios") as progress:
        study = step_error.study_accuracy(arguments.scenarios, suite=arguments.suite, on_progress=progress.update)
    data = _as_json(study)
    if folder is not None:
        from wtg_gym.plotting import plot_accuracy

        output.write_study(folder, "accuracy", data, {"accuracy": plot_accuracy(study)}, arguments.formats)
    if page is not None:
        output.update_page(
            page,
            {"accuracy": f"{_summary(study)}\n\n{step_error.order_table(study)}\n\n{step_error.accuracy_table(study)}"},
        )
    if arguments.json:
        output.print_json(data)
    else:
        _print(study)
    return int(not np.isfinite(study.row("RK4", study.default_step_s).frequency_hz).all())


def _summary(study: step_error.AccuracyStudy) -> str:
    chosen = study.row("RK4", study.default_step_s)
    return (
        f"{len(study.seeds)} validation scenarios of the suite {study.suite} under the reference strategy. An error is "
        "the largest of any WTG group over an episode: median / worst scenario. The default, RK4 at "
        f"{1e3 * study.default_step_s:g} ms, is wrong by at most {chosen.frequency_hz.max():.1e} Hz, "
        f"{chosen.rotor_speed_pu.max():.1e} p.u. of rotor speed and {chosen.power_pu.max():.1e} p.u. of power. The "
        f"exact solution itself changes by at most {study.reference_error_hz:.0e} Hz when its tolerance falls a "
        "hundredfold."
    )


def _as_json(study: step_error.AccuracyStudy) -> Any:
    def plain(row: step_error.Accuracy) -> dict[str, Any]:
        data = dataclasses.asdict(row)
        for quantity in ("frequency_hz", "rotor_speed_pu", "power_pu"):
            errors = data[quantity]
            data[quantity] = {"median": np.median(errors), "p95": np.quantile(errors, 0.95), "worst": errors.max()}
        return data

    return output.plain_json(
        {
            "suite": study.suite,
            "seeds": study.seeds,
            "default_step_s": study.default_step_s,
            "smooth_order": study.smooth_order,
            "reference_error_hz": study.reference_error_hz,
            "rows": [plain(row) for row in study.rows],
        }
    )


def _print(study: step_error.AccuracyStudy) -> None:
    output.print_table(step_error.ACCURACY_COLUMNS, [step_error.accuracy_cells(row) for row in study.rows])
    output.say("", f"errors: median / worst of {len(study.seeds)} scenarios; {_summary(study)}")
