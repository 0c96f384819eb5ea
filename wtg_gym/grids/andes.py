"""Cases of other programs, read by ANDES in a process of its own: RAW with DYR, xlsx, json, MATPOWER.

ANDES (https://docs.andes.app) is GPL: it is run, never imported. Its command converts a case to JSON, whose tables are
turned into a :class:`~wtg_gym.physics.grid.Grid` here. Its parameters and their bases are those of its documentation.
"""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wtg_gym.files import read_json
from wtg_gym.grids.typical import rated, typical_machine
from wtg_gym.physics.grid import Grid
from wtg_gym.physics.machine_parameters import (
    ExciterParameters,
    GovernorParameters,
    HydroGovernorParameters,
    SynchronousMachineParameters,
    classical_machine,
)
from wtg_gym.physics.network import Branch, Bus, NetworkCase

Row = Mapping[str, Any]
Tables = Mapping[str, Sequence[Row]]
#: How long the conversion may take [s]: the first one lets ANDES generate its code.
_LIMIT_S = 600.0
#: Reactance of a branch without any [p.u.].
_LEAST_REACTANCE = 1e-4
#: Share of x'' that a leakage reactance has at most, so that the order x'' > x_l holds.
_LEAKAGE = 0.8
#: Parameters by ANDES' names.
_GOVERNORS = {
    "TGOV1": (GovernorParameters, {
        "droop_pu": "R", "gate_time_s": "T1", "lead_time_s": "T2", "reheat_time_s": "T3",
        "gate_min_pu": "VMIN", "gate_max_pu": "VMAX", "turbine_damping_pu": "Dt",
    }),
    "HYGOV": (HydroGovernorParameters, {
        "droop_pu": "R", "temporary_droop_pu": "r", "reset_time_s": "Tr", "filter_time_s": "Tf", "gate_time_s": "Tg",
        "gate_rate_limit_pu_s": "VELM", "gate_min_pu": "GMIN", "gate_max_pu": "GMAX", "water_time_s": "Tw",
        "turbine_gain": "At", "turbine_damping_pu": "Dt", "no_load_flow_pu": "qNL",
    }),
}  # fmt: skip
_EXCITERS = {
    "SEXS": (ExciterParameters, {
        "gain": "K", "lead_lag_ratio": "TATB", "lag_time_s": "TB", "exciter_time_s": "TE", "field_min_pu": "EMIN",
        "field_max_pu": "EMAX",
    }),
}  # fmt: skip
#: Tables that say nothing about the grid's models.
_IGNORED = {
    "_config",
    "Summary",
    "Toggle",
    "Toggler",
    "Fault",
    "Alter",
    "Area",
    "Zone",
    "Owner",
    "Output",
    "COI",
    "BusFreq",
    "BusROCOF",
    "PMU",
}
_NETWORK = {"Bus", "PQ", "PV", "Slack", "Shunt", "Line"}
_MACHINES = {"GENROU", "GENCLS"}
#: Groups of models in ANDES that act on a machine: what is not here can be left out or replaced, when asked.
_TYPICAL_EXCITER = ExciterParameters(field_min_pu=-6.0, field_max_pu=8.0)
_TYPICAL_GOVERNOR = GovernorParameters(droop_pu=0.05)


@dataclass
class Report:
    """What was done to a case: lines for people."""

    repairs: list[str] = field(default_factory=list)
    substitutions: list[str] = field(default_factory=list)


def convert(case: Path, dynamic: Path | None = None, program: str = "andes") -> Tables:
    """Return the tables of a case, as ANDES reads it.

    Args:
        case: a file that ANDES reads.
        dynamic: a DYR file with its machines.
        program: ANDES' command.

    Raises:
        ValueError: a file or the program is missing, or ANDES cannot read the case; the message has its last line.
    """
    for path in (case, dynamic):
        if path is not None and not path.is_file():
            raise ValueError(f"there is no file {path}")
    command = shutil.which(program)
    if command is None:
        raise ValueError(f"there is no program {program!r}: install ANDES (pip install andes), or name its command")
    with tempfile.TemporaryDirectory() as folder:
        added = [] if dynamic is None else ["--addfile", str(dynamic.resolve())]
        arguments = ["run", str(case.resolve()), *added, "--convert", "json", "--output-path", folder]
        try:
            done = subprocess.run([command, *arguments], capture_output=True, text=True, timeout=_LIMIT_S, cwd=folder)
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"ANDES did not convert {case} within {_LIMIT_S:g} s") from error
        written = sorted(Path(folder).glob("*.json"))
        if not written:
            said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
            raise ValueError(f"ANDES cannot read {case}: {said[-1] if said else 'it says nothing'}")
        tables: Tables = read_json(written[0], "conversion by ANDES")
    return tables


def grid_of(tables: Tables, name: str, *, substitute: bool = False) -> Grid:
    """Return the grid of ANDES' tables, without WTG groups.

    Args:
        tables: as :func:`convert` returns them.
        name: of the grid.
        substitute: put typical controls in the place of models that are not here, instead of refusing them.

    Raises:
        ValueError: a model is not here, or the network is none; the message says what is wrong.
    """
    report = Report()
    base = _config(tables, "mva", 100.0)
    numbers = _numbers(tables)
    machines = _machines(tables, numbers, base, report, substitute)
    if not _has_machines(tables):
        machines = _typical_machines(tables, numbers, base)
        report.substitutions.append(f"the case has no machines; all {len(machines)} are typical ones")
    buses = _buses(tables, numbers, base, {machine.bus for machine in machines})
    branches, shunts = _branches(tables, numbers, base, report)
    slacks = sorted({numbers[row["bus"]] for row in _live(tables, "Slack")})
    if len(slacks) != 1:
        raise ValueError(f"the case must have one slack bus, got {slacks}")
    grid = Grid(
        case=NetworkCase(
            name=name,
            base_mva=base,
            frequency_hz=_config(tables, "freq", 60.0),
            slack_bus=slacks[0],
            buses=tuple(_with_shunt(bus, shunts.get(bus.number, 0j) * base) for bus in buses),
            branches=tuple(branches),
            machines=tuple(machines),
        ),
        repairs=tuple(report.repairs),
        substitutions=tuple(report.substitutions),
    )
    return grid if _has_machines(tables) else dataclasses.replace(grid, case=rated(grid.case))


def _has_machines(tables: Tables) -> bool:
    return any(tables.get(model) for model in _MACHINES)


def _live(tables: Tables, model: str) -> Iterable[Row]:
    """Yield the rows of a model that are in service."""
    return (row for row in tables.get(model, ()) if row.get("u", 1.0))


def _config(tables: Tables, key: str, default: float) -> float:
    found = [row["value"] for row in tables.get("_config", ()) if (row["section"], row["key"]) == ("System", key)]
    return float(found[0]) if found else default


def _numbers(tables: Tables) -> dict[Any, int]:
    """Return the number of each bus by its index, which may be a name; buses without a whole number are counted."""
    indices = [row["idx"] for row in _live(tables, "Bus")]
    whole = all(str(index).isdigit() and int(index) > 0 for index in indices)
    return {index: int(index) if whole else place for place, index in enumerate(indices, start=1)}


def _buses(tables: Tables, numbers: Mapping[Any, int], base: float, with_machine: set[int]) -> list[Bus]:
    found = {numbers[row["idx"]]: Bus(number=numbers[row["idx"]], **_place(row)) for row in _live(tables, "Bus")}
    loads = [(row["bus"], row["p0"], row["q0"]) for row in _live(tables, "PQ")]
    for row in (*_live(tables, "PV"), *_live(tables, "Slack")):
        number = numbers[row["bus"]]
        if number in with_machine:
            found[number] = dataclasses.replace(found[number], voltage_pu=row["v0"])
        else:
            # A source without a machine is a load of negative power.
            loads.append((row["bus"], -row["p0"], -row["q0"]))
    for index, active, reactive in loads:
        bus = found[numbers[index]]
        sums = {"load_mw": bus.load_mw + base * active, "load_mvar": bus.load_mvar + base * reactive}
        found[bus.number] = dataclasses.replace(bus, **sums)
    for row in _live(tables, "Shunt"):
        number = numbers[row["bus"]]
        found[number] = _with_shunt(found[number], base * complex(row["g"], row["b"]))
    return list(found.values())


def _place(row: Row) -> dict[str, float]:
    """Return where a bus is drawn, if the case says so."""
    x, y = row.get("xcoord") or 0.0, row.get("ycoord") or 0.0
    return {"x": float(x), "y": float(y)} if (x, y) != (0.0, 0.0) else {}


def _with_shunt(bus: Bus, power: complex) -> Bus:
    """Return a bus with one shunt more [MW + j Mvar at 1 p.u.]."""
    return dataclasses.replace(bus, shunt_mw=bus.shunt_mw + power.real, shunt_mvar=bus.shunt_mvar + power.imag)


def _branches(
    tables: Tables, numbers: Mapping[Any, int], base: float, report: Report
) -> tuple[list[Branch], dict[int, complex]]:
    """Return the branches on the system's base, and the admittances that they add to their buses [p.u.]."""
    volts = {row["idx"]: row["Vn"] for row in _live(tables, "Bus")}
    found, shunts = list[Branch](), dict[int, complex]()
    for row in _live(tables, "Line"):
        ends = [numbers[row["bus1"]], numbers[row["bus2"]]]
        scale = base / row["Sn"] * (row["Vn1"] / volts[row["bus1"]]) ** 2
        reactance = scale * row["x"]
        if reactance == 0.0 and row["r"] == 0.0:
            reactance = _LEAST_REACTANCE
            report.repairs.append(
                f"branch {ends[0]}-{ends[1]} has no impedance; it gets {reactance:g} p.u. of reactance"
            )
        tap = row["tap"] or 1.0
        found.append(
            Branch(
                from_bus=ends[0], to_bus=ends[1], resistance=scale * row["r"], reactance=reactance,
                charging=row["b"] / scale, tap=tap, phase_rad=row["phi"],
            )
        )  # fmt: skip
        own = (complex(row["g1"], row["b1"]) / tap**2, complex(row["g2"], row["b2"]))
        for number, y in zip(ends, own, strict=True):
            if y:
                shunts[number] = shunts.get(number, 0j) + y / scale
    return found, shunts


def _machines(
    tables: Tables, numbers: Mapping[Any, int], base: float, report: Report, substitute: bool
) -> list[SynchronousMachineParameters]:
    controls = _controls(tables, report, substitute)
    sources = {row["idx"]: row for model in ("PV", "Slack") for row in _live(tables, model)}
    found = []
    for model in _MACHINES:
        for row in _live(tables, model):
            source = sources.get(row["gen"])
            power = 0.0 if source is None else source["p0"] * row.get("gammap", 1.0)
            common = {
                "bus": numbers[row["bus"]], "rating_mva": row["Sn"], "two_h_s": row["M"], "damping_pu": row["D"],
                "resistance": row["ra"], "dispatch_mw": base * power,
                "reactive_weight": row["Sn"] * row.get("gammaq", 1.0), **controls.get(row["idx"], {}),
            }  # fmt: skip
            if model == "GENCLS":
                common.pop("exciter", None)
                found.append(classical_machine(x_d_transient=row["xd1"], x_leakage=0.0, **common))
            else:
                found.append(_genrou(row, {"exciter": None, **common}, report))
    return found


def _typical_machines(tables: Tables, numbers: Mapping[Any, int], base: float) -> list[SynchronousMachineParameters]:
    """Return a typical machine for every source of a power flow."""
    return [
        typical_machine(numbers[row["bus"]], base * row["p0"], slack=model == "Slack")
        for model in ("PV", "Slack")
        for row in _live(tables, model)
    ]


def _genrou(row: Row, common: dict[str, Any], report: Report) -> SynchronousMachineParameters:
    at, subtransient, leakage = f"machine {row['idx']}", row["xd2"], row["xl"]
    least = min(row["xd1"], row["xq1"])
    if row["xq2"] != subtransient:
        report.repairs.append(f"{at}: x''_q {row['xq2']:g} p.u. is taken as x''_d, {subtransient:g} p.u.")
    if subtransient > least:
        report.repairs.append(f"{at}: x'' {subtransient:g} p.u. exceeds x' and is taken as {least:g} p.u.")
        subtransient = least
    if leakage >= subtransient:
        report.repairs.append(
            f"{at}: leakage reactance {leakage:g} p.u. is not below x''; {_LEAKAGE:g} x'' stands instead"
        )
        leakage = _LEAKAGE * subtransient
    if row.get("S10") or row.get("S12"):
        report.substitutions.append(f"{at}: saturation is left out")
    return SynchronousMachineParameters(
        x_d=row["xd"], x_q=row["xq"], x_d_transient=row["xd1"], x_q_transient=row["xq1"], x_subtransient=subtransient,
        x_leakage=leakage, t_d0_transient_s=row["Td10"], t_q0_transient_s=row["Tq10"] or 1.0,
        t_d0_subtransient_s=row["Td20"], t_q0_subtransient_s=row["Tq20"], **common,
    )  # fmt: skip


def _controls(tables: Tables, report: Report, substitute: bool) -> dict[Any, dict[str, Any]]:
    """Return exciter, governor and stabiliser of each machine by its index; a ValueError names models not here."""
    found: dict[Any, dict[str, Any]] = {}
    unknown: dict[str, int] = {}
    for model in tables:
        if model in _IGNORED | _NETWORK | _MACHINES:
            continue
        for row in _live(tables, model):
            machine = row.get("syn")
            for kind, known in (("exciter", _EXCITERS), ("governor", _GOVERNORS)):
                if model in known:
                    record, names = known[model]
                    found.setdefault(machine, {})[kind] = record(**{own: row[name] for own, name in names.items()})
                    break
            else:
                unknown[model] = unknown.get(model, 0) + 1
                if substitute and machine is not None:
                    # ANDES' governors have a droop or a gain, its exciters neither.
                    kind, typical = (
                        ("governor", _TYPICAL_GOVERNOR) if {"wref0", "Tn"} & set(row) else ("exciter", _TYPICAL_EXCITER)
                    )
                    found.setdefault(machine, {})[kind] = typical
                    report.substitutions.append(f"{model} of machine {machine}: a typical {kind} stands in its place")
                elif substitute:
                    report.substitutions.append(f"{model} {row.get('idx')} is left out")
    if unknown and not substitute:
        said = ", ".join(f"{model} ({n})" for model, n in unknown.items())
        raise ValueError(f"models that are not here: {said}; --substitute puts typical controls in their place")
    return found
