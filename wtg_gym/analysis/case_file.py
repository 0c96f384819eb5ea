"""Cases of other simulators: network, machines and events from a parameter file.

The form is that of the golden cases (`tests/golden`): one JSON object with the solved power flow, lines, loads,
machines and events, all in p.u. of `Sbase` except machine data, which are on the machine's own base `Sn`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wtg_gym.analysis.json_fields import Fields
from wtg_gym.files import read_json
from wtg_gym.physics.machine_parameters import (
    ExciterParameters,
    GovernorParameters,
    HydroGovernorParameters,
    SynchronousMachineParameters,
    classical_machine,
)
from wtg_gym.physics.network import Branch, Bus, NetworkCase
from wtg_gym.physics.scenario import LoadStep

#: Largest difference [p.u.] of any quantity at which two simulators agree, where a file does not say.
DEFAULT_TOLERANCE = {"w": 1e-6, "Pe": 1e-5, "V": 1e-5}
#: Largest sum by which shares of a bus may miss 1, and load disconnected twice may exceed the load.
_SHARE_TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True)
class ReferenceCase:
    """The contents of a parameter file."""

    network: NetworkCase  # the network with its machines, in the order of `machine_keys`
    machine_keys: tuple[str, ...]  # the file's names of the machines
    #: |V| and angle of each bus in the file's power flow, by bus number [p.u., rad].
    voltage: Mapping[int, tuple[float, float]]
    #: Each event list by its name; constant-admittance changes at their instants.
    events: Mapping[str, tuple[LoadStep, ...]]
    power: Mapping[str, complex]  # P + jQ of each machine in the file's power flow, by key [p.u. of the system base]
    tolerance: Mapping[str, float]  # allowed largest difference by quantity: "w", "Pe", "V" [p.u.]
    unused: tuple[str, ...]  # places of the file that are not read


def read_parameters(path: str | Path) -> ReferenceCase:
    """Read a parameter file.

    Raises:
        ValueError: the file is missing, not JSON, or not of the form; the message names the place and the value.
    """
    root = Fields(read_json(Path(path), "parameter file", encoding="utf-8-sig"), f"the parameter file {path}")
    base = root.number("Sbase", positive=True)
    voltage: dict[int, tuple[float, float]] = {}
    for bus in root.list("bus"):
        if bus.bus() in voltage:
            raise ValueError(f"{bus.where} is bus {bus.bus()} for the second time")
        voltage[bus.bus()] = bus.number("V", positive=True), bus.number("theta", 0.0)
    machines, power = _read_machines(root, base)
    held = sorted({machine.bus for machine in machines})
    for machine in machines:
        if machine.bus not in voltage:
            raise ValueError(f"{root.where}: a machine stands at bus {machine.bus}, which it does not list")
    # Every machine's power is given, so that any of their buses can take the slack; the angle's zero is a choice.
    slack = min(held, key=lambda number: abs(voltage[number][1]))
    loads, shunts = _totals(root, "load", ("P", "Q"), voltage), _totals(root, "shunt", ("g", "b"), voltage)
    network = NetworkCase(
        name=Path(path).stem,
        base_mva=base,
        frequency_hz=root.number("fn", positive=True),
        slack_bus=slack,
        buses=tuple(
            Bus(
                number=number,
                load_mw=base * loads[number][0],
                load_mvar=base * loads[number][1],
                shunt_mw=base * shunts[number][0],
                shunt_mvar=base * shunts[number][1],
                voltage_pu=voltage[number][0] if number in held else None,
            )
            for number in voltage
        ),
        branches=tuple(
            Branch(
                from_bus=line.bus("f"),
                to_bus=line.bus("t"),
                resistance=line.number("r"),
                reactance=line.number("x"),
                charging=line.number("b", 0.0),
                tap=line.number("tap", 1.0, positive=True),
                phase_rad=line.number("phi", 0.0),
            )
            for line in root.list("line")
        ),
        machines=tuple(machines),
    )
    return ReferenceCase(
        network=network,
        machine_keys=tuple(power),
        voltage=voltage,
        events=_read_events(root, base, voltage, loads),
        power=power,
        tolerance=_read_tolerance(root),
        unused=tuple(root.unused),
    )


def _totals(
    root: Fields, key: str, names: tuple[str, str], voltage: Mapping[int, tuple[float, float]]
) -> dict[int, tuple[float, float]]:
    """Sums of two values by bus: a bus may have several loads or shunts, or none."""
    totals = dict.fromkeys(voltage, (0.0, 0.0))
    for entry in root.list(key, required=False):
        bus = entry.bus()
        if bus not in totals:
            raise ValueError(f"{entry.where} is at bus {bus}, which the file does not list")
        first, second = totals[bus]
        totals[bus] = first + entry.number(names[0], 0.0), second + entry.number(names[1], 0.0)
    return totals


def _read_machines(root: Fields, base: float) -> tuple[list[SynchronousMachineParameters], dict[str, complex]]:
    gens, static = root.object("gens"), root.object("gen_static")
    governors, exciters = _of_machines(root, "tgov1", gens), _of_machines(root, "sexs", gens)
    hydro = _of_machines(root, "hygov", gens)
    twice = sorted(governors.keys() & hydro.keys())
    if twice:
        raise ValueError(f"{root.where}: the machine {twice[0]!r} has a tgov1 and a hygov")
    machines, power = [], {}
    shares: dict[int, list[float]] = {}
    for key in gens.data:
        gen = gens.object(key)
        at = static.object(str(gen.bus()))
        share = gen.number("gammap", 1.0), gen.number("gammaq", 1.0)
        power[key] = complex(at.number("P") * share[0], at.number("Q") * share[1])
        total = shares.setdefault(gen.bus(), [0.0, 0.0])
        total[0], total[1] = total[0] + share[0], total[1] + share[1]
        mechanical = power[key].real * base
        governor: GovernorParameters | HydroGovernorParameters | None = None
        if key in governors:
            governor = _read_governor(governors[key], gen, mechanical)
        elif key in hydro:
            governor = _read_hydro_governor(hydro[key], gen, mechanical)
        machines.append(_read_machine(gen, base, power[key].real, share[1], governor, exciters.get(key)))
    if not machines:
        raise ValueError(f"{root.where} has no machine")
    for bus, total in shares.items():
        for name, value in zip(("gammap", "gammaq"), total, strict=True):
            if abs(value - 1.0) > _SHARE_TOLERANCE:
                raise ValueError(f"{name} of the machines at bus {bus} add up to {value:g}, they must add up to 1")
    idle = sorted(set(static.data) - {str(machine.bus) for machine in machines})
    if idle:
        raise ValueError(f"gen_static of {root.where} has buses without a machine: {', '.join(idle)}")
    return machines, power


def _of_machines(root: Fields, kind: str, gens: Fields) -> dict[str, Fields]:
    """Governors or exciters by the key of their machine, at most one each."""
    found: dict[str, Fields] = {}
    for entry in root.list(kind, required=False):
        key, bus = str(entry.get("gen", "")), entry.get("bus")
        if not key:
            bus = entry.bus()
            here = [name for name, gen in gens.data.items() if isinstance(gen, dict) and gen.get("bus") == bus]
            if len(here) != 1:
                raise ValueError(f"{entry.where} must name its machine (gen): bus {bus} has {len(here)} machines")
            key = here[0]
        if key not in gens.data:
            raise ValueError(f"{entry.where} belongs to an unknown machine {key!r}; there are {list(gens.data)}")
        if key in found:
            raise ValueError(f"{entry.where} is the second one of machine {key!r}")
        found[key] = entry
    return found


def _read_machine(
    gen: Fields,
    base: float,
    power: float,
    reactive_share: float,
    governor: GovernorParameters | HydroGovernorParameters | None,
    exciter: Fields | None,
) -> SynchronousMachineParameters:
    model = gen.get("model", "GENCLS")
    if reactive_share < 0.0:
        raise ValueError(f"gammaq of {gen.where} must be 0 or more, got {reactive_share:g}")
    common: dict[str, Any] = {
        "bus": gen.bus(),
        **gen.numbers(rating_mva="Sn", two_h_s="M", x_d_transient="xd1"),
        "damping_pu": gen.number("D", 0.0),
        "resistance": gen.number("ra", 0.0),
        "dispatch_mw": base * power,
        # Only the proportions of the weights count.
        "reactive_weight": base * reactive_share,
        "governor": governor,
    }
    if model == "GENCLS":
        if exciter is not None:
            raise ValueError(f"{gen.where} is a GENCLS with an exciter; its voltage is constant")
        return classical_machine(**common)
    if model != "GENROU":
        raise ValueError(f"model of {gen.where} must be GENCLS or GENROU, got {model!r}")
    if abs(gen.number("xd2") - gen.number("xq2", gen.number("xd2"))) > 1e-12:
        raise ValueError(
            f"{gen.where}: x''_q = {gen.number('xq2'):g} must equal x''_d = {gen.number('xd2'):g} p.u., "
            "so that the network stays a constant admittance"
        )
    if gen.number("S10", 0.0) != 0.0:
        raise ValueError(f"S10 of {gen.where} = {gen.number('S10'):g}: saturation is not modelled, it must be 0")
    gen.get("S12")
    return SynchronousMachineParameters(
        exciter=None if exciter is None else _read_exciter(exciter),
        x_leakage=gen.number("xl"),
        **gen.numbers(x_d="xd", x_q="xq", x_q_transient="xq1", x_subtransient="xd2"),
        **gen.numbers(t_d0_transient_s="Td10", t_d0_subtransient_s="Td20"),
        **gen.numbers(t_q0_transient_s="Tq10", t_q0_subtransient_s="Tq20"),
        **common,
    )


def _gate_limits(entry: Fields, gen: Fields, names: tuple[str, str], gate: float) -> tuple[float, float]:
    low, high = entry.number(names[0]), entry.number(names[1])
    # Losses in the armature may add a little; the start itself is exact.
    if not low <= gate + 1e-9 or not gate <= high + 1e-9:
        raise ValueError(
            f"{entry.where}: its machine at bus {gen.bus()} starts with a gate of {gate:.6g} p.u. of its rating, "
            f"outside the limits {names[0]} … {names[1]} = {low:g} … {high:g}"
        )
    return low, high


def _read_governor(entry: Fields, gen: Fields, power_mw: float) -> GovernorParameters:
    low, high = _gate_limits(entry, gen, ("VMIN", "VMAX"), power_mw / gen.number("Sn"))
    return GovernorParameters(
        **entry.numbers(droop_pu="R", gate_time_s="T1", reheat_time_s="T3"),
        lead_time_s=entry.number("T2"),
        gate_min_pu=low,
        gate_max_pu=high,
        turbine_damping_pu=entry.number("Dt", 0.0),
        dead_band_pu=entry.number("db", 0.0),
    )


def _read_hydro_governor(entry: Fields, gen: Fields, power_mw: float) -> HydroGovernorParameters:
    given = entry.numbers(
        droop_pu="R",
        temporary_droop_pu="r",
        reset_time_s="Tr",
        filter_time_s="Tf",
        gate_time_s="Tg",
        gate_rate_limit_pu_s="VELM",
        water_time_s="Tw",
        turbine_gain="At",
    )
    no_load_flow = entry.number("qNL")
    gate = power_mw / gen.number("Sn") / given["turbine_gain"] + no_load_flow
    low, high = _gate_limits(entry, gen, ("GMIN", "GMAX"), gate)
    return HydroGovernorParameters(
        **given,
        gate_min_pu=low,
        gate_max_pu=high,
        turbine_damping_pu=entry.number("Dt", 0.0),
        no_load_flow_pu=no_load_flow,
        dead_band_pu=entry.number("db", 0.0),
    )


def _read_exciter(entry: Fields) -> ExciterParameters:
    return ExciterParameters(
        **entry.numbers(gain="K", lag_time_s="TB", exciter_time_s="TE"),
        lead_lag_ratio=entry.number("TATB"),
        field_min_pu=entry.number("EMIN"),
        field_max_pu=entry.number("EMAX"),
    )


def _read_events(
    root: Fields, base: float, voltage: Mapping[int, tuple[float, float]], loads: Mapping[int, tuple[float, float]]
) -> dict[str, tuple[LoadStep, ...]]:
    lists = root.get("events", {})
    # One list needs no name.
    named = {"": lists} if isinstance(lists, list) else lists
    holder = Fields(named, f"events of {root.where}", root.unused)
    found = {}
    for name in holder.data:
        events, lost = [], dict.fromkeys(voltage, 0.0)
        for entry in holder.list(name):
            bus = entry.bus()
            if bus not in voltage:
                raise ValueError(f"{entry.where} is at bus {bus}, which the file does not list")
            trip = _tripped_share(entry, bus, base, loads[bus][0])
            lost[bus] += trip
            if lost[bus] > 1.0 + _SHARE_TOLERANCE:
                raise ValueError(f"{entry.where} disconnects more than bus {bus} has left of its load")
            events.append(_read_event(entry, bus, base, voltage[bus][0] ** 2, trip, loads[bus]))
        found[name] = tuple(sorted(events, key=lambda event: event.time_s))
    return found


def _tripped_share(entry: Fields, bus: int, base: float, load: float) -> float:
    """The share of a bus's load that an event disconnects; a part of a load takes its reactive power along."""
    trip = entry.number("trip_load_MW", 0.0) / base
    if trip == 0.0:
        return 0.0
    if load == 0.0 or not 0.0 <= trip / load <= 1.0 + _SHARE_TOLERANCE:
        raise ValueError(
            f"{entry.where} disconnects {base * trip:g} MW, but bus {bus} has a load of {base * load:g} MW"
        )
    return min(trip / load, 1.0)


def _read_event(
    entry: Fields, bus: int, base: float, square: float, trip: float, load: tuple[float, float]
) -> LoadStep:
    """An event as the power its admittance takes at the bus's initial voltage, whose square is given [p.u.]."""
    if not {"trip_load_MW", "dG_pu", "dB_pu"} & set(entry.data):
        raise ValueError(f"{entry.where} must give dG_pu, dB_pu or trip_load_MW, got {sorted(entry.data)}")
    # dG_pu in MW, for people.
    entry.get("MW_at_V0")
    return LoadStep(
        time_s=entry.number("t"),
        bus=bus,
        power_mw=base * (entry.number("dG_pu", 0.0) * square - trip * load[0]),
        reactive_mvar=base * (-entry.number("dB_pu", 0.0) * square - trip * load[1]),
    )


def _read_tolerance(root: Fields) -> dict[str, float]:
    given = Fields(root.get("tolerance", {}), f"tolerance of {root.where}", root.unused)
    unknown = sorted(set(given.data) - set(DEFAULT_TOLERANCE))
    if unknown:
        raise ValueError(f"{given.where} has unknown quantities {unknown}; known: {sorted(DEFAULT_TOLERANCE)}")
    return {key: given.number(key, default, positive=True) for key, default in DEFAULT_TOLERANCE.items()}
