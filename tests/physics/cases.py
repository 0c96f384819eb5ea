"""Builders shared by physics tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from wtg_gym.physics.network import Branch, Bus, NetworkCase
from wtg_gym.physics.parameters import GovernorParameters, SynchronousMachineParameters

GOLDEN = Path(__file__).parent.parent / "golden"


def classical_machine(
    bus: int, *, rating_mva: float = 100.0, dispatch_mw: float = 0.0, **more: Any
) -> SynchronousMachineParameters:
    """Return a constant voltage behind a reactance; the GENROU numbers it does not use are placeholders."""
    values: dict[str, Any] = {
        "bus": bus,
        "rating_mva": rating_mva,
        "two_h_s": 10.0,
        "x_d": 1.0,
        "x_d_transient": 0.2,
        "x_subtransient": 0.15,
        "x_q": 1.0,
        "x_q_transient": 0.5,
        "t_d0_transient_s": 6.0,
        "t_d0_subtransient_s": 0.03,
        "t_q0_subtransient_s": 0.05,
        "classical": True,
        "exciter": None,
        "dispatch_mw": dispatch_mw,
        **more,
    }
    return SynchronousMachineParameters(**values)


def golden_case(name: str) -> NetworkCase:
    """Return the network of a golden parameter file with its classical machines."""
    data = json.loads((GOLDEN / f"params_{name}.json").read_text())
    loads = {entry["bus"]: entry for entry in data["load"]}
    shunts = {entry["bus"]: entry for entry in data["shunt"]}
    held = {machine["bus"] for machine in data["gens"].values()}
    base = data["Sbase"]
    buses = []
    for bus in data["bus"]:
        load, shunt = loads.get(bus["bus"], {"P": 0.0, "Q": 0.0}), shunts.get(bus["bus"], {"g": 0.0, "b": 0.0})
        buses.append(
            Bus(
                number=bus["bus"],
                load_mw=base * load["P"],
                load_mvar=base * load["Q"],
                shunt_mw=base * shunt["g"],
                shunt_mvar=base * shunt["b"],
                voltage_pu=bus["V"] if bus["bus"] in held else None,
            )
        )
    branches = [
        Branch(
            from_bus=line["f"],
            to_bus=line["t"],
            resistance=line["r"],
            reactance=line["x"],
            charging=line["b"],
            tap=line["tap"],
            phase_rad=line["phi"],
        )
        for line in data["line"]
    ]
    turbine = data["tgov1"]
    machines = []
    for key, machine in data["gens"].items():
        governor = None
        if turbine["gen"] == key:
            governor = GovernorParameters(
                droop_pu=turbine["R"],
                gate_time_s=turbine["T1"],
                lead_time_s=turbine["T2"],
                reheat_time_s=turbine["T3"],
                gate_min_pu=turbine["VMIN"],
                gate_max_pu=turbine["VMAX"],
                turbine_damping_pu=turbine["Dt"],
            )
        static = data["gen_static"][str(machine["bus"])]["P"] * machine["gammap"] * base
        machines.append(
            classical_machine(
                machine["bus"],
                rating_mva=machine["Sn"],
                dispatch_mw=0.0 if machine["bus"] == 1 else static,
                two_h_s=machine["M"],
                damping_pu=machine["D"],
                x_d_transient=machine["xd1"],
                resistance=machine["ra"],
                governor=governor,
            )
        )
    return NetworkCase(
        name=name,
        base_mva=base,
        frequency_hz=data["fn"],
        slack_bus=1,
        buses=tuple(buses),
        branches=tuple(branches),
        machines=tuple(machines),
    )
