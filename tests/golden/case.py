"""The golden cases: network, machines and events of a `params.json`, and the traces beside it.

All in p.u. of `Sbase` except machine data, which are on the machine's own base `Sn`.
"""

import json
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.physics.extended import phasors
from wtg_gym import Plant, Scenario
from wtg_gym.physics.grid import MODELS, Branch, Bus, NetworkCase, Source, get_grid
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters, classical_machine
from wtg_gym.physics.scenario import EVENT_KINDS, Event, LoadStep
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.units import UNITS

GOLDEN = Path(__file__).parent
#: Rows of the traces are whole multiples of this [s].
ROW_S = 1.0 / 16.0
TRACES = sorted(GOLDEN.glob("*/*.csv"))

#: What a file, as ANDES, calls the fields of a record; of controls by kind and model.
NAMES = tomllib.loads((GOLDEN / "names.toml").read_text(encoding="utf-8"))
CONTROLS = {kind: NAMES[kind] for kind in ("exciter", "governor", "stabiliser")}
#: Of the grids that come with the package, by grid and trace; powers are taken at the voltage of the power flow.
EVENTS: dict[str, dict[str, list[dict[str, Any]]]] = {
    "ieee39": {"loads": [{"t": 1.0, "bus": 8, "trip_load_MW": 522.0}, {"t": 4.0, "bus": 20, "MW_at_V0": 200.0}]},
    "kundur": {"load": [{"t": 1.0, "bus": 7, "MW_at_V0": 100.0}]},
    "nordic45": {"load": [{"t": 1.0, "bus": 7000, "MW_at_V0": 1000.0}]},
}
TOLERANCE = {"w": 1e-6, "Pe": 1e-3, "V": 5e-5}


@dataclass(frozen=True, kw_only=True)
class Case:
    """The contents of a `params.json`."""

    network: NetworkCase  # with its machines, in the order of `keys`
    keys: tuple[str, ...]  # the file's names of the machines
    voltage: Mapping[int, complex]  # of each bus in the file's power flow, by bus number [p.u.]
    power: Mapping[str, complex]  # P + jQ of each machine in the file's power flow [p.u.]
    events: Mapping[str, tuple[Event, ...]]  # by the name of their trace
    tolerance: Mapping[str, float]  # allowed largest difference by quantity: "w", "Pe", "V" [p.u.]

    @property
    def columns(self) -> dict[str, str]:
        """Return the quantity of every column that a trace may have, in the order of a replay."""
        machines = {f"{quantity}{key}": quantity for quantity in ("w", "Pe", "Qe", "Tm", "delta") for key in self.keys}
        return machines | {f"{quantity}{bus}": quantity for quantity in ("V", "th") for bus in self.network.bus_numbers}


def read_data(name: str):
    """Return what the `params.json` of a golden case holds, or would hold of a grid that comes with the package."""
    if name in EVENTS:
        return data_of_grid(name)
    return json.loads((GOLDEN / name / "params.json").read_text(encoding="utf-8"))


def read_case(name: str) -> Case:
    data = read_data(name)
    base = data["Sbase"]
    voltage = {bus["bus"]: bus["V"] * np.exp(1j * bus["theta"]) for bus in data["bus"]}
    loads = dict.fromkeys(voltage, 0j) | {load["bus"]: complex(load["P"], load["Q"]) for load in data["load"]}
    shunts = dict.fromkeys(voltage, 0j) | {shunt["bus"]: complex(shunt["g"], shunt["b"]) for shunt in data["shunt"]}
    power = {
        key: complex(static["P"] * gen["gammap"], static["Q"] * gen["gammaq"])
        for key, gen in data["gens"].items()
        if gen.get("model") != "source"
        for static in [data["gen_static"][str(gen["bus"])]]
    }
    machines = tuple(_machine(data["gens"][key], base, power[key], data, key) for key in power)
    sources = tuple(
        Source(bus=gen["bus"], resistance=gen["ra"] * base / gen["Sn"], reactance=gen["xd1"] * base / gen["Sn"])
        for key, gen in data["gens"].items()
        if key not in power
    )
    held = {machine.bus for machine in machines} | {source.bus for source in sources}

    def bus_of(number: int) -> Bus:
        load, shunt = base * loads[number], base * shunts[number]
        powers = {"load_mw": load.real, "load_mvar": load.imag, "shunt_mw": shunt.real, "shunt_mvar": shunt.imag}
        return Bus(number=number, voltage_pu=abs(voltage[number]) if number in held else None, **powers)

    network = NetworkCase(
        name=name,
        base_mva=base,
        frequency_hz=data["fn"],
        # Every machine's power is given, so that any of their buses can take the slack; the angle's zero is a choice.
        # A source's power is not.
        slack_bus=min({source.bus for source in sources} or held, key=lambda number: abs(np.angle(voltage[number]))),
        buses=tuple(map(bus_of, voltage)),
        branches=tuple(Branch(from_bus=b["f"], to_bus=b["t"], **_named(NAMES["branch"], b)) for b in data["line"]),
        machines=machines,
        sources=sources,
    )
    events = {key: tuple(_event(e, base, voltage, loads) for e in given) for key, given in data["events"].items()}
    tolerance = {"w": 1e-6, "Pe": 1e-5, "V": 1e-5} | data.get("tolerance", {})
    return Case(network=network, keys=tuple(power), voltage=voltage, power=power, events=events, tolerance=tolerance)


def field_names(names: str) -> list[list[str]]:
    return [pair.split("=") for pair in names.split()]


def _named(names: str, given):
    return {name: float(given[key]) for name, key in field_names(names) if key in given}


def _control(data, key: str, kind: str):
    """Return the control of a machine, of the first model of its kind of which the file has one, or None."""
    for model, names in CONTROLS[kind].items():
        entries = data.get(model, [])
        for entry in [entries] if isinstance(entries, dict) else entries:
            if entry["gen"] == key:
                return MODELS[model.upper()](**_named(names, entry))
    return None


def _machine(gen, base: float, power: complex, data, key: str) -> SynchronousMachineParameters:
    # Of the weights only the proportions count.
    shares = {"dispatch_mw": base * power.real, "reactive_weight": base * gen["gammaq"]}
    common = {**_named(NAMES["machine"], gen), "bus": gen["bus"], "governor": _control(data, key, "governor"), **shares}
    if gen.get("model", "GENCLS") == "GENCLS":
        return classical_machine(**common)
    assert gen["xd2"] == gen["xq2"], "the network is a constant admittance"
    electric = {"exciter": _control(data, key, "exciter"), "stabiliser": _control(data, key, "stabiliser")}
    return SynchronousMachineParameters(**electric, **_named(NAMES["genrou"], gen), **common)


def _event(entry, base: float, voltage: Mapping[int, complex], loads: Mapping[int, complex]) -> Event:
    """Return an event: of its kind, or as the power that its admittance takes at the bus's initial voltage."""
    if "kind" in entry:
        return EVENT_KINDS[entry["kind"]](**{key: value for key, value in entry.items() if key != "kind"})
    bus = entry["bus"]
    power = complex(entry.get("dG_pu", 0.0), -entry.get("dB_pu", 0.0)) * abs(voltage[bus]) ** 2
    if "trip_load_MW" in entry:
        # A part of a load takes its reactive power along.
        power -= entry["trip_load_MW"] / base / loads[bus].real * loads[bus]
    return LoadStep(time_s=entry["t"], bus=bus, power_mw=base * power.real, reactive_mvar=base * power.imag)


def read_trace(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times of a trace (n,) [s] and its columns (n,) by name, such as ``w1`` or ``V14``.

    Without the rows of three traces 0.1 ms after an event, which no step ends at.
    """
    table = np.genfromtxt(path, delimiter=",", names=True)
    table = table[table["t"] % ROW_S == 0.0]
    return table["t"], {name: table[name] for name in table.dtype.names[1:]}


def machine_powers(simulator: Simulator) -> np.ndarray:
    machines, n = simulator.plant.machines, simulator.layout.n_sync
    emf, current = (phasors(simulator, UNITS, part)[:n] for part in ("voltage", "current"))
    return current.conj() * (emf - (machines["resistance"] + 1j * machines["internal_reactance"]) * current)


def data_of_grid(name: str) -> dict[str, Any]:
    """Return what a `params.json` would hold of a grid that comes with the package, with all its machines."""
    case = get_grid(name).case
    voltage, power = _power_flow(case)
    at, base = dict(zip(case.bus_numbers, voltage, strict=True)), case.base_mva
    buses = list(dict.fromkeys(machine.bus for machine in case.machines))
    static = {bus: sum(p for p, m in zip(power, case.machines, strict=True) if m.bus == bus) for bus in buses}
    rated = {bus: sum(m.rating_mva for m in case.machines if m.bus == bus) for bus in buses}
    gens, controls = dict[str, Any](), dict[str, list[Any]]()
    several = {bus for bus, n in Counter(machine.bus for machine in case.machines).items() if n > 1}
    models = {record: model.lower() for model, record in MODELS.items()}

    def conductance(event: dict[str, Any]) -> dict[str, Any]:
        mw = event.get("MW_at_V0")
        return event if mw is None else {**event, "dG_pu": mw / base / abs(at[event["bus"]]) ** 2}

    for machine, s in zip(case.machines, power, strict=True):
        letters = "abc" if machine.bus in several else ("",)
        key = next(key for key in (f"{machine.bus}{letter}" for letter in letters) if key not in gens)
        gens[key] = {
            "model": "GENROU", "bus": machine.bus, "gammap": s.real / static[machine.bus].real,
            "gammaq": machine.rating_mva / rated[machine.bus], "xq2": machine.x_subtransient,
            **_values(f"{NAMES['machine']} {NAMES['genrou']}", machine),
        }  # fmt: skip
        for kind in CONTROLS:
            if (control := getattr(machine, kind)) is not None:
                model = models[type(control)]
                values = _values(CONTROLS[kind][model], control)
                controls.setdefault(model, []).append({"gen": key, **values})
    return {
        "fn": case.frequency_hz,
        "Sbase": base,
        "bus": [{"bus": bus, "V": abs(v), "theta": float(np.angle(v)), "Vn": 100.0} for bus, v in at.items()],
        "line": [{"f": b.from_bus, "t": b.to_bus, **_values(NAMES["branch"], b)} for b in case.branches],
        "load": [{"bus": b.number, "P": b.load_mw / base, "Q": b.load_mvar / base} for b in case.buses if b.load_mw],
        "shunt": [{"bus": b.number, "g": b.shunt_mw / base, "b": b.shunt_mvar / base} for b in case.buses],
        "gen_static": {str(bus): {"P": s.real, "Q": s.imag} for bus, s in static.items()},
        "gens": gens,
        **controls,
        "events": {trace: [conductance(event) for event in events] for trace, events in EVENTS[name].items()},
        "tolerance": TOLERANCE,
    }


def _values(names: str, record: Any) -> dict[str, float]:
    """Return the numbers of a record as the file calls them; a dead band of 0 is none."""
    result = {key: getattr(record, field) for field, key in field_names(names)}
    return {key: value for key, value in result.items() if (key, value) != ("db", 0.0)}


def _power_flow(case: NetworkCase) -> tuple[Any, Any]:
    """Return the voltages of the buses and the powers of the machines, complex [p.u.]."""
    simulator = Simulator(Plant(case=case, groups=()))
    simulator.start(0, Scenario(name="rest", wind_speed=np.zeros((0, 1)), load_noise_bus=case.slack_bus), ())
    simulator.evaluate()
    voltage, slack = simulator.bus_voltages(), case.bus_index(case.slack_bus)
    voltage *= abs(voltage[slack]) / voltage[slack]
    return voltage, machine_powers(simulator)
