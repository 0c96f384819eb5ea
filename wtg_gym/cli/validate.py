"""`wtg-gym validate`: traces of another simulator against runs of its case here."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wtg_gym.analysis.case_file import DEFAULT_TOLERANCE, ReferenceCase, read_parameters
from wtg_gym.analysis.replay import Difference, differences, replay, replay_closely
from wtg_gym.analysis.trace_file import BUS_QUANTITIES, MACHINE_QUANTITIES, choose_events, read_trace
from wtg_gym.cli.output import check_page, note, plain_json, print_json, print_table, say, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.files import markdown_table
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import LoadStep

_NAMES = {
    "w": "machine speed",
    "Pe": "active power",
    "Qe": "reactive power",
    "Tm": "mechanical torque",
    "delta": "rotor angle",
    "V": "bus voltage",
    "th": "bus angle",
}
_UNITS = MACHINE_QUANTITIES | BUS_QUANTITIES

#: The coarsest fine step [s].
_COARSEST_S = 0.0025

_DESCRIPTION = """\
Runs the network, machines and events of a parameter file and compares every quantity with a trace of another
simulator. The largest differences of machine speed w, active power Pe and bus voltage V must be within a tolerance;
other quantities are shown. The run with a fine step decides, whose own error is below a tenth of the tolerance; a run
with the default step of the benchmark shows the error of that step.

PARAMS.json  bus, line, shunt, load, gen_static, gens (GENCLS or GENROU), tgov1, sexs and events, as in tests/golden
TRACE.csv    a column t [s], then w…, Pe…, Qe…, Tm…, delta… by machine and V…, th… by bus, in p.u. of the system base
             and rad; rows at any time, the one at the instant of an event showing the state before it

A folder stands for its params.json and every trace beside it.
exit codes: 0 within tolerance, 1 above it, 2 bad input"""

_EXAMPLES = """\
  wtg-gym validate params.json trace.csv --events b
  wtg-gym validate params.json trace_a.csv trace_b.csv --json
  wtg-gym validate tests/golden/*/ --page docs/validation.md"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym validate`."""
    parser = add_command(
        commands,
        "validate",
        run,
        summary="cases of another simulator against its traces; exit code 1 above a tolerance",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument(
        "paths", nargs="+", metavar="PATH", help="PARAMS.json and one or more TRACE.csv, or folders that hold both"
    )
    parser.add_argument(
        "--events",
        metavar="NAME",
        help="event list of the parameter file (default: the only one, or the one the trace's name ends with)",
    )
    parser.add_argument("--page", metavar="FILE", help="Markdown file with markers 'golden' to put the table between")
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON, and nothing else, on stdout: a list for several"
    )


@dataclass(frozen=True)
class _Comparison:
    """One trace against both runs: differences by quantity, with the fine and with the default step."""

    parameters: Path
    trace: Path
    case: ReferenceCase
    events: tuple[LoadStep, ...]
    n_rows: int
    end_s: float
    tolerance: Mapping[str, float]
    fine: Mapping[str, Difference]
    default: Mapping[str, Difference]
    step_s: float
    own_error: Mapping[str, float]

    def agrees(self, quantity: str) -> bool | None:
        """Whether a quantity is within tolerance; None where it is not judged."""
        limit = self.tolerance.get(quantity)
        return None if limit is None else self.fine[quantity].size <= limit

    @property
    def all_agree(self) -> bool:
        return all(self.agrees(quantity) is not False for quantity in self.fine)


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym validate`; return 1 if a difference is above its tolerance."""
    page = check_page("--page", arguments.page, "golden")
    pairs = _pairs([Path(path) for path in arguments.paths])
    found = [_compare(parameters, trace, arguments) for parameters, trace in pairs]
    if page is not None:
        update_page(page, {"golden": _page_table(found)})
    if arguments.json:
        results = [plain_json(_as_json(comparison)) for comparison in found]
        print_json(results[0] if len(results) == 1 else results)
    else:
        for number, comparison in enumerate(found):
            say(*[""] * bool(number))
            _print(comparison)
    return 0 if all(comparison.all_agree for comparison in found) else 1


def _pairs(paths: list[Path]) -> list[tuple[Path, Path]]:
    """Return (parameter file, trace) pairs of the command line."""
    pairs: list[tuple[Path, Path]] = []
    parameters: Path | None = None
    for path in paths:
        if path.is_dir():
            traces = sorted(path.glob("*.csv"))
            if not (path / "params.json").is_file() or not traces:
                raise ValueError(f"the folder {path} must hold params.json and at least one trace in CSV")
            pairs += [(path / "params.json", trace) for trace in traces]
        elif path.suffix.lower() == ".json":
            parameters = path
        elif parameters is None:
            raise ValueError(f"{path}: give the parameter file (.json) before its traces")
        else:
            pairs.append((parameters, path))
    if not pairs:
        raise ValueError(f"{parameters}: give a trace (.csv) to compare with")
    return pairs


def _compare(parameters: Path, trace_path: Path, arguments: argparse.Namespace) -> _Comparison:
    case = read_parameters(parameters)
    events = choose_events(case, trace_path, arguments.events)
    trace, unknown = read_trace(trace_path, case)
    if unknown:
        note(f"{trace_path}: columns that are not compared: {', '.join(unknown)}")
    if case.unused:
        note(f"{parameters}: not used: {', '.join(case.unused)}")
    tolerance = case.tolerance
    columns, step_s, own_error = replay_closely(case, events, trace.time_s, _COARSEST_S, tolerance)
    coarse = replay(case, events, trace.time_s, PlantSettings().simulation_dt)
    fine, default = ({d.quantity: d for d in differences(case, trace, found)} for found in (columns, coarse))
    if not set(fine) & set(tolerance):
        raise ValueError(f"{trace_path} has none of the quantities that are judged: {', '.join(tolerance)}")
    for key, limit in tolerance.items():
        if own_error[key] > limit:
            note(
                f"{trace_path}: the error of {key} is {own_error[key]:.0e} p.u. even with a step of {1e3 * step_s:g} ms"
            )
    rows, end_s = trace.time_s.size, float(trace.time_s[-1])
    return _Comparison(parameters, trace_path, case, events, rows, end_s, tolerance, fine, default, step_s, own_error)


def _print(comparison: _Comparison) -> None:
    network = comparison.case.network
    say(
        f"{comparison.parameters}, {comparison.trace.name}: {len(network.buses)} buses, "
        f"{len(network.machines)} machines, {len(comparison.events)} events, {comparison.n_rows} rows to "
        f"{comparison.end_s:g} s",
        "",
    )
    default_ms = 1e3 * PlantSettings().simulation_dt
    header = (
        "largest difference",
        "unit",
        f"step {1e3 * comparison.step_s:g} ms",
        "own error",
        "where",
        f"default step {default_ms:g} ms",
        "tolerance",
        "verdict",
    )
    rows = [
        (
            _NAMES[key],
            _UNITS[key],
            f"{d.size:.1e}",
            f"{comparison.own_error[key]:.0e}",
            f"{d.column} at {d.time_s:g} s",
            f"{comparison.default[key].size:.1e}",
            f"{comparison.tolerance[key]:.0e}" if key in comparison.tolerance else "–",
            {None: "–", True: "agrees", False: "DIFFERS"}[comparison.agrees(key)],
        )
        for key, d in comparison.fine.items()
    ]
    print_table(header, rows, left=(0, 1, 4, 7))


def _page_table(found: Iterable[_Comparison]) -> str:
    judged = tuple(DEFAULT_TOLERANCE)
    default_ms = 1e3 * PlantSettings().simulation_dt
    shares = (f"{key} (tolerance)" for key in judged)
    header = ("case", "trace", "machines", *shares, "step", f"at {default_ms:g} ms: {', '.join(judged)}", "verdict")
    rows = []
    for c in found:
        cells = [f"{c.fine[k].size:.1e} ({c.tolerance[k]:.0e})" if k in c.fine else "–" for k in judged]
        coarse = ", ".join(f"{c.default[k].size:.1e}" for k in judged if k in c.default)
        models = sorted({"GENCLS" if machine.classical else "GENROU" for machine in c.case.network.machines})
        machines = f"{len(c.case.network.machines)} ({', '.join(models)})"
        verdict = "agrees" if c.all_agree else "**differs**"
        step = f"{1e3 * c.step_s:g} ms"
        rows.append((c.parameters.parent.name, c.trace.name, machines, *cells, step, coarse, verdict))
    return f"Largest differences [p.u.].\n\n{markdown_table(header, rows)}"


def _as_json(comparison: _Comparison) -> dict[str, Any]:
    return {
        "parameters": str(comparison.parameters),
        "trace": str(comparison.trace),
        "n_machines": len(comparison.case.machine_keys),
        "n_rows": comparison.n_rows,
        "events": [dataclasses.asdict(event) for event in comparison.events],
        "step_s": comparison.step_s,
        "default_step_s": PlantSettings().simulation_dt,
        "differences": [
            {
                "quantity": key,
                "unit": _UNITS[key],
                "largest": d.size,
                "own_error": comparison.own_error[key],
                "column": d.column,
                "time_s": d.time_s,
                "largest_at_default_step": comparison.default[key].size,
                "tolerance": comparison.tolerance.get(key),
                "agrees": comparison.agrees(key),
            }
            for key, d in comparison.fine.items()
        ],
        "agrees": comparison.all_agree,
    }
