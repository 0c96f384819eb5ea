"""The grids of wtg_gym/grids that come from TOPS, from its tables.

    pip install git+https://github.com/hallvar-h/TOPS
    python docs/studies/make_grids.py

TOPS (H. Haugdal, K. Uhlen, SINTEF, MIT licence) distributes them as tables of PowerFactory's models. Groups of turbines
take the place of some machines.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterator, Mapping
from typing import Any

from wtg_gym.files import write_atomically
from wtg_gym.grids.wind import with_wind
from wtg_gym.physics.grid import FOLDER, Branch, Bus, Grid, NetworkCase, grid_text
from wtg_gym.physics.machine_parameters import (
    ExciterParameters,
    GovernorParameters,
    HydroGovernorParameters,
    SpeedStabiliserParameters,
    SynchronousMachineParameters,
)

BASE_MVA = 100.0
#: Of x'': the tables have no leakage reactance.
LEAKAGE = 0.8
#: Of stabilisers of New England.
GAIN = 20.0
#: The largest unit of the Nordic grid, Oskarshamn 3, which its reserves are dimensioned for [MW].
NORDIC_INCIDENT_MW = 1450.0


def rows(table: list[list[Any]]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table whose first row names the columns."""
    for row in table[1:]:
        yield dict(zip(table[0], row, strict=True))


def number(name: str) -> int:
    return int(name.removeprefix("B"))


def branches(data: Mapping[str, Any]) -> list[Branch]:
    """Return lines and transformers on `BASE_MVA`; a parallel transformer is a branch of its own."""
    own, volts = float(data["base_mva"]), {row["name"]: row["V_n"] for row in rows(data["buses"])}
    found = []
    for line in rows(data["lines"]):
        ends = {"from_bus": number(line["from_bus"]), "to_bus": number(line["to_bus"])}
        if line["unit"] == "pf":  # Ω and μS per km
            ohm = volts[line["from_bus"]] ** 2 / BASE_MVA
            z, y = 1.0 / ohm, 1e-6 * ohm
        else:  # p.u. per km, of the line's base or of the system's
            z = BASE_MVA / (line["S_n"] or own)
            y = 1.0 / z
        km = line["length"]
        found.append(
            Branch(resistance=line["R"] * km * z, reactance=line["X"] * km * z, charging=line["B"] * km * y, **ends)
        )
    for trafo in rows(data["transformers"]):
        scale, ends = BASE_MVA / trafo["S_n"], (number(trafo["from_bus"]), number(trafo["to_bus"]))
        # The table's ratios multiply a voltage, the tap divides that of its side.
        sides = [1.0 / trafo.get(f"ratio_{side}", 1.0) for side in ("from", "to")]
        if sides[0] == 1.0:
            sides, ends = sides[::-1], ends[::-1]
        z = {"resistance": trafo["R"] * scale, "reactance": trafo["X"] * scale}
        one = Branch(from_bus=ends[0], to_bus=ends[1], tap=sides[0] / sides[1], **z)
        found += [one] * int(trafo.get("N_par", 1))
    return found


def buses(data: Mapping[str, Any]) -> list[Bus]:
    """Return the buses; machines hold the voltages that their tables say."""
    held = {number(row["bus"]): row["V"] for row in rows(data["generators"]["GEN"])}
    found = {number(row["name"]): Bus(number=number(row["name"])) for row in rows(data["buses"])}
    for load in rows(data["loads"]):
        bus = found[number(load["bus"])]
        sums = {"load_mw": bus.load_mw + load["P"], "load_mvar": bus.load_mvar + load["Q"]}
        found[bus.number] = dataclasses.replace(bus, **sums)
    for shunt in rows(data.get("shunts", [[]])):
        bus = found[number(shunt["bus"])]
        found[bus.number] = dataclasses.replace(bus, shunt_mvar=bus.shunt_mvar + shunt["Q"])
    return [dataclasses.replace(bus, voltage_pu=held.get(bus.number)) for bus in found.values()]


def governor_of(row: Mapping[str, Any] | None) -> GovernorParameters | HydroGovernorParameters | None:
    """Return the governor of a table's row: TGOV1, or HYGOV in place of a linear hydro governor."""
    if row is None:
        return None
    if "T_4" in row:
        return HydroGovernorParameters(droop_pu=row["R"], gate_min_pu=row["V_min"])
    return GovernorParameters(
        droop_pu=row["R"], gate_time_s=row["T_1"], lead_time_s=row["T_2"], reheat_time_s=row["T_3"],
        gate_min_pu=row["V_min"], gate_max_pu=row["V_max"], turbine_damping_pu=row["D_t"],
    )  # fmt: skip


def controls(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return governors, exciters and stabilisers by the names of their generators.

    Those of generators that the table does not have are those of generators that have none.
    """
    kinds = [
        {row["gen"]: row for t in data.get(kind, {}).values() for row in rows(t)} for kind in ("gov", "avr", "pss")
    ]
    for kind in kinds:
        for lost, name in zip([name for name in kind if name not in names(data)], bare_machines(data), strict=False):
            kind[name] = kind[lost]
    return kinds


def names(data: Mapping[str, Any]) -> list[str]:
    return [row["name"] for row in rows(data["generators"]["GEN"])]


def bare_machines(data: Mapping[str, Any]) -> list[str]:
    """Return the names of generators for which the tables have no control at all."""
    named = {row["gen"] for kind in ("gov", "avr") for table in data.get(kind, {}).values() for row in rows(table)}
    return [name for name in names(data) if name not in named]


def machines(data: Mapping[str, Any]) -> list[SynchronousMachineParameters]:
    """Return the machines; those at a bus that are equal but for rating and power are one."""
    governors, exciters, stabilisers = controls(data)
    found: dict[SynchronousMachineParameters, tuple[float, float]] = {}
    for row in rows(data["generators"]["GEN"]):
        e, n = exciters.get(row["name"]), int(row.get("N_par", 1))
        exciter = e and ExciterParameters(
            gain=e["K"], lead_lag_ratio=e["T_a"] / e["T_b"], lag_time_s=e["T_b"], exciter_time_s=e["T_e"],
            field_min_pu=e["E_min"], field_max_pu=e["E_max"],
        )  # fmt: skip
        p = stabilisers.get(row["name"])
        stabiliser = p and SpeedStabiliserParameters(
            gain=p["K"], washout_time_s=p["T"], lead_time_1_s=p["T_1"], lag_time_1_s=p["T_3"], lead_time_2_s=p["T_2"],
            lag_time_2_s=p["T_4"], signal_limit_pu=p["H_lim"],
        )  # fmt: skip
        one = SynchronousMachineParameters(
            bus=number(row["bus"]), rating_mva=1.0, two_h_s=2.0 * row["H"], damping_pu=row["D"],
            x_d=row["X_d"], x_q=row["X_q"], x_d_transient=row["X_d_t"], x_q_transient=row["X_q_t"],
            x_subtransient=row["X_d_st"], x_leakage=LEAKAGE * row["X_d_st"],
            t_d0_transient_s=row["T_d0_t"], t_q0_transient_s=row["T_q0_t"],
            t_d0_subtransient_s=row["T_d0_st"], t_q0_subtransient_s=row["T_q0_st"],
            governor=governor_of(governors.get(row["name"])), exciter=exciter, stabiliser=stabiliser,
        )  # fmt: skip
        mva, mw = found.get(one, (0.0, 0.0))
        found[one] = mva + n * row["S_n"], mw + n * row["P"]
    return [
        dataclasses.replace(one, rating_mva=round(mva, 3), dispatch_mw=round(mw, 3)) for one, (mva, mw) in found.items()
    ]


def grid_of(name: str, title: str, **values: Any) -> Grid:
    """Return a grid without groups of turbines; with some values of the case in place of the table's."""
    data = importlib.import_module(f"tops.ps_models.{name}").load()
    usual = {
        "name": title, "base_mva": BASE_MVA, "frequency_hz": float(data["f"]), "slack_bus": number(data["slack_bus"]),
        "buses": tuple(buses(data)), "branches": tuple(branches(data)), "machines": tuple(machines(data)),
    }  # fmt: skip
    replaced = (f"leakage reactances are {LEAKAGE:g} of x'': the table has none",)
    source = f"TOPS (H. Haugdal, SINTEF), tops/ps_models/{name}.py"
    return Grid(case=NetworkCase(**usual | values), source=source, licence="MIT", substitutions=replaced)


def said(grid: Grid, *sentences: str, **values: Any) -> Grid:
    """Return a grid with further substitutions and other values."""
    return dataclasses.replace(grid, substitutions=(*grid.substitutions, *sentences), **values)


def new_england() -> Grid:
    grid = with_wind(grid_of("ieee39", "IEEE 39-bus system (New England)"), (32, 33, 35, 36, 38, 39), 1.25)
    machines = tuple(
        dataclasses.replace(machine, stabiliser=dataclasses.replace(machine.stabiliser, gain=GAIN))
        if machine.bus not in grid.replaced
        else machine
        for machine in grid.case.machines
    )
    return said(
        grid,
        f"stabilisers of the machines that stay have a gain of {GAIN:g}, not 50, which damps a mode of 2.4 Hz beside "
        "the groups by 0.1 % in some operating points",
        case=dataclasses.replace(grid.case, machines=machines),
    )


def kundur() -> Grid:
    grid = with_wind(grid_of("k2a", "Kundur's two areas", frequency_hz=60.0), (2, 4), 1.1)
    return said(grid, "60 Hz as in Kundur's Power System Stability and Control, example 12.6: the table has 50 Hz")


def nordic() -> Grid:
    grid = with_wind(grid_of("n45_tuned", "Nordic 45"), (), 1.25)
    return said(
        grid,
        "HYGOV with typical data and the table's droop in place of linear hydro governors",
        "the table has governors and exciters of six machines that it lacks (5410-1, 5435-1, 5510-3, 5610-1, 5610-2, "
        "5620-1), and none of six others (5320-2, 5320-3, 5520-1, 5520-2, 5551-1, 5560-1): these have those",
        "the machines at bus 3000 have a constant field voltage: the table has no exciter of theirs",
        incident_mw=NORDIC_INCIDENT_MW,
    )


if __name__ == "__main__":
    for name, grid in (("ieee39", new_england()), ("kundur", kundur()), ("nordic45", nordic())):
        write_atomically(FOLDER / f"{name}.json", grid_text(grid))
