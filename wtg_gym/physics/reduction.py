"""The network as the units see it: Kron reduction per topology."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.kernel_data import EVENT, LaneData, Network
from wtg_gym.physics.layout import N_MACHINE_ROWS, OF_LANE, Floats, place_of
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.network import eliminate
from wtg_gym.systems.compiled import compiled

_GATE, _REFERENCE, _DROOP = (place_of(MACHINES, name) for name in ("gate", "gate_reference", "inv_droop"))


@compiled
def refresh_network(block: Floats, x: int, lane: int, network: Network, data: LaneData) -> None:
    """Kron-reduce the network of one lane as it is from its present step on, and note when it changes next.

    Units and governors that events take away are switched off. Load ramps are staircases: constant over a control
    interval at the value of its middle.
    """
    facts = network.facts
    own, step, following = facts.lane, block[facts.lane + OF_LANE.step, x], math.inf
    events = data.events[lane]
    for e in range(events.shape[0]):
        start, end = events[e, EVENT.start], events[e, EVENT.end]
        unit, governor = int(events[e, EVENT.unit]), int(events[e, EVENT.governor])
        if step < start:
            following = min(following, start)
        elif step < end:
            boundary = (math.floor(step / facts.n_substeps) + 1.0) * facts.n_substeps
            following = min(following, min(boundary, end) if events[e, EVENT.bus] >= 0.0 else end)
        # A second time it changes nothing.
        if step >= start and unit >= 0:
            block[network.connected[unit], x] = 0.0
        machine = facts.machines + governor * N_MACHINE_ROWS
        if step >= start and governor >= 0 and block[machine + _DROOP, x] > 0.0:
            # The gate stays where it is, whatever the speed.
            block[machine + _REFERENCE, x], block[machine + _DROOP, x] = block[machine + _GATE, x], 0.0
    block[own + OF_LANE.last_change, x], block[own + OF_LANE.next_change, x] = step, following
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
        bus = network.unit_bus[i]
        for j in range(n):
            value = -unit_y[i] * z[bus, n_bus + j] * unit_y[j]
            if i == j:
                value += unit_y[i]
            block[row, x], block[row + 1, x] = value.real, value.imag
            row += 2
        value = unit_y[i] * z[bus, n_bus + n]
        block[facts.units + 2 * i, x], block[facts.units + 2 * i + 1, x] = value.real, value.imag
    at = own + OF_LANE.noise_z
    block[at, x], block[at + 1, x] = z[noise_bus, n_bus + n].real, z[noise_bus, n_bus + n].imag


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

    A unit that is disconnected has none. The matrix is that of the network as it was last reduced, with its loads,
    events and units. The step of that decides which events have struck; ramps have come half the way to the next
    change.

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
    # The share of every load that shedding has left, of those switched on by events too.
    served = 1.0
    for k in range(network.shed_shares.shape[0]):
        acted = -1.0 - block[facts.stages + k, x]
        if 0.0 <= acted <= step:
            served -= network.shed_shares[k]
    for k in range(n):
        for m in range(n):
            y[k, m] = 0.0
        row = facts.buses + 2 * k
        y[k, k] = network.shunts[k] + served * complex(block[row, x], block[row + 1, x])
    for e in range(events.shape[0]):
        start, end, bus = events[e, EVENT.start], events[e, EVENT.end], int(events[e, EVENT.bus])
        if step >= start and bus >= 0:
            level = 1.0 if step >= end else (ramp_step - start) / (end - start)
            y[bus, bus] += served * level * complex(events[e, EVENT.active], events[e, EVENT.reactive])
    for i in range(unit_y.shape[0]):
        unit_y[i] = network.unit_y[i] * block[network.connected[i], x]
        y[network.unit_bus[i], network.unit_bus[i]] += unit_y[i]
    for b in range(network.branch_ends.shape[0]):
        is_open = False
        for e in range(events.shape[0]):
            start, end = events[e, EVENT.start], events[e, EVENT.end]
            is_open |= events[e, EVENT.branch] == b and step >= start and not (end > start and step >= end)
        if not is_open:
            for i in range(4):
                y[network.branch_ends[b, i // 2], network.branch_ends[b, i % 2]] += network.branch_y[b, i]
