"""The network as the units see it: Kron reduction per topology, and load noise on top of it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.layout import (
    EventColumn,
    Floats,
    LaneData,
    LaneRow,
    Lanes,
    Plant,
    SyncRow,
    WtgRow,
    lane_row,
    network_row,
)
from wtg_gym.physics.network import assemble_admittance, solve_in_place, transfer_impedances


@compiled
def refresh_network(block: Floats, x: int, lane: int, plant: Plant, data: LaneData, width: int) -> None:
    """Kron-reduce the network of one lane as it is from its present step on, and note when it changes next.

    Load ramps are staircases: constant over a control interval at the value of its middle.
    """
    own = lane_row(plant) * width
    step = block[own + LaneRow.STEP * width + x]
    events = data.events[lane]
    following = math.inf
    for e in range(events.shape[0]):
        start, end = events[e, EventColumn.START], events[e, EventColumn.END]
        if step < start:
            following = min(following, start)
        elif step < end:
            boundary = (math.floor(step / plant.n_substeps) + 1.0) * plant.n_substeps
            following = min(following, min(boundary, end))
    block[own + LaneRow.LAST_CHANGE * width + x] = step
    block[own + LaneRow.NEXT_CHANGE * width + x] = following
    unit_y = _connected_units(block, x, plant, width)
    y = _full_admittance(step, 0.5 * (step + following), lane, plant, data, unit_y)
    noise_bus = data.noise_bus[lane]
    z = transfer_impedances(y, plant.unit_bus, noise_bus)
    _store_reduction(block, x, plant, unit_y, z, noise_bus, width)


@compiled
def _connected_units(block: Floats, x: int, plant: Plant, width: int) -> npt.NDArray[np.complex128]:
    """Return the internal admittance of every unit, zero for a group that has tripped [p.u.]."""
    n_sync = len(plant.syncs)
    unit_y = plant.unit_y.copy()
    for j in range(len(plant.wtgs)):
        connected = block[(n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS + WtgRow.CONNECTED) * width + x]
        unit_y[n_sync + j] *= connected
    return unit_y


@compiled
def _full_admittance(
    step: float, ramp_step: float, lane: int, plant: Plant, data: LaneData, unit_y: npt.NDArray[np.complex128]
) -> npt.NDArray[np.complex128]:
    """Return the bus admittance matrix of a lane with its loads, events and units, without load noise [p.u.].

    `step` decides which events have struck, `ramp_step` how far a ramp has come.
    """
    n_bus = plant.shunt_y.shape[0]
    events = data.events[lane]
    bus_y = np.empty(n_bus, dtype=np.complex128)
    for k in range(n_bus):
        bus_y[k] = plant.shunt_y[k] + data.load_y[lane, k]
    open_branch = np.zeros(plant.branch_from.shape[0], dtype=np.bool_)
    for e in range(events.shape[0]):
        start, end = events[e, EventColumn.START], events[e, EventColumn.END]
        if step >= start:
            level = 1.0 if step >= end else (ramp_step - start) / (end - start)
            branch = int(events[e, EventColumn.BRANCH])
            if branch >= 0:
                open_branch[branch] = True
            else:
                bus_y[int(events[e, EventColumn.BUS])] += level * complex(
                    events[e, EventColumn.CONDUCTANCE], events[e, EventColumn.SUSCEPTANCE]
                )
    for i in range(unit_y.shape[0]):
        bus_y[plant.unit_bus[i]] += unit_y[i]
    return assemble_admittance(plant.branch_from, plant.branch_to, plant.branch_y, open_branch, bus_y)


@compiled
def bus_voltages(
    block: Floats, x: int, lane: int, plant: Plant, data: LaneData, noise_mw: float, width: int
) -> npt.NDArray[np.complex128]:
    """Return the bus voltages of a lane where it stands, in the frame of its first unit's rotor, (n_bus,) [p.u.].

    Args:
        block: one block's rows, flat, with the internal voltages of the latest evaluation.
        x: the lane's column in the block.
        lane: its row in `data`.
        plant, data: constants and what the lane was given.
        noise_mw: load noise that acts [MW].
        width: lanes of the block.
    """
    own = lane_row(plant) * width
    last = block[own + LaneRow.LAST_CHANGE * width + x]
    following = block[own + LaneRow.NEXT_CHANGE * width + x]
    unit_y = _connected_units(block, x, plant, width)
    # The network as it was last reduced: an event that strikes just now is seen by the next step.
    y = _full_admittance(last, 0.5 * (last + following), lane, plant, data, unit_y)
    noise_bus = data.noise_bus[lane]
    y[noise_bus, noise_bus] += noise_mw * block[own + LaneRow.NOISE_PER_MW * width + x]
    n = unit_y.shape[0]
    e_re = network_row(plant) * width + x
    injected = np.zeros((y.shape[0], 1), dtype=np.complex128)
    for i in range(n):
        emf = complex(block[e_re + i * width], block[e_re + (n + i) * width])
        injected[plant.unit_bus[i], 0] += unit_y[i] * emf
    solve_in_place(y, injected)
    return injected[:, 0]


@compiled
def _store_reduction(
    block: Floats,
    x: int,
    plant: Plant,
    unit_y: npt.NDArray[np.complex128],
    z: npt.NDArray[np.complex128],
    noise_bus: int,
    width: int,
) -> None:
    """Write Y_red = diag(y) - diag(y) Z diag(y), the noise bus's transfer u = diag(y) Z e and its impedance."""
    n = len(plant.syncs) + len(plant.wtgs)
    u_re = (network_row(plant) + 4 * n) * width
    u_im = u_re + n * width
    g0 = u_im + n * width + 2 * n * n * width
    b0 = g0 + n * n * width
    for i in range(n):
        for j in range(n):
            value = -unit_y[i] * z[plant.unit_bus[i], j] * unit_y[j]
            if i == j:
                value += unit_y[i]
            block[g0 + (i * n + j) * width + x] = value.real
            block[b0 + (i * n + j) * width + x] = value.imag
        transfer = unit_y[i] * z[plant.unit_bus[i], n]
        block[u_re + i * width + x] = transfer.real
        block[u_im + i * width + x] = transfer.imag
    own = lane_row(plant) * width
    block[own + LaneRow.NOISE_Z_RE * width + x] = z[noise_bus, n].real
    block[own + LaneRow.NOISE_Z_IM * width + x] = z[noise_bus, n].imag


@inlined
def combine_load_noise(block: Floats, plant: Plant, noise_y: Floats, lanes: Lanes) -> None:
    """Put the load noise into the reduced admittance of every lane of a block by a rank-one update.

    Y = Y0 + Δy/(1 + Δy z) u uᵀ (Sherman-Morrison); exact for one bus, and cheap enough for every control interval.
    `noise_y` (width) is Δy, a conductance [p.u.].
    """
    width = len(lanes)
    n = len(plant.syncs) + len(plant.wtgs)
    own = lane_row(plant) * width
    u_re = (network_row(plant) + 4 * n) * width
    u_im = u_re + n * width
    g = u_im + n * width
    b = g + n * n * width
    g0 = b + n * n * width
    b0 = g0 + n * n * width
    f_re, f_im = np.empty(width), np.empty(width)
    for x in range(width):
        dy = noise_y[x]
        d_re = 1.0 + dy * block[own + LaneRow.NOISE_Z_RE * width + x]
        d_im = dy * block[own + LaneRow.NOISE_Z_IM * width + x]
        size = dy / (d_re * d_re + d_im * d_im)
        f_re[x], f_im[x] = size * d_re, -size * d_im
    for i in range(n):
        for j in range(n):
            at = (i * n + j) * width
            for x in range(width):
                u_i_re, u_i_im = block[u_re + i * width + x], block[u_im + i * width + x]
                u_j_re, u_j_im = block[u_re + j * width + x], block[u_im + j * width + x]
                v_re = u_i_re * u_j_re - u_i_im * u_j_im
                v_im = u_i_re * u_j_im + u_i_im * u_j_re
                block[g + at + x] = block[g0 + at + x] + f_re[x] * v_re - f_im[x] * v_im
                block[b + at + x] = block[b0 + at + x] + f_re[x] * v_im + f_im[x] * v_re
