"""A power-flow case as a library reads and solves it, made into a grid whose own power flow must be the same."""

import cmath
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from wtg_gym.physics import machine_parameters, network, plant
from wtg_gym.physics.grid import MOST_BUSES, Branch, Bus, Grid, NetworkCase
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters

Key = Hashable
Record = TypeVar("Record")
#: System base of every grid that is read [MVA].
BASE_MVA = 100.0
#: Largest difference from the library's solution [p.u., rad].
TOLERANCE = 1e-6
#: Phase shift around a loop that counts as one [rad].
_LEAST_SHIFT = 1e-9
#: Notes of readers.
NO_SLACK = "the case names no slack bus; the voltage-controlled bus with the largest generator is taken: {}"
OFF = "buses out of service with {:.6g} MW of load: {}"
_OTHER = "the grid would not be the one of the file"
#: Difference between a load and what the solution takes that rounding makes [MVA].
_NO_CHANGE_MVA = 1e-4
#: Power from which on a limit means none [MW, Mvar]: files have 9900 or 9999.
UNLIMITED = 9000.0


@dataclass
class TwoPort:
    """A branch: admittances and a ratio, all in p.u. of :data:`BASE_MVA` and the nominal voltages of its buses."""

    name: str  # in messages
    ends: tuple[Key, Key]  # the ideal transformer of ratio `tap` and shift `phase_rad` is at the first
    impedance: complex
    shunts: tuple[complex, complex] = (0j, 0j)  # to earth at either end, behind the ideal transformer
    tap: float = 1.0
    phase_rad: float = 0.0


@dataclass(kw_only=True)
class Infeed:
    """A generator in service: its power, its kind and its size, if known."""

    name: str
    bus: Key
    power: complex  # [MVA]
    machine_id: str = "1"
    #: "machine", "wind" for a wind park, "static" for what becomes a negative load, "load" once it is one.
    role: str = "machine"
    rating_mva: float | None = None  # MBASE of a RAW file
    least_mva: float = 0.0  # rating that its limits ask for
    limits_mvar: tuple[float, float] = (-math.inf, math.inf)
    impedance: complex = 1j  # ZSORCE of a RAW file [p.u. of the rating]


@dataclass
class SolvedCase:
    """What a library says of a case, with its own solution of the power flow."""

    name: str
    library: str
    frequency_hz: float
    slack: Key
    voltages: dict[Key, complex]  # of every bus [p.u.]
    load_mw: float = 0.0  # of all in the solution: what generators give beyond losses and shunts
    places: dict[Key, tuple[float, float]] = field(default_factory=dict)
    numbers: dict[Key, int] = field(default_factory=dict)  # of the buses, where the file has some
    branches: list[TwoPort] = field(default_factory=list)
    loads: dict[Key, complex] = field(default_factory=lambda: defaultdict(complex))  # in the solution [MVA]
    shunts: dict[Key, complex] = field(default_factory=lambda: defaultdict(complex))  # [p.u. of BASE_MVA]
    infeeds: list[Infeed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # what was assumed or changed

    def add_load(self, bus: Key, name: Any, load: complex, taken: complex) -> None:
        """Add the load at a bus, which is called `name` in notes, as the solution takes it [MVA]."""
        # No value stands for a part that is 0.
        taken = complex(*(b if math.isnan(a) else a for a, b in ((taken.real, load.real), (taken.imag, load.imag))))
        if abs(taken - load) > _NO_CHANGE_MVA:
            what = f"the load at {name} is no constant power (constant impedance or current)"
            self.notes.append(f"{what}: {taken:.6g} MVA are taken, not {load:.6g}")
            load = taken
        self.loads[bus] += load


def refuse_unread(unread: dict[str, tuple[int, float]], drop: Collection[str], notes: list[str]) -> None:
    """Refuse elements, number and power [MW] by type, unless `drop` names their type; then note that they are left."""
    texts = {kind: f"{n} × {kind} with {power:.6g} MW" for kind, (n, power) in unread.items() if n}
    if left := {kind: text for kind, text in texts.items() if kind not in drop}:
        listed = ", ".join(left.values())
        raise ValueError(f"it has what no grid here has: {listed}; --drop {' '.join(left)} leaves that out")
    notes += [f"left out: {text}" for text in texts.values()]


def grid_of(case: SolvedCase, dynamics: Any = None, drop: Collection[str] = ()) -> Grid:
    """Return the grid of a solved case, without WTG groups, after its own power flow has met the library's.

    The case is changed. Its wind parks are typical machines, marked as replaced; without `dynamics` all machines are
    typical. Types of element in `drop` are left out. A ValueError says by the bus and both values that the grid is
    not the case, or that a value is out of its range.
    """
    _merge_buses(case)
    _take_connected(case, drop)
    refuse_large(len(case.voltages))
    turned = _without_common_shifts(case)
    numbers = _numbers(case)
    records = _machines(case, numbers, dynamics)
    wind = {numbers[infeed.bus] for infeed in case.infeeds if infeed.role == "wind"}
    network_case = _network_case(case, numbers, records)
    _note_limits(case, numbers)
    differences = _compare(network_case, case, numbers, turned)
    case.notes.append(f"its power flow is that of {case.library}; largest differences [p.u., rad]: {differences}")
    return Grid(case=network_case, replaced=tuple(sorted(wind)), substitutions=tuple(dict.fromkeys(case.notes)))


def refuse_large(n_buses: int) -> None:
    """Refuse a case with more buses than a grid has."""
    if n_buses > MOST_BUSES:
        raise ValueError(f"it has {n_buses} buses; a grid has at most {MOST_BUSES}")


def _merge_buses(case: SolvedCase) -> None:
    """Make one bus of those that branches without impedance join, and take these branches away."""
    import networkx

    joined, kept = networkx.Graph(), []
    for branch in case.branches:
        if abs(branch.impedance) >= network.LEAST_IMPEDANCE:
            kept.append(branch)
            continue
        if abs(branch.tap - 1.0) > 1e-9 or branch.phase_rad:
            raise ValueError(f"{branch.name} is a transformer without impedance")
        for end, shunt in zip(branch.ends, branch.shunts, strict=True):
            case.shunts[end] += shunt
        joined.add_edge(*branch.ends)
        case.notes.append(f"{branch.name} has no impedance: its buses are one")
    bus_of = {key: key for key in case.voltages}
    for part in networkx.connected_components(joined):
        first = case.slack if case.slack in part else next(key for key in joined if key in part)
        for other in part - {first}:
            bus_of[other] = first
            for values in (case.loads, case.shunts):
                values[first] += values.pop(other, 0j)
            case.voltages.pop(other)
    case.branches = [replace(branch, ends=(bus_of[branch.ends[0]], bus_of[branch.ends[1]])) for branch in kept]
    case.branches = [branch for branch in case.branches if branch.ends[0] != branch.ends[1]]
    for infeed in case.infeeds:
        infeed.bus = bus_of[infeed.bus]


def _graph(case: SolvedCase) -> Any:
    """Return buses and branches as a graph, whose lines weigh less than its phase shifts."""
    import networkx

    graph = networkx.MultiGraph()
    graph.add_nodes_from(case.voltages)
    for branch in case.branches:
        graph.add_edge(*branch.ends, branch=branch, weight=float(branch.phase_rad != 0.0))
    return graph


def _take_connected(case: SolvedCase, drop: Collection[str]) -> None:
    """Take away the buses that no branch joins to the slack bus, and refuse those that have power."""
    import networkx

    powers = dict.fromkeys(case.voltages, 0.0)
    for bus, power in (*case.loads.items(), *((infeed.bus, infeed.power) for infeed in case.infeeds)):
        powers[bus] += abs(power.real)
    parts = list(networkx.connected_components(_graph(case)))
    (connected,) = (part for part in parts if case.slack in part)
    live = [mw for part in parts if part is not connected and (mw := sum(powers[bus] for bus in part))]
    refuse_unread({"island": (len(live), sum(live))}, drop, case.notes)
    apart = [key for key in case.voltages if key not in connected]
    if apart and not live:
        texts = [case.numbers.get(key, key) for key in apart]
        case.notes.append(f"buses without connection to the slack bus are left out: {listed(texts)}")
    case.load_mw -= sum(case.loads[key].real for key in apart if case.voltages[key] and key in case.loads)
    case.branches = [branch for branch in case.branches if branch.ends[0] in connected]
    case.infeeds = [infeed for infeed in case.infeeds if infeed.bus in connected]
    for values in (case.voltages, case.loads, case.shunts):
        for key in values.keys() - connected:
            del values[key]


def listed(keys: Iterable[Any]) -> str:
    """Return the first keys of many as a text."""
    texts = [str(key) for key in keys]
    return ", ".join(texts[:20]) + (f" and {len(texts) - 20} more" if len(texts) > 20 else "")


def _without_common_shifts(case: SolvedCase) -> dict[Key, float]:
    """Take away phase shifts that are the same along every path; return the angle that each bus turns by [rad]."""
    # A tree of as few shifts as possible lets a phase shifter beside lines keep its own.
    import networkx

    tree = networkx.minimum_spanning_tree(_graph(case))
    turned = {case.slack: 0.0}
    for one, other in networkx.bfs_edges(tree, case.slack):
        (edge,) = tree[one][other].values()
        shift = edge["branch"].phase_rad
        turned[other] = turned[one] + (-shift if edge["branch"].ends == (one, other) else shift)
    for branch in case.branches:
        one, other = branch.ends
        rest = math.remainder(branch.phase_rad - turned[one] + turned[other], 2.0 * math.pi)
        branch.phase_rad = 0.0 if abs(rest) < _LEAST_SHIFT else rest
    if n := sum(angle != 0.0 for angle in turned.values()):
        case.notes.append(f"phase shifts that are the same along every path are left out: {n} buses turn with them")
    if shifters := [branch.name for branch in case.branches if branch.phase_rad]:
        case.notes.append(f"phase shifters, at a constant shift: {listed(shifters)}")
    return turned


def _numbers(case: SolvedCase) -> dict[Key, int]:
    """Return the number of each bus: the file's, or its place, which a note says."""
    named = {key: case.numbers[key] for key in case.voltages if key in case.numbers}
    unused = itertools.count(max(case.numbers.values(), default=0) + 1)
    numbers = {key: named[key] if key in named else next(unused) for key in case.voltages}
    if not named:
        case.notes.append("bus numbers: " + ", ".join(f"{key} = {number}" for key, number in numbers.items()))
    return numbers


def _machines(case: SolvedCase, numbers: dict[Key, int], dynamics: Any) -> list[SynchronousMachineParameters]:
    records: list[SynchronousMachineParameters] = []
    buses = {infeed.bus for infeed in case.infeeds if infeed.role == "machine"}
    for infeed in case.infeeds:
        number, slack, record = numbers[infeed.bus], infeed.bus == case.slack, None
        if infeed.role == "machine":
            least = infeed.rating_mva or (infeed.least_mva if infeed.least_mva < UNLIMITED else 0.0)
            if dynamics is None:
                record = typical_machine(number, infeed.power, least, slack=slack)
            else:
                record = dynamics.machine(number, infeed, slack)
        elif infeed.role == "wind" and infeed.power.real > 0.0 and infeed.bus not in buses:
            record = typical_machine(number, infeed.power, infeed.least_mva)
            case.notes.append(f"{infeed.name} at bus {number} is a wind park of {infeed.power.real:.6g} MW")
        if record is not None:
            records.append(record)
            continue
        infeed.role, case.loads[infeed.bus] = "load", case.loads[infeed.bus] - infeed.power
        if infeed.power:
            what = f"{infeed.name} at bus {number} is a negative load"
            case.notes.append(f"{what}: {-infeed.power.real:.6g} MW, {-infeed.power.imag:.6g} Mvar")
    if dynamics is not None:
        dynamics.require_known()
    elif records:
        case.notes.append(f"the file has no dynamic data; all {len(records)} machines are typical ones")
    return records


def _note_limits(case: SolvedCase, numbers: dict[Key, int]) -> None:
    """Note machines whose reactive power in the solution is beyond their limits, which a grid does not have."""
    beyond = [
        f"{each.name} at bus {numbers[each.bus]} {each.power.imag:.4g} ({least:g} … {most:g})"
        for each in case.infeeds
        for least, most in [each.limits_mvar]
        # Equal ones, as 0 of an external grid, or NaN mean none.
        if each.role == "machine"
        and least < most
        and (each.power.imag < least - _NO_CHANGE_MVA or each.power.imag > most + _NO_CHANGE_MVA)
    ]
    if beyond:
        case.notes.append(f"reactive limits are not kept; beyond theirs [Mvar]: {listed(beyond)}")


#: Rating over the apparent power that a machine gives, and the least one [MVA]: a power flow may ask a small condenser
#: for more reactive power than its limits allow.
_MARGIN, _LEAST_MVA = 1.3, 50.0
#: A large round-rotor machine; source: P. Kundur: Power System Stability and Control, table 4.2.
_REACTANCES = dict(x_d=1.8, x_q=1.7, x_d_transient=0.3, x_q_transient=0.55, x_subtransient=0.25, x_leakage=0.15)
_TIMES = dict(t_d0_transient_s=8.0, t_q0_transient_s=0.4, t_d0_subtransient_s=0.03, t_q0_subtransient_s=0.05)
TYPICAL_EXCITER = machine_parameters.ExciterParameters()
TYPICAL_GOVERNOR = machine_parameters.GovernorParameters(droop_pu=0.05)


def typical_machine(
    bus: int, power: complex = 0j, least: float = _LEAST_MVA, *, slack: bool = False
) -> SynchronousMachineParameters:
    """Return a machine that gives a power [MW + j Mvar], of a least rating [MVA]; without active power a condenser."""
    governed = power.real > 0.0 or slack
    values: dict[str, Any] = {"dispatch_mw": power.real, "damping_pu": 0.0, **_REACTANCES, **_TIMES}
    return SynchronousMachineParameters(
        **values,
        bus=bus,
        rating_mva=max(_MARGIN * abs(power), least, _LEAST_MVA),
        two_h_s=8.0 if governed else 3.0,
        exciter=TYPICAL_EXCITER,
        governor=TYPICAL_GOVERNOR if governed else None,
        # All of the machines have fast exciters, under which they would swing against each other.
        stabiliser=machine_parameters.SpeedStabiliserParameters() if governed else None,
    )


def _network_case(
    case: SolvedCase, numbers: dict[Key, int], machines: list[SynchronousMachineParameters]
) -> NetworkCase:
    held = {machine.bus for machine in machines}
    if numbers[case.slack] not in held:
        raise ValueError(f"no machine is at the slack bus {numbers[case.slack]}")
    branches = []
    for branch in case.branches:
        (one, other), (near, far) = branch.ends, branch.shunts
        charging = 2.0 * far.imag
        case.shunts[one] += (near - 0.5j * charging) / branch.tap**2
        case.shunts[other] += far.real
        values: dict[str, Any] = {"from_bus": numbers[one], "to_bus": numbers[other], "charging": charging}
        values |= {"resistance": branch.impedance.real, "reactance": branch.impedance.imag}
        branches.append(made(branch.name, Branch, **values, tap=branch.tap, phase_rad=branch.phase_rad))
    buses = []
    for key, voltage in case.voltages.items():
        load, shunt, number = case.loads.get(key, 0j), BASE_MVA * case.shunts.get(key, 0j), numbers[key]
        x, y = case.places.get(key, (None, None))
        values = {"load_mw": load.real, "load_mvar": load.imag, "shunt_mw": shunt.real, "shunt_mvar": shunt.imag}
        values["voltage_pu"] = round(abs(voltage), 9) if number in held else None
        buses.append(made(f"bus {number}", Bus, number=number, **values, x=x, y=y))
    return NetworkCase(
        name=case.name,
        base_mva=BASE_MVA,
        frequency_hz=case.frequency_hz,
        slack_bus=numbers[case.slack],
        buses=tuple(buses),
        branches=tuple(branches),
        machines=tuple(machines),
    )


def power_flow(case: NetworkCase) -> tuple[np.ndarray, np.ndarray]:
    """Return voltages (n_bus,) and what units give to each bus (n_bus,), both complex [p.u.], from a flat start."""
    tables = plant.plant_tables(plant.Plant(case=case, groups=()))
    facts, buses = tables.network.facts, tables.buses
    loads = buses["load.re"] + 1j * buses["load.im"]
    injections = -loads
    np.add.at(injections, tables.network.unit_bus, [m.dispatch_mw / case.base_mva for m in case.machines])
    at = network.PowerFlow(power=0, polar=2, holds_voltage=4, flow=5, voltage=7)
    rows = np.zeros((buses.size, 9))
    rows[:, 0], rows[:, 1] = injections.real, injections.imag
    rows[:, 2], rows[:, 4] = buses["voltage"], buses["holds_voltage"]
    if facts.is_large:
        steps = network.solve_sparse_flow(tables.bus_y, facts.slack, rows, at, tables.network.pattern)
    else:
        steps = network.solve_power_flow(tables.bus_y, facts.slack, rows, at)
    if steps < 0:
        raise ValueError("its power flow has no solution from a flat start, from which every scenario starts")
    return rows[:, 7] + 1j * rows[:, 8], rows[:, 5] + 1j * rows[:, 6] + loads


def _compare(made: NetworkCase, case: SolvedCase, numbers: dict[Key, int], turned: dict[Key, float]) -> str:
    """Refuse a grid whose power flow differs from the library's; say how near they are."""
    voltages, powers = power_flow(made)
    injections, largest = defaultdict[Key, complex](complex), defaultdict[str, float](float)
    for infeed in case.infeeds:
        injections[infeed.bus] += infeed.power / BASE_MVA if infeed.role != "load" else 0j
    reference = cmath.phase(case.voltages[case.slack])
    for place, (key, theirs) in enumerate(case.voltages.items()):
        if cmath.isnan(theirs):
            # The library does not say.
            continue
        angle = cmath.phase(theirs) - reference - turned[key]
        pairs = {"voltage": (abs(voltages[place]), abs(theirs)), "angle": (cmath.phase(voltages[place]), angle)}
        if made.buses[place].voltage_pu is not None:
            pairs["power"] = powers[place].real, injections[key].real
            pairs["reactive power"] = powers[place].imag, injections[key].imag
        for what, (here, there) in pairs.items():
            difference = abs(math.remainder(here - there, 2.0 * math.pi) if what == "angle" else here - there)
            difference /= max(1.0, abs(there))
            largest[what] = max(largest[what], difference)
            if not difference <= TOLERANCE:
                unit = "rad" if what == "angle" else "p.u."
                raise ValueError(
                    f"bus {numbers[key]}: {what} {here:.9g} {unit} here, {there:.9g} {unit} in {case.library}; {_OTHER}"
                )
    load_mw = made.load_mw + sum(infeed.power.real for infeed in case.infeeds if infeed.role == "load")
    largest["total load"] = abs(load_mw - case.load_mw) / max(BASE_MVA, abs(case.load_mw))
    if not largest["total load"] <= TOLERANCE:
        raise ValueError(f"total load {load_mw:.9g} MW here, {case.load_mw:.9g} MW in {case.library}; {_OTHER}")
    return ", ".join(f"{what} {difference:.1e}" for what, difference in largest.items())


def made(what: str, record: Callable[..., Record], **values: Any) -> Record:
    """Return a record of checked values; its error says what it is of."""
    try:
        return record(**values)
    except ValueError as error:
        raise ValueError(f"{what}: {str(error).partition(': ')[2] or error}") from error
