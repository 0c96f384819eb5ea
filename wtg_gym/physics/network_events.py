"""The network as the units see it: Kron reduction per topology, and what events and islands change in it."""

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from wtg_gym.physics.devices import SOURCES
from wtg_gym.physics.layout import OF_ENV, BatchData, Facts, Floats, Network, Whole, offsets_of, place_of, units_of
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.network import eliminate
from wtg_gym.physics.units import BUSES, ISLANDS, UNITS
from wtg_gym.systems.compiled import addressed, allocating, compiled, internal
from wtg_gym.systems.programs import Complex
from wtg_gym.systems.routines import Function

_GATE, _REFERENCE, _DROOP = (place_of(MACHINES, name) for name in ("gate", "gate_reference", "inv_droop"))
_OF_BUS, _OF_UNIT, _OF_ISLAND = offsets_of(BUSES), offsets_of(UNITS), offsets_of(ISLANDS)
_SOURCE_ANGLE, _SOURCE_RAMP = place_of(SOURCES, "angle"), place_of(SOURCES, "ramp")


class _Rows(NamedTuple):
    """Views of one environment's rows in a block: all of them, and those of each unit (n_units, n_rows)."""

    all: Floats  # (n_rows,)
    env: Floats  # (n_rows,)
    machines: Floats
    units: Floats
    pairs: Floats
    stages: Floats  # of shedding (n_islands, n_stages)
    buses: Floats
    islands: Floats
    transfers: Floats  # (0, n_rows) where the plant has none
    sources: Floats


@allocating
def _rows_of(block: Floats, x: int, facts: Facts) -> _Rows:
    return _Rows(
        block[:, x],
        units_of(block, facts.env)[0, :, x],
        units_of(block, facts.machines)[:, :, x],
        units_of(block, facts.units)[:, :, x],
        units_of(block, facts.pairs)[:, :, x],
        units_of(block, facts.stages)[:, :, x],
        units_of(block, facts.buses)[:, :, x],
        units_of(block, facts.islands)[:, :, x],
        units_of(block, facts.transfers)[:, :, x],
        units_of(block, facts.sources)[:, :, x],
    )


@internal
def _write(rows: Floats, at: int, value: complex) -> None:
    rows[at], rows[at + 1] = value.real, value.imag


@addressed
def refresh_network(block: Floats, x: int, env: int, network: Network, data: BatchData) -> None:
    """Kron-reduce the network of one environment as it is from its present step on, and note when it changes next.

    Units and governors that events take away are switched off, and sources are moved. Load ramps are staircases:
    constant until the next change, at the value of the middle. So is the conductance of loads that depend on the
    frequency, at that of its beginning.
    """
    facts, events, rows = network.facts, data.events[env], _rows_of(block, x, network.facts)
    step = rows.env[OF_ENV.step]
    following, opens_lines = math.inf, False
    for e in range(events.shape[0]):
        opens_lines |= events[e].branch >= 0
        following = min(following, _next_change(events[e], step, facts))
        _strike(events[e], step, rows, network)
    if facts.load_frequency_dependence > 0.0:
        following = min(following, _next_interval(step, facts))
    rows.env[OF_ENV.last_change], rows.env[OF_ENV.next_change] = step, following
    if facts.islands.n_units > 1 and opens_lines:
        _islands(network.code, (block, x, env, network, data))
    _shed(rows, network, events)
    _reduce(rows, network, events)


@allocating
def _reduce(rows: _Rows, network: Network, events: Any) -> None:
    n, n_bus = network.unit_y.shape[0], network.shunts.shape[0]
    # Columns of the bus impedance matrix: of the units' buses, then of the load noise's.
    z, unit_y = np.empty((n_bus, n_bus + n + 1), dtype=np.complex128), np.empty(n, dtype=np.complex128)
    _assemble(z, unit_y, rows, network, events)
    _write_reduced(z, unit_y, np.empty(z.shape[1], dtype=np.int64), rows, network)


@internal
def _write_reduced(z: Complex, unit_y: Complex, filled: Whole, rows: _Rows, network: Network) -> None:
    """Write Y_red = diag(y) - diag(y) Z diag(y), transfers to and from the noise bus, impedances there."""
    noise_bus = int(rows.env[OF_ENV.noise_bus])
    n, n_bus = network.unit_y.shape[0], network.shunts.shape[0]
    for k in range(n_bus):
        for i in range(n):
            z[k, n_bus + i] = 1.0 if network.unit_bus[i] == k else 0.0
        z[k, n_bus + n] = 1.0 if k == noise_bus else 0.0
    eliminate(z, filled)
    pair, transfer = 0, 0
    for i in range(n):
        bus = network.unit_bus[i]
        for j in range(n):
            value = -unit_y[i] * z[bus, n_bus + j] * unit_y[j]
            if i == j:
                value += unit_y[i]
            _write(rows.pairs[pair], 0, value)
            pair += 1
        there = back = unit_y[i] * z[bus, n_bus + n]
        if network.facts.shifts_phases:
            back = unit_y[i] * z[noise_bus, n_bus + i]
        _write(rows.units[i], _OF_UNIT.transfer, there)
        _write(rows.units[i], _OF_UNIT.transfer_back, back)
    _write(rows.env, OF_ENV.noise_z, z[noise_bus, n_bus + n])
    # What every unit's voltage brings to every bus, and what the load noise takes there.
    for k in range(n_bus):
        _write(rows.buses[k], _OF_BUS.noise_transfer, z[k, n_bus + n])
        for i in range(n if rows.transfers.shape[0] > 0 else 0):
            _write(rows.transfers[transfer], 0, z[k, n_bus + i] * unit_y[i])
            transfer += 1


@internal
def _next_interval(step: float, facts: Facts) -> float:
    return float((math.floor(step / facts.n_substeps) + 1.0) * facts.n_substeps)


@internal
def _next_change(event: Any, step: float, facts: Facts) -> float:
    if step < event.start:
        return float(event.start)
    if step < event.end:
        return float(min(_next_interval(step, facts), event.end) if event.bus >= 0 else event.end)
    return math.inf


@internal
def _strike(event: Any, step: float, rows: _Rows, network: Network) -> None:
    begins, ends = step == event.start, step == event.end and event.end > event.start
    if event.unit >= 0 and begins:
        rows.all[network.connected[event.unit]] = 0.0
    if event.governor >= 0 and step >= event.start:
        machine = rows.machines[event.governor]
        if machine[_DROOP] > 0.0:
            # The gate stays where it is, whatever the speed.
            machine[_REFERENCE], machine[_DROOP] = machine[_GATE], 0.0
    if event.source >= 0:
        source = rows.sources[event.source]
        if begins:
            source[_SOURCE_ANGLE] += event.jump
            source[_SOURCE_RAMP] += event.ramp
        if ends:
            source[_SOURCE_RAMP] -= event.ramp


@internal
def _ramped(event: Any, step: float, at: float) -> float:
    """Return the share of its load that an event has reached at `at`, steps since the run's start, seen from `step`."""
    return 1.0 if step >= event.end else (at - event.start) / (event.end - event.start)


# Loops: to assign rows as numpy does takes two seconds of compiling, for the message of an error.
@allocating
def _copy_of(rows: Floats) -> Floats:
    copy = np.empty(rows.shape)
    for i in range(rows.shape[0]):
        _copy(rows, i, copy, i)
    return copy


@internal
def _copy(source: Floats, row: int, target: Floats, to_row: int) -> None:
    for k in range(source.shape[1]):
        target[to_row, k] = source[row, k]


@addressed
def find_islands(block: Floats, x: int, env: int, network: Network, data: BatchData) -> None:
    """Number the parts of the network that hang together and have a unit: by the load of the start, the most first.

    What protections remember of an island goes with most of its load, when it falls apart and when parts join. Units of
    a part that joins another are counted from the same turn.
    """
    rows = _rows_of(block, x, network.facts)
    part = _parts_of(rows.env[OF_ENV.step], network, data.events[env])
    number = _numbers_of(part, rows, network)
    islands, stages = _copy_of(rows.islands), _copy_of(rows.stages)
    rows.env[OF_ENV.split] = 0.0
    for p in range(number.shape[0]):
        if number[p] >= 0:
            before = _island_before(part, p, rows)
            _copy(islands, before, rows.islands, number[p])
            _copy(stages, before, rows.stages, number[p])
            _turn_units(part, p, islands[:, _OF_ISLAND.turned], before, rows, network)
            if number[p] > 0:
                rows.env[OF_ENV.split] = 1.0
    for k in range(part.shape[0]):
        rows.buses[k, _OF_BUS.island] = number[part[k]]
    for i in range(network.unit_bus.shape[0]):
        rows.units[i, _OF_UNIT.island] = number[part[network.unit_bus[i]]]


#: Compiled for plants that can fall apart alone.
FIND_ISLANDS = Function(find_islands, 3, numba.types.none)
_islands = FIND_ISLANDS.call


@internal
def _is_open(branch: int, step: float, events: Any) -> bool:
    """Return whether an event holds a branch open at a step."""
    is_open = False
    for e in range(events.shape[0]):
        event = events[e]
        opens = event.branch == branch and event.factor == 0.0
        is_open |= opens and step >= event.start and not (event.end > event.start and step >= event.end)
    return is_open


@allocating
def _parts_of(step: float, network: Network, events: Any) -> Whole:
    """Return the first bus of the part of the network that each bus is in at a step (n_bus,)."""
    part, moved = np.arange(network.shunts.shape[0]), True
    while moved:
        moved = False
        for b in range(network.branch_ends.shape[0]):
            if not _is_open(b, step, events):
                first, second = network.branch_ends[b]
                lower = min(part[first], part[second])
                moved |= part[first] != lower or part[second] != lower
                part[first], part[second] = lower, lower
    return part


@allocating
def _numbers_of(part: Whole, rows: _Rows, network: Network) -> Whole:
    """Return the number of the island that each part is, at the place of its first bus (n_bus,); -1 for no island."""
    loads, lives = np.zeros(part.shape[0]), np.zeros(part.shape[0], dtype=np.bool_)
    for k in range(part.shape[0]):
        loads[part[k]] += rows.buses[k, _OF_BUS.load]
    for i in range(network.unit_bus.shape[0]):
        lives[part[network.unit_bus[i]]] |= rows.all[network.connected[i]] > 0.5
    number = np.full(part.shape[0], -1)
    for island in range(rows.islands.shape[0]):
        best = -1
        for p in range(part.shape[0]):
            # The grid is that with the most load, dead or alive.
            if (lives[p] or island == 0) and number[p] < 0 and (best < 0 or loads[p] > loads[best]):
                best = p
        if best >= 0:
            number[best] = island
    return number


@allocating
def _island_before(part: Whole, p: int, rows: _Rows) -> int:
    """Return the island that most of a part's load was in; a bus without load counts a little."""
    loads = np.zeros(rows.islands.shape[0])
    for k in range(part.shape[0]):
        island = int(rows.buses[k, _OF_BUS.island])
        if part[k] == p and island >= 0:
            loads[island] += rows.buses[k, _OF_BUS.load] + 1e-9
    return int(loads.argmax())


@internal
def _turn_units(part: Whole, p: int, turned: Floats, before: int, rows: _Rows, network: Network) -> None:
    """Count the angles of a part's units from the same turn as the island that most of it was."""
    for i in range(network.unit_bus.shape[0]):
        island = int(rows.units[i, _OF_UNIT.island])
        if part[network.unit_bus[i]] == p and island >= 0 and network.angles[i] >= 0:
            behind = turned[before] - turned[island]
            rows.all[network.angles[i]] += 2.0 * math.pi * math.floor(behind / (2.0 * math.pi) + 0.5)


@internal
def _shed(rows: _Rows, network: Network, events: Any) -> None:
    """Take the load that the stages of its island shed at this step from every bus, and sum the load not served."""
    step, unserved = rows.env[OF_ENV.step], 0.0
    for k in range(network.shunts.shape[0]):
        bus = rows.buses[k]
        island, load = int(bus[_OF_BUS.island]), bus[_OF_BUS.load]
        for e in range(events.shape[0]):
            event = events[e]
            if event.bus == k and step >= event.start:
                load += event.active * _ramped(event, step, step)
        for s in range(network.shed_shares.shape[0] if island >= 0 else 0):
            if step >= 0.0 and -1.0 - rows.stages[island, s] == step:
                bus[_OF_BUS.served] = max(bus[_OF_BUS.served] - network.shed_shares[s], 0.0)
        unserved += max(load, 0.0) * (1.0 - (bus[_OF_BUS.served] if island >= 0 else 0.0))
    rows.env[OF_ENV.unserved] = unserved


@internal
def _add_branches(y: Complex, step: float, network: Network, events: Any) -> None:
    """Add the branches that are closed at a step, with the impedances that they have then, to an admittance matrix."""
    for b in range(network.branch_ends.shape[0]):
        if not _is_open(b, step, events):
            # Of several changes of its impedance the last one holds.
            factor, latest = 1.0, -1.0
            for e in range(events.shape[0]):
                event = events[e]
                if event.branch == b and event.factor > 0.0 and latest <= event.start <= step:
                    factor, latest = event.factor, event.start
            for i in range(4):
                value = network.branch_y[b, i]
                if factor != 1.0:
                    value += (1.0 / factor - 1.0) * network.branch_series[b, i]
                y[network.branch_ends[b, i // 2], network.branch_ends[b, i % 2]] += value


@internal
def _load_of(bus: Floats, rows: _Rows, facts: Facts) -> complex:
    """Return the admittance of a bus's load, before shedding [p.u.]."""
    load = complex(bus[_OF_BUS.load], bus[_OF_BUS.load + 1])
    if facts.load_frequency_dependence > 0.0:
        deviation = rows.islands[max(int(bus[_OF_BUS.island]), 0), _OF_ISLAND.centre] - 1.0
        load = complex(load.real * (1.0 + facts.load_frequency_dependence * deviation), load.imag)
    return load


@compiled
def assemble(y: Complex, unit_y: Complex, block: Floats, network: Network, data: BatchData) -> None:
    """Write the internal admittance of every unit of an environment and its bus admittances, without load noise [p.u.].

    They are written to `unit_y` (n_unit,) and the first n_bus columns of `y` (n_bus, n), for the first environment of
    block and data. A unit that is disconnected has none, from the instant on at which a protection trips it. Else the
    matrix is that of the network as it was last reduced, with its loads and events. The step of that decides which
    events have struck; ramps have come half the way to the next change. A bus without voltage stands alone.
    """
    _assemble(y, unit_y, _rows_of(block, 0, network.facts), network, data.events[0])


@internal
def _assemble(y: Complex, unit_y: Complex, rows: _Rows, network: Network, events: Any) -> None:
    n, step = network.shunts.shape[0], rows.env[OF_ENV.last_change]
    middle = 0.5 * (step + rows.env[OF_ENV.next_change])
    y[:, :n] = 0.0
    for k in range(n):
        y[k, k] = network.shunts[k] + rows.buses[k, _OF_BUS.served] * _load_of(rows.buses[k], rows, network.facts)
    for e in range(events.shape[0]):
        event = events[e]
        admittance = complex(event.active, event.reactive)
        if event.bus >= 0 and step >= event.start:
            served = rows.buses[event.bus, _OF_BUS.served]
            y[event.bus, event.bus] += served * _ramped(event, step, middle) * admittance
        if event.fault >= 0 and event.start <= step < event.end:
            y[event.fault, event.fault] += admittance
    for i in range(unit_y.shape[0]):
        bus = network.unit_bus[i]
        unit_y[i] = network.unit_y[i] * (rows.units[i, _OF_UNIT.committed] * rows.all[network.connected[i]])
        y[bus, bus] += unit_y[i]
    _add_branches(y, step, network, events)
    for k in range(n):
        if rows.buses[k, _OF_BUS.island] < 0.0:
            y[k, :n] = 0.0
            y[k, k] = 1.0
