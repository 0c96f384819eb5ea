"""The network as the units see it: Kron reduction per topology, and what events and islands change in it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.kernel_data import EVENT, LaneData, Network
from wtg_gym.physics.layout import N_MACHINE_ROWS, OF_LANE, Floats, n_rows_of, offsets_of, place_of
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.network import eliminate
from wtg_gym.physics.source_unit import SOURCES
from wtg_gym.physics.units import BUSES, ISLANDS, UNITS
from wtg_gym.systems.compiled import compiled, internal

_GATE, _REFERENCE, _DROOP = (place_of(MACHINES, name) for name in ("gate", "gate_reference", "inv_droop"))
_OF_BUS, _OF_UNIT, _OF_ISLAND = offsets_of(BUSES), offsets_of(UNITS), offsets_of(ISLANDS)
_N_BUS, _N_UNIT, _N_ISLAND = n_rows_of(BUSES.rows), n_rows_of(UNITS.rows), n_rows_of(ISLANDS.rows)
_N_SOURCE, _SOURCE_ANGLE, _SOURCE_RAMP = n_rows_of(SOURCES.rows), place_of(SOURCES, "angle"), place_of(SOURCES, "ramp")


@compiled
def refresh_network(block: Floats, x: int, lane: int, network: Network, data: LaneData) -> None:
    """Kron-reduce the network of one lane as it is from its present step on, and note when it changes next.

    Units and governors that events take away are switched off, those that come back are marked for the systems that
    synchronise them, sources are moved. Load ramps are staircases: constant over a control interval at the value of its
    middle. So is the conductance of loads that depend on the frequency, at that of its beginning.
    """
    facts = network.facts
    step = block[facts.lane + OF_LANE.step, x]
    # A second time at the same step only the units that have come back are new.
    again = block[facts.lane + OF_LANE.last_change, x] == step
    following = _strike(block, x, lane, network, data, again)
    if facts.shares_frequency > 0.0:
        following = min(following, (math.floor(step / facts.n_substeps) + 1.0) * facts.n_substeps)
    own = facts.lane
    block[own + OF_LANE.last_change, x], block[own + OF_LANE.next_change, x] = step, following
    _find_islands(block, x, lane, network, data)
    if not again:
        _shed(block, x, network, data.events[lane])
    noise_bus, n, n_bus = int(block[own + OF_LANE.noise_bus, x]), network.unit_y.shape[0], network.shunts.shape[0]
    # Columns of the bus impedance matrix: of the units' buses, then of the load noise's.
    z, unit_y = np.empty((n_bus, n_bus + n + 1), dtype=np.complex128), np.empty(n, dtype=np.complex128)
    assemble(z, unit_y, block, x, lane, network, data)
    for k in range(n_bus):
        for i in range(n):
            z[k, n_bus + i] = 1.0 if network.unit_bus[i] == k else 0.0
        z[k, n_bus + n] = 1.0 if k == noise_bus else 0.0
    eliminate(z)
    # Y_red = diag(y) - diag(y) Z diag(y), the noise bus's transfer u = diag(y) Z e and its impedance.
    row = facts.pairs
    for i in range(n):
        bus, at = network.unit_bus[i], facts.units + _N_UNIT * i + _OF_UNIT.transfer
        for j in range(n):
            value = -unit_y[i] * z[bus, n_bus + j] * unit_y[j]
            if i == j:
                value += unit_y[i]
            block[row, x], block[row + 1, x] = value.real, value.imag
            row += 2
        value = unit_y[i] * z[bus, n_bus + n]
        block[at, x], block[at + 1, x] = value.real, value.imag
    at = own + OF_LANE.noise_z
    block[at, x], block[at + 1, x] = z[noise_bus, n_bus + n].real, z[noise_bus, n_bus + n].imag
    # What every unit's voltage brings to every bus, and what the load noise takes there.
    row = facts.transfers
    for k in range(n_bus):
        at = facts.buses + _N_BUS * k + _OF_BUS.noise_transfer
        block[at, x], block[at + 1, x] = z[k, n_bus + n].real, z[k, n_bus + n].imag
        for i in range(n if row > 0 else 0):
            value = z[k, n_bus + i] * unit_y[i]
            block[row, x], block[row + 1, x] = value.real, value.imag
            row += 2


@internal
def _strike(block: Floats, x: int, lane: int, network: Network, data: LaneData, again: bool) -> float:
    """Let events act on units, governors and sources; return the step at which any event changes something next."""
    facts, events, following = network.facts, data.events[lane], math.inf
    step = block[facts.lane + OF_LANE.step, x]
    for e in range(events.shape[0]):
        start, end = events[e, EVENT.start], events[e, EVENT.end]
        unit, governor, source = (
            int(events[e, EVENT.unit]),
            int(events[e, EVENT.governor]),
            int(events[e, EVENT.source]),
        )
        if step < start:
            following = min(following, start)
        elif step < end:
            boundary = (math.floor(step / facts.n_substeps) + 1.0) * facts.n_substeps
            following = min(following, min(boundary, end) if events[e, EVENT.bus] >= 0.0 else end)
        if unit >= 0:
            # Once is enough: a protection may disconnect a unit that has come back.
            if step == start and not again:
                block[network.connected[unit], x] = 0.0
            # A unit that finds no voltage at its bus does not try again.
            if end > start and step == end and not again and block[network.connected[unit], x] < 0.5:
                row = facts.units + _N_UNIT * unit
                island = max(int(block[facts.buses + _N_BUS * network.unit_bus[unit] + _OF_BUS.island, x]), 0)
                block[row + _OF_UNIT.returns, x] = 1.0
                block[row + _OF_UNIT.turned, x] = block[facts.islands + _N_ISLAND * island + _OF_ISLAND.turned, x]
                block[facts.lane + OF_LANE.returning, x] = 1.0
        machine = facts.machines + governor * N_MACHINE_ROWS
        if step >= start and governor >= 0 and block[machine + _DROOP, x] > 0.0:
            # The gate stays where it is, whatever the speed.
            block[machine + _REFERENCE, x], block[machine + _DROOP, x] = block[machine + _GATE, x], 0.0
        if source >= 0 and not again:
            row = facts.sources + source * _N_SOURCE
            if step == start:
                block[row + _SOURCE_ANGLE, x] += events[e, EVENT.jump]
                block[row + _SOURCE_RAMP, x] += events[e, EVENT.ramp]
            if end > start and step == end:
                block[row + _SOURCE_RAMP, x] -= events[e, EVENT.ramp]
    return following


@internal
def _find_islands(block: Floats, x: int, lane: int, network: Network, data: LaneData) -> None:
    """Number the parts of the network that hang together and have a unit: by the load of the start, the most first.

    What protections remember of an island goes with most of its load, when it falls apart and when parts join. Units of
    a part that joins another are counted from the same turn.
    """
    facts, n_bus, n = network.facts, network.shunts.shape[0], network.unit_y.shape[0]
    n_islands, n_stages = facts.n_islands, network.shed_shares.shape[0]
    if n_islands == 1 or not _may_split(data.events[lane]):
        return
    part = np.arange(n_bus)
    moved = True
    while moved:
        moved = False
        for b in range(network.branch_ends.shape[0]):
            if not _is_open(b, block[facts.lane + OF_LANE.step, x], data.events[lane]):
                first, second = network.branch_ends[b]
                lower = min(part[first], part[second])
                moved |= part[first] != lower or part[second] != lower
                part[first], part[second] = lower, lower
    # Load of each part, and of what was each island in it; one without load counts a little.
    loads, of_old, lives = np.zeros(n_bus), np.zeros((n_bus, n_islands)), np.zeros(n_bus)
    for k in range(n_bus):
        row = facts.buses + _N_BUS * k
        old, load = int(block[row + _OF_BUS.island, x]), block[row + _OF_BUS.load, x]
        loads[part[k]] += load
        if old >= 0:
            of_old[part[k], old] += load + 1e-9
    for i in range(n):
        if block[network.connected[i], x] > 0.5:
            lives[part[network.unit_bus[i]]] = 1.0
    number, remembered = np.full(n_bus, -1.0), np.zeros((n_islands, _N_ISLAND + n_stages))
    for k in range(n_islands):
        for r in range(_N_ISLAND):
            remembered[k, r] = block[facts.islands + _N_ISLAND * k + r, x]
        for r in range(n_stages):
            remembered[k, _N_ISLAND + r] = block[facts.stages + n_stages * k + r, x]
    for k in range(n_islands):
        best = -1
        for p in range(n_bus):
            # The grid is that with the most load, dead or alive.
            if (lives[p] > 0.5 or k == 0) and number[p] < 0.0 and (best < 0 or loads[p] > loads[best]):
                best = p
        if best < 0:
            break
        number[best] = k
        block[facts.lane + OF_LANE.split, x] = 1.0 if k > 0 else 0.0
        old = 0
        for o in range(n_islands):
            if of_old[best, o] > of_old[best, old]:
                old = o
        for r in range(_N_ISLAND):
            block[facts.islands + _N_ISLAND * k + r, x] = remembered[old, r]
        for r in range(n_stages):
            block[facts.stages + n_stages * k + r, x] = remembered[old, _N_ISLAND + r]
        for i in range(n):
            own = int(block[facts.units + _N_UNIT * i + _OF_UNIT.island, x])
            if part[network.unit_bus[i]] == best and own >= 0 and network.angles[i] >= 0:
                behind = remembered[old, _OF_ISLAND.turned] - remembered[own, _OF_ISLAND.turned]
                block[network.angles[i], x] += 2.0 * math.pi * math.floor(behind / (2.0 * math.pi) + 0.5)
    for k in range(n_bus):
        block[facts.buses + _N_BUS * k + _OF_BUS.island, x] = number[part[k]]
    for i in range(n):
        block[facts.units + _N_UNIT * i + _OF_UNIT.island, x] = number[part[network.unit_bus[i]]]


@internal
def _may_split(events: Any) -> bool:
    """Return whether events open a line: else all is one island."""
    found = False
    for e in range(events.shape[0]):
        found |= bool(events[e, EVENT.branch] >= 0.0)
    return found


@internal
def _is_open(branch: int, step: float, events: Any) -> bool:
    """Return whether an event holds a branch open at a step."""
    found = False
    for e in range(events.shape[0]):
        start, end = events[e, EVENT.start], events[e, EVENT.end]
        opens = events[e, EVENT.branch] == branch and events[e, EVENT.factor] == 0.0
        found |= opens and step >= start and not (end > start and step >= end)
    return found


@internal
def _shed(block: Floats, x: int, network: Network, events: Any) -> None:
    """Take from every bus what the stages of its island shed at this step, and sum what is not served."""
    facts, n_stages, unserved = network.facts, network.shed_shares.shape[0], 0.0
    step = block[facts.lane + OF_LANE.step, x]
    for k in range(network.shunts.shape[0]):
        row = facts.buses + _N_BUS * k
        island, load = int(block[row + _OF_BUS.island, x]), block[row + _OF_BUS.load, x]
        for e in range(events.shape[0]):
            start, end = events[e, EVENT.start], events[e, EVENT.end]
            if events[e, EVENT.bus] == k and step >= start:
                load += events[e, EVENT.active] * (1.0 if step >= end else (step - start) / (end - start))
        for s in range(n_stages if island >= 0 else 0):
            if step >= 0.0 and -1.0 - block[facts.stages + n_stages * island + s, x] == step:
                block[row + _OF_BUS.served, x] = max(block[row + _OF_BUS.served, x] - network.shed_shares[s], 0.0)
        unserved += max(load, 0.0) * (1.0 - (block[row + _OF_BUS.served, x] if island >= 0 else 0.0))
    block[facts.lane + OF_LANE.unserved, x] = unserved


@internal
def _add_branches(y: npt.NDArray[np.complex128], step: float, network: Network, events: Any) -> None:
    """Add the branches that are closed at a step, with the impedances that they have then, to an admittance matrix."""
    for b in range(network.branch_ends.shape[0]):
        if not _is_open(b, step, events):
            # Of several changes of its impedance the last one holds.
            factor, latest = 1.0, -1.0
            for e in range(events.shape[0]):
                start = events[e, EVENT.start]
                if events[e, EVENT.branch] == b and events[e, EVENT.factor] > 0.0 and latest <= start <= step:
                    factor, latest = events[e, EVENT.factor], start
            for i in range(4):
                value = network.branch_y[b, i]
                if factor != 1.0:
                    value += (1.0 / factor - 1.0) * network.branch_series[b, i]
                y[network.branch_ends[b, i // 2], network.branch_ends[b, i % 2]] += value


@compiled
def assemble(
    y: npt.NDArray[np.complex128],
    unit_y: npt.NDArray[np.complex128],
    block: Floats,
    x: int,
    lane: int,
    network: Network,
    data: LaneData,
) -> None:
    """Write the internal admittance of every unit of a lane and its bus admittance matrix, without load noise [p.u.].

    A unit that is disconnected has none, from the instant on at which a protection trips it. Else the matrix is that of
    the network as it was last reduced, with its loads and events. The step of that decides which events have struck;
    ramps have come half the way to the next change. A bus without voltage stands alone.

    Args:
        y: its first n_bus columns are written (n_bus, n).
        unit_y: is written (n_unit,).
        block: one block's rows (n_rows, width).
        x: the lane's column in the block.
        lane: its row in `data`.
        network, data: constants and what the lane was given.
    """
    facts, events, n = network.facts, data.events[lane], network.shunts.shape[0]
    step = block[facts.lane + OF_LANE.last_change, x]
    ramp_step = 0.5 * (step + block[facts.lane + OF_LANE.next_change, x])
    for k in range(n):
        for m in range(n):
            y[k, m] = 0.0
        row = facts.buses + _N_BUS * k
        served = block[row + _OF_BUS.served, x]
        load = complex(block[row + _OF_BUS.load, x], block[row + _OF_BUS.load + 1, x])
        if facts.shares_frequency > 0.0:
            island = max(int(block[row + _OF_BUS.island, x]), 0)
            deviation = block[facts.islands + _N_ISLAND * island + _OF_ISLAND.centre, x] - 1.0
            load = complex(load.real * (1.0 + facts.shares_frequency * deviation), load.imag)
        y[k, k] = network.shunts[k] + served * load
    for e in range(events.shape[0]):
        start, end = events[e, EVENT.start], events[e, EVENT.end]
        bus, fault = int(events[e, EVENT.bus]), int(events[e, EVENT.fault])
        if step >= start and bus >= 0:
            served = block[facts.buses + _N_BUS * bus + _OF_BUS.served, x]
            level = 1.0 if step >= end else (ramp_step - start) / (end - start)
            y[bus, bus] += served * level * complex(events[e, EVENT.active], events[e, EVENT.reactive])
        if fault >= 0 and start <= step < end:
            y[fault, fault] += complex(events[e, EVENT.active], events[e, EVENT.reactive])
    for i in range(unit_y.shape[0]):
        committed = block[facts.units + _N_UNIT * i + _OF_UNIT.committed, x]
        unit_y[i] = network.unit_y[i] * (committed * block[network.connected[i], x])
        y[network.unit_bus[i], network.unit_bus[i]] += unit_y[i]
    _add_branches(y, step, network, events)
    for k in range(n):
        if block[facts.buses + _N_BUS * k + _OF_BUS.island, x] < 0.0:
            for m in range(n):
                y[k, m] = 1.0 if m == k else 0.0
