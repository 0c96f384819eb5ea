"""The grids that come with the package, with all their machines, as golden cases: what a `params.json` would hold."""

from collections import Counter
from typing import Any

import numpy as np

from tests.golden.case import BRANCH, EXCITERS, GENROU, GOVERNORS, MACHINE, STABILISERS, field_names
from tests.golden.replay import machine_powers
from wtg_gym import Plant, Scenario
from wtg_gym.physics.grid import MODELS, NetworkCase, get_grid
from wtg_gym.physics.simulator import Simulator

#: By grid and trace; powers are taken at the voltage of the power flow.
EVENTS: dict[str, dict[str, list[dict[str, Any]]]] = {
    "ieee39": {"loads": [{"t": 1.0, "bus": 8, "trip_load_MW": 522.0}, {"t": 4.0, "bus": 20, "MW_at_V0": 200.0}]},
    "kundur": {"load": [{"t": 1.0, "bus": 7, "MW_at_V0": 100.0}]},
    "nordic45": {"load": [{"t": 1.0, "bus": 7000, "MW_at_V0": 1000.0}]},
}
TOLERANCE = {"w": 1e-6, "Pe": 1e-3, "V": 5e-5}


def data_of_grid(name: str) -> dict[str, Any]:
    case = get_grid(name).case
    voltage, power = _power_flow(case)
    at, base = dict(zip(case.bus_numbers, voltage, strict=True)), case.base_mva
    buses = list(dict.fromkeys(machine.bus for machine in case.machines))
    static = {bus: sum(p for p, m in zip(power, case.machines, strict=True) if m.bus == bus) for bus in buses}
    rated = {bus: sum(m.rating_mva for m in case.machines if m.bus == bus) for bus in buses}
    gens, controls = dict[str, Any](), dict[str, list[Any]]()
    several = {bus for bus, n in Counter(machine.bus for machine in case.machines).items() if n > 1}
    models = {record: model.lower() for model, record in MODELS.items()}
    for machine, s in zip(case.machines, power, strict=True):
        letters = "abc" if machine.bus in several else ("",)
        key = next(key for key in (f"{machine.bus}{letter}" for letter in letters) if key not in gens)
        gens[key] = {
            "model": "GENROU", "bus": machine.bus, "gammap": s.real / static[machine.bus].real,
            "gammaq": machine.rating_mva / rated[machine.bus], "xq2": machine.x_subtransient,
            **_values(f"{MACHINE} {GENROU}", machine),
        }  # fmt: skip
        for control in (machine.exciter, machine.stabiliser, machine.governor):
            if control is not None:
                model = models[type(control)]
                values = _values({**EXCITERS, **STABILISERS, **GOVERNORS}[model], control)
                controls.setdefault(model, []).append({"gen": key, **values})
    return {
        "fn": case.frequency_hz,
        "Sbase": base,
        "bus": [{"bus": bus, "V": abs(v), "theta": float(np.angle(v)), "Vn": 100.0} for bus, v in at.items()],
        "line": [{"f": b.from_bus, "t": b.to_bus, **_values(BRANCH, b)} for b in case.branches],
        "load": [{"bus": b.number, "P": b.load_mw / base, "Q": b.load_mvar / base} for b in case.buses if b.load_mw],
        "shunt": [{"bus": b.number, "g": b.shunt_mw / base, "b": b.shunt_mvar / base} for b in case.buses],
        "gen_static": {str(bus): {"P": s.real, "Q": s.imag} for bus, s in static.items()},
        "gens": gens,
        **controls,
        "events": {
            trace: [
                {**event, "dG_pu": event["MW_at_V0"] / base / abs(at[event["bus"]]) ** 2}
                if "MW_at_V0" in event
                else event
                for event in events
            ]
            for trace, events in EVENTS[name].items()
        },
        "tolerance": TOLERANCE,
    }


def _values(names: str, record: Any) -> dict[str, float]:
    """Return the numbers of a record as the file calls them; a dead band of 0 is none."""
    found = {key: getattr(record, field) for field, key in field_names(names)}
    return {key: value for key, value in found.items() if (key, value) != ("db", 0.0)}


def _power_flow(case: NetworkCase) -> tuple[Any, Any]:
    """Return the voltages of the buses and the powers of the machines, complex [p.u.]."""
    simulator = Simulator(Plant(case=case, groups=()))
    simulator.start(0, Scenario(name="rest", wind_speed=np.zeros((0, 1)), load_noise_bus=case.slack_bus), ())
    simulator.evaluate()
    voltage, slack = simulator.bus_voltages(), case.bus_index(case.slack_bus)
    voltage *= abs(voltage[slack]) / voltage[slack]
    return voltage, machine_powers(simulator)
