"""`wtg-gym validate`: a case of another simulator, run here and compared with its trace."""

from __future__ import annotations

import argparse
from typing import Any

from wtg_gym.cli.output import note, print_json, print_table
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import require_range
from wtg_gym.validation.parameter_file import ReferenceCase, read_parameters
from wtg_gym.validation.replay import (
    BUS_QUANTITIES,
    MACHINE_QUANTITIES,
    Difference,
    choose_events,
    differences,
    read_trace,
    replay,
)

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

_DESCRIPTION = """\
Runs the network, machines and events of a parameter file and compares every quantity with a trace that another
simulator wrote: the largest difference of machine speed w, active power Pe and bus voltage V is held to a tolerance,
other quantities of the trace are shown. It is done twice: with a fine step, which decides, and with the default step
of the benchmark, to show what that costs.

PARAMS.json  bus, line, shunt, load, gen_static, gens (GENCLS or GENROU), tgov1, sexs and events, as in tests/golden
TRACE.csv    a column t [s], then w…, Pe…, Qe…, Tm…, delta… by machine and V…, th… by bus, in p.u. of the system base
             and rad; rows at any time, the one at the instant of an event showing the state before it

exit codes: 0 within tolerance, 1 above it, 2 bad input"""

_EXAMPLES = """\
  wtg-gym validate tests/golden/params_m.json tests/golden/classical_m_a.csv
  wtg-gym validate params.json trace.csv --events b --step 0.001 --tolerance-w 1e-7
  wtg-gym validate params.json trace.csv --json"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym validate`."""
    parser = add_command(
        commands,
        "validate",
        run,
        summary="a case of another simulator against its trace; exit code 1 above a tolerance",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("parameters", metavar="PARAMS.json", help="parameter file")
    parser.add_argument("trace", metavar="TRACE.csv", help="what the other simulator found")
    parser.add_argument(
        "--events",
        metavar="NAME",
        help="event list of the parameter file (default: the only one, or the one the trace's name ends with)",
    )
    parser.add_argument(
        "--step", type=float, default=0.0025, metavar="S", help="the fine step, 5e-5 … 0.04 s (default: 0.0025)"
    )
    for key, unit in (("w", "p.u."), ("Pe", "p.u."), ("V", "p.u.")):
        parser.add_argument(
            f"--tolerance-{key.lower()}",
            type=float,
            metavar="X",
            help=f"largest difference of {_NAMES[key]} [{unit}] (default: the file's own, or 1e-6 for w, 1e-5)",
        )
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym validate`; return 1 if a difference is above its tolerance."""
    require_range("--step", arguments.step, 5e-5, 0.04, "s")
    case = read_parameters(arguments.parameters)
    events = choose_events(case, arguments.trace, arguments.events)
    trace, unknown = read_trace(arguments.trace, case)
    if unknown:
        note(f"columns that are not compared: {', '.join(unknown)}")
    tolerance = _tolerance(arguments, case)
    default_step = PlantSettings().simulation_dt
    fine, default = (
        {d.quantity: d for d in differences(case, trace, replay(case, events, trace.time_s, step))}
        for step in (arguments.step, default_step)
    )
    judged = {key: not fine[key].size > tolerance[key] for key in fine if key in tolerance}
    if not judged:
        raise ValueError(f"{arguments.trace} has none of the quantities that are judged: {', '.join(tolerance)}")
    agrees = all(judged.values())
    if arguments.json:
        print_json(
            {
                "parameters": str(arguments.parameters),
                "trace": str(arguments.trace),
                "n_machines": len(case.machine_keys),
                "n_rows": int(trace.time_s.size),
                "events": [vars(event) for event in events],
                "step_s": arguments.step,
                "default_step_s": default_step,
                "differences": [_as_json(fine[key], default[key], tolerance.get(key)) for key in fine],
                "agrees": agrees,
            }
        )
        return 0 if agrees else 1
    print(
        f"{case.network.name}: {len(case.network.buses)} buses, {len(case.machine_keys)} machines, "
        f"{len(events)} events, {trace.time_s.size} rows to {trace.time_s[-1]:g} s\n"
    )
    header = (
        "largest difference",
        "unit",
        f"step {1e3 * arguments.step:g} ms",
        "where",
        f"default step {1e3 * default_step:g} ms",
        "tolerance",
        "verdict",
    )
    rows = [
        (
            _NAMES[key],
            _UNITS[key],
            f"{d.size:.1e}",
            f"{d.column} at {d.time_s:g} s",
            f"{default[key].size:.1e}",
            f"{tolerance[key]:.0e}" if key in tolerance else "–",
            ("agrees" if judged[key] else "DIFFERS") if key in judged else "–",
        )
        for key, d in fine.items()
    ]
    print_table(header, rows, left=(0, 1, 3, 6))
    return 0 if agrees else 1


def _tolerance(arguments: argparse.Namespace, case: ReferenceCase) -> dict[str, float]:
    tolerance = dict(case.tolerance)
    for key in tolerance:
        given = getattr(arguments, f"tolerance_{key.lower()}")
        if given is not None:
            tolerance[key] = require_range(f"--tolerance-{key.lower()}", given, 1e-15, 1.0, "p.u.")
    return tolerance


def _as_json(fine: Difference, default: Difference, tolerance: float | None) -> dict[str, Any]:
    def plain(size: float) -> float | None:
        return size if size < float("inf") else None

    return {
        "quantity": fine.quantity,
        "unit": _UNITS[fine.quantity],
        "largest": plain(fine.size),
        "column": fine.column,
        "time_s": fine.time_s,
        "largest_at_default_step": plain(default.size),
        "tolerance": tolerance,
        "agrees": None if tolerance is None else not fine.size > tolerance,
    }
