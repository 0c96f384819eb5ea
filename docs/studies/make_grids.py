"""The grids of wtg_gym/grids that come from TOPS, from its tables.

    pip install tops
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
from wtg_gym.physics.grid import FOLDER, Grid, grid_text
from wtg_gym.physics.machine_parameters import ExciterParameters, GovernorParameters, SynchronousMachineParameters
from wtg_gym.physics.network import Branch, Bus, NetworkCase
from wtg_gym.physics.parameters import WtgGroup

BASE_MVA, TURBINE_MW = 100.0, 5.0
#: Of x'': the tables have no leakage reactance.
LEAKAGE = 0.8


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
    for shunt in rows(data["shunts"]):
        bus = found[number(shunt["bus"])]
        found[bus.number] = dataclasses.replace(bus, shunt_mvar=bus.shunt_mvar + shunt["Q"])
    return [dataclasses.replace(bus, voltage_pu=held.get(bus.number)) for bus in found.values()]


def machines(data: Mapping[str, Any]) -> list[SynchronousMachineParameters]:
    """Return the machines; equal ones at a bus are one."""
    controls = {
        kind: {row["gen"]: row for own in data.get(kind, {}).values() for row in rows(own)} for kind in ("gov", "avr")
    }
    found = []
    for row in rows(data["generators"]["GEN"]):
        n, g, e = int(row.get("N_par", 1)), controls["gov"].get(row["name"]), controls["avr"].get(row["name"])
        governor = g and GovernorParameters(
            droop_pu=g["R"], gate_time_s=g["T_1"], lead_time_s=g["T_2"], reheat_time_s=g["T_3"],
            gate_min_pu=g["V_min"], gate_max_pu=g["V_max"], turbine_damping_pu=g["D_t"],
        )  # fmt: skip
        exciter = e and ExciterParameters(
            gain=e["K"], lead_lag_ratio=e["T_a"] / e["T_b"], lag_time_s=e["T_b"], exciter_time_s=e["T_e"],
            field_min_pu=e["E_min"], field_max_pu=e["E_max"],
        )  # fmt: skip
        found.append(
            SynchronousMachineParameters(
                bus=number(row["bus"]), rating_mva=n * row["S_n"], two_h_s=2.0 * row["H"], damping_pu=row["D"],
                x_d=row["X_d"], x_q=row["X_q"], x_d_transient=row["X_d_t"], x_q_transient=row["X_q_t"],
                x_subtransient=row["X_d_st"], x_leakage=LEAKAGE * row["X_d_st"],
                t_d0_transient_s=row["T_d0_t"], t_q0_transient_s=row["T_q0_t"],
                t_d0_subtransient_s=row["T_d0_st"], t_q0_subtransient_s=row["T_q0_st"],
                dispatch_mw=n * row["P"], governor=governor, exciter=exciter,
            )
        )  # fmt: skip
    return found


def grid_of(name: str, title: str, wind_buses: tuple[int, ...], wind_rating: float) -> Grid:
    """Return a grid with groups of turbines in place of the machines at some buses.

    All turbines together are rated as so much of the load; each group by what its machine gave.
    """
    data = importlib.import_module(f"tops.ps_models.{name}").load()
    case = NetworkCase(
        name=title, base_mva=BASE_MVA, frequency_hz=float(data["f"]), slack_bus=number(data["slack_bus"]),
        buses=tuple(buses(data)), branches=tuple(branches(data)), machines=tuple(machines(data)),
    )  # fmt: skip
    given = {machine.bus: machine.dispatch_mw for machine in case.machines if machine.bus in wind_buses}
    total = sum(given.values())
    groups = tuple(
        WtgGroup(bus=bus, n_turbines=round(wind_rating * case.load_mw * mw / total / TURBINE_MW)) for bus, mw in given.items()
    )
    return Grid(
        case=case,
        groups=groups,
        replaced=wind_buses,
        source=f"TOPS (H. Haugdal, SINTEF), tops/ps_models/{name}.py",
        licence="MIT",
        substitutions=(f"leakage reactances are {LEAKAGE:g} of x'': the table has none",),
    )


if __name__ == "__main__":
    for name, known, title, *wind in (
        ("ieee39", "ieee39", "IEEE 39-bus system (New England)", (32, 33, 35, 36, 38, 39), 1.25),
        ("kundur", "k2a", "Kundur's two areas", (2, 4), 1.1),
    ):
        write_atomically(FOLDER / f"{name}.json", grid_text(grid_of(known, title, *wind)))
