"""`wtg-gym compare`: traces of another simulator against runs of its case here."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from wtg_gym.analysis.case_file import DEFAULT_TOLERANCE, read_parameters
from wtg_gym.analysis.replay import differences, replay, replay_closely
from wtg_gym.analysis.trace_file import BUS_QUANTITIES, MACHINE_QUANTITIES, choose_events, read_trace
from wtg_gym.cli.output import check_page, note, plain_json, print_json, print_table, say, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.files import markdown_table
from wtg_gym.physics.plant import PlantSettings

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
other quantities are shown. The verdict is that of a run with a fine step, whose own error is below a tenth of the
tolerance; a run with the default step of the benchmark shows the error of that step.

PARAMS.json  bus, line, shunt, load, gen_static, gens (GENCLS or GENROU), tgov1, sexs and events, as in tests/golden
TRACE.csv    a column t [s], then w…, Pe…, Qe…, Tm…, delta… by machine and V…, th… by bus, in p.u. of the system base
             and rad; rows at any time, the one at the instant of an event showing the state before it

A folder stands for its params.json and every trace beside it.
exit codes: 0 within tolerance, 1 above it, 2 bad input"""

_EXAMPLES = """\
  wtg-gym compare params.json trace.csv --events b
  wtg-gym compare params.json trace_a.csv trace_b.csv --json
  wtg-gym compare tests/golden/*/ --page docs/validation.md"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym compare`."""
    parser = add_command(commands, "compare", run, description=_DESCRIPTION, examples=_EXAMPLES)
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


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym compare`; return 1 if a difference is above its tolerance."""
    page = check_page("--page", arguments.page, "golden")
    pairs = _pairs([Path(path) for path in arguments.paths])
    found = [_compare(parameters, trace, arguments.events) for parameters, trace in pairs]
    if page is not None:
        update_page(page, {"golden": _page_table(found)})
    if arguments.json:
        results = plain_json(found)
        print_json(results[0] if len(results) == 1 else results)
    else:
        for number, comparison in enumerate(found):
            say(*[""] * bool(number))
            _print(comparison)
    return 0 if all(comparison["agrees"] for comparison in found) else 1


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


def _compare(parameters: Path, trace_path: Path, events_name: str | None) -> dict[str, Any]:
    """Return a trace's comparison with both runs, by the fine and by the default step, as `--json` prints it."""
    case, default_step_s = read_parameters(parameters), PlantSettings().simulation_dt
    events = choose_events(case, trace_path, events_name)
    trace, unknown = read_trace(trace_path, case)
    if unknown:
        note(f"{trace_path}: columns that are not compared: {', '.join(unknown)}")
    if case.unused:
        note(f"{parameters}: not used: {', '.join(case.unused)}")
    columns, step_s, own_error = replay_closely(case, events, trace.time_s, _COARSEST_S, case.tolerance)
    coarse = replay(case, events, trace.time_s, default_step_s)
    fine, default = ({d.quantity: d for d in differences(case, trace, found)} for found in (columns, coarse))
    if not set(fine) & set(case.tolerance):
        raise ValueError(f"{trace_path} has none of the quantities that are judged: {', '.join(case.tolerance)}")
    for key, limit in case.tolerance.items():
        if own_error[key] > limit:
            note(
                f"{trace_path}: the error of {key} is {own_error[key]:.0e} p.u. even with a step of {1e3 * step_s:g} ms"
            )
    rows = [
        {
            "quantity": key,
            "unit": _UNITS[key],
            "largest": d.size,
            "own_error": own_error[key],
            "column": d.column,
            "time_s": d.time_s,
            "largest_at_default_step": default[key].size,
            "tolerance": case.tolerance.get(key),
            "agrees": d.size <= case.tolerance[key] if key in case.tolerance else None,
        }
        for key, d in fine.items()
    ]
    return {
        "parameters": str(parameters),
        "trace": str(trace_path),
        "n_buses": len(case.network.buses),
        "n_machines": len(case.machine_keys),
        "machine_models": sorted({"GENCLS" if machine.classical else "GENROU" for machine in case.network.machines}),
        "n_rows": trace.time_s.size,
        "end_s": float(trace.time_s[-1]),
        "events": [dataclasses.asdict(event) for event in events],
        "step_s": step_s,
        "default_step_s": default_step_s,
        "differences": rows,
        "agrees": all(row["agrees"] is not False for row in rows),
    }


def _print(found: dict[str, Any]) -> None:
    say(
        f"{found['parameters']}, {Path(found['trace']).name}: {found['n_buses']} buses, {found['n_machines']} "
        f"machines, {len(found['events'])} events, {found['n_rows']} rows to {found['end_s']:g} s",
        "",
    )
    steps = f"step {1e3 * found['step_s']:g} ms", f"default step {1e3 * found['default_step_s']:g} ms"
    header = ("largest difference", "unit", steps[0], "own error", "where", steps[1], "tolerance", "verdict")
    rows = [
        (
            _NAMES[row["quantity"]],
            row["unit"],
            f"{row['largest']:.1e}",
            f"{row['own_error']:.0e}",
            f"{row['column']} at {row['time_s']:g} s",
            f"{row['largest_at_default_step']:.1e}",
            "–" if row["tolerance"] is None else f"{row['tolerance']:.0e}",
            {None: "–", True: "agrees", False: "DIFFERS"}[row["agrees"]],
        )
        for row in found["differences"]
    ]
    print_table(header, rows, left=(0, 1, 4, 7))


def _page_table(found: Iterable[dict[str, Any]]) -> str:
    judged = tuple(DEFAULT_TOLERANCE)
    default_ms = 1e3 * PlantSettings().simulation_dt
    header = ("case", "trace", "machines", *judged, f"at {default_ms:g} ms: {', '.join(judged)}")
    rows = []
    found = list(found)
    for each in found:
        own = {row["quantity"]: row for row in each["differences"]}
        rows.append(
            (
                Path(each["parameters"]).parent.name,
                Path(each["trace"]).name,
                f"{each['n_machines']} ({', '.join(each['machine_models'])})",
                *(f"{own[k]['largest']:.1e} ({own[k]['tolerance']:.0e})" if k in own else "–" for k in judged),
                ", ".join(f"{own[k]['largest_at_default_step']:.1e}" for k in judged if k in own),
            )
        )
    steps = ", ".join(dict.fromkeys(f"{1e3 * each['step_s']:g}" for each in found))
    n_agree = sum(each["agrees"] for each in found)
    return (
        f"{n_agree} of {len(found)} traces agree. Largest differences at a step of {steps} ms, in brackets the "
        f"tolerance [p.u.]:\n\n{markdown_table(header, rows)}"
    )
