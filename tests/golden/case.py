"""The golden cases: network, machines and events of a `params.json`, and the traces beside it.

All in p.u. of `Sbase` except machine data, which are on the machine's own base `Sn`.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wtg_gym.physics.grid import MODELS, Branch, Bus, NetworkCase, Source
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters, classical_machine
from wtg_gym.physics.scenario import EVENT_KINDS, Event, LoadStep

GOLDEN = Path(__file__).parent
#: Rows of the traces are whole multiples of this [s].
ROW_S = 1.0 / 16.0
TRACES = sorted(GOLDEN.glob("*/*.csv"))

# What the file, as ANDES, calls the fields of a record.
BRANCH = "resistance=r reactance=x charging=b tap=tap phase_rad=phi"
MACHINE = "rating_mva=Sn two_h_s=M x_d_transient=xd1 damping_pu=D resistance=ra"
GENROU = (
    "x_d=xd x_q=xq x_q_transient=xq1 x_subtransient=xd2 x_leakage=xl t_d0_transient_s=Td10 t_d0_subtransient_s=Td20 "
    "t_q0_transient_s=Tq10 t_q0_subtransient_s=Tq20 saturation_1_0=S10 saturation_1_2=S12"
)
IEEET1 = (
    "sensing_time_s=TR regulator_gain=KA regulator_time_s=TA regulator_min_pu=VRMIN regulator_max_pu=VRMAX "
    "exciter_gain=KE exciter_time_s=TE feedback_gain_s=KF feedback_time_s=TF saturation_voltage_1_pu=E1 "
    "saturation_1=SE1 saturation_voltage_2_pu=E2 saturation_2=SE2"
)
#: Of each kind of control the names by model, those first that are looked for first.
GOVERNORS = {
    "tgov1": "droop_pu=R gate_time_s=T1 lead_time_s=T2 reheat_time_s=T3 gate_min_pu=VMIN gate_max_pu=VMAX "
    "turbine_damping_pu=Dt dead_band_pu=db",
    "hygov": "droop_pu=R temporary_droop_pu=r reset_time_s=Tr filter_time_s=Tf gate_time_s=Tg "
    "gate_rate_limit_pu_s=VELM gate_min_pu=GMIN gate_max_pu=GMAX water_time_s=Tw turbine_gain=At turbine_damping_pu=Dt "
    "no_load_flow_pu=qNL dead_band_pu=db",
    "ieeeg1": "droop_pu=R lag_time_s=T1 lead_time_s=T2 valve_time_s=T3 opening_rate_pu_s=UO closing_rate_pu_s=UC "
    "gate_min_pu=PMIN gate_max_pu=PMAX pass_time_1_s=T4 fraction_1=K1 pass_time_2_s=T5 fraction_2=K3 pass_time_3_s=T6 "
    "fraction_3=K5 pass_time_4_s=T7 fraction_4=K7",
    "ieesgo": "droop_pu=R lag_time_s=T1 lead_time_s=T2 governor_time_s=T3 inlet_time_s=T4 reheat_time_s=T5 "
    "crossover_time_s=T6 fraction_2=K2 fraction_3=K3 gate_min_pu=PMIN gate_max_pu=PMAX",
    "gast": "droop_pu=R valve_time_s=T1 turbine_time_s=T2 exhaust_time_s=T3 load_limit_pu=AT temperature_gain=KT "
    "gate_min_pu=VMIN gate_max_pu=VMAX turbine_damping_pu=Dt",
}
EXCITERS = {
    "sexs": "lead_lag_ratio=TATB lag_time_s=TB gain=K exciter_time_s=TE field_min_pu=EMIN field_max_pu=EMAX",
    "ieeet1": IEEET1,
    "ieeex1": f"{IEEET1} lead_time_s=TC lag_time_s=TB",
}
STABILISERS = {
    "stab1": "gain=K washout_time_s=T lead_time_1_s=T1 lag_time_1_s=T3 lead_time_2_s=T2 lag_time_2_s=T4 "
    "signal_limit_pu=HLIM",
    "ieeest": "filter_a1_s=A1 filter_a2_s2=A2 filter_a3_s=A3 filter_a4_s2=A4 filter_a5_s=A5 filter_a6_s2=A6 "
    "lead_time_1_s=T1 lag_time_1_s=T2 lead_time_2_s=T3 lag_time_2_s=T4 washout_gain_s=T5 washout_time_s=T6 gain=KS "
    "signal_min_pu=LSMIN signal_max_pu=LSMAX",
}


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
    from tests.golden import shipped

    if name in shipped.EVENTS:
        return shipped.data_of_grid(name)
    return json.loads((GOLDEN / name / "params.json").read_text(encoding="utf-8"))


def read_case(name: str) -> Case:
    return case_of(name, read_data(name))


def case_of(name: str, data) -> Case:
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
    network = NetworkCase(
        name=name,
        base_mva=base,
        frequency_hz=data["fn"],
        # Every machine's power is given, so that any of their buses can take the slack; the angle's zero is a choice.
        # A source's power is not.
        slack_bus=min({source.bus for source in sources} or held, key=lambda number: abs(np.angle(voltage[number]))),
        buses=tuple(
            Bus(
                number=number,
                load_mw=base * loads[number].real,
                load_mvar=base * loads[number].imag,
                shunt_mw=base * shunts[number].real,
                shunt_mvar=base * shunts[number].imag,
                voltage_pu=abs(voltage[number]) if number in held else None,
            )
            for number in voltage
        ),
        branches=tuple(Branch(from_bus=line["f"], to_bus=line["t"], **_named(BRANCH, line)) for line in data["line"]),
        machines=machines,
        sources=sources,
    )
    return Case(
        network=network,
        keys=tuple(power),
        voltage=voltage,
        power=power,
        events={key: tuple(_event(e, base, voltage, loads) for e in events) for key, events in data["events"].items()},
        tolerance={"w": 1e-6, "Pe": 1e-5, "V": 1e-5} | data.get("tolerance", {}),
    )


def field_names(names: str) -> list[list[str]]:
    """Return the names of fields, and what the file calls each."""
    return [pair.split("=") for pair in names.split()]


def _named(names: str, given):
    return {name: float(given[key]) for name, key in field_names(names) if key in given}


def _control(data, key: str, models: Mapping[str, str]):
    """Return the control of a machine, of the first of these models of which the file has one, or None."""
    for model, names in models.items():
        entries = data.get(model, [])
        for entry in [entries] if isinstance(entries, dict) else entries:
            if entry["gen"] == key:
                return MODELS[model.upper()](**_named(names, entry))
    return None


def _machine(gen, base: float, power: complex, data, key: str) -> SynchronousMachineParameters:
    common = {
        **_named(MACHINE, gen),
        "bus": gen["bus"],
        "dispatch_mw": base * power.real,
        # Only the proportions of the weights count.
        "reactive_weight": base * gen["gammaq"],
        "governor": _control(data, key, GOVERNORS),
    }
    if gen.get("model", "GENCLS") == "GENCLS":
        return classical_machine(**common)
    assert gen["xd2"] == gen["xq2"], "the network is a constant admittance"
    electric = {"exciter": _control(data, key, EXCITERS), "stabiliser": _control(data, key, STABILISERS)}
    return SynchronousMachineParameters(**electric, **_named(GENROU, gen), **common)


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
