"""The network as the units see it: Kron reduction per topology, and load noise on top of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import (
    LANE,
    MACHINE,
    N_MACHINE_ROWS,
    WTG,
    Floats,
    Lanes,
    Phasor,
    load_machine_input,
    load_machine_state,
    load_phasor,
    load_wtg_input,
    rows_of,
    store_machine_input,
    store_phasor,
    store_wtg_input,
    wtg_row,
)
from wtg_gym.physics.machine import MachineInput
from wtg_gym.physics.network import assemble_admittance, solve_in_place, transfer_impedances
from wtg_gym.physics.wind_turbine import WtgInput


@compiled
def refresh_network(block: Floats, x: int, lane: int, plant: Plant, data: LaneData, width: int) -> None:
    """Kron-reduce the network of one lane as it is from its present step on, and note when it changes next.

    Units and governors that events take away are switched off. Load ramps are staircases: constant over a control
    interval at the value of its middle.
    """
    c = plant.constants[0]
    own = rows_of(c).lane * width + x
    step = block[own + LANE.step * width]
    following = math.inf
    for event in data.events[lane]:
        if step < event["start"]:
            following = min(following, event["start"])
        elif step < event["end"]:
            boundary = (math.floor(step / c["n_substeps"]) + 1.0) * c["n_substeps"] if event["bus"] >= 0 else math.inf
            following = min(following, min(boundary, event["end"]))
        # A second time it changes nothing.
        if step >= event["start"] and event["unit"] >= 0:
            _disconnect(block, x, c, event["unit"], width)
        if step >= event["start"] and event["governor"] >= 0:
            lose_governor(block, x, c, event["governor"], width)
    block[own + LANE.last_change * width] = step
    block[own + LANE.next_change * width] = following
    unit_y = _connected_units(block, x, c, width)
    served = _served_load(block, x, c, step, width)
    y = _full_admittance(step, 0.5 * (step + following), lane, plant, data, unit_y, served)
    noise_bus = data.noise_bus[lane]
    z = transfer_impedances(y, c["unit_bus"], noise_bus)
    _store_reduction(block, x, c, unit_y, z, noise_bus, width)


@compiled
def _disconnect(block: Floats, x: int, c: Any, unit: int, width: int) -> None:
    """Disconnect a machine or WTG group."""
    n_sync = c["machines"].shape[0]
    if unit < n_sync:
        at = (unit * N_MACHINE_ROWS + MACHINE.input) * width + x
        m = load_machine_input(block, at, width)
        out = MachineInput(m.voltage_reference, m.gate_reference, m.inv_two_h, m.inv_droop, 0.0)
        store_machine_input(out, block, at, width)
    else:
        at = (wtg_row(c, unit - n_sync) + WTG.input) * width + x
        g = load_wtg_input(block, at, width)
        store_wtg_input(WtgInput(g.emf, g.law, 0.0, g.wind_start, g.wind_end), block, at, width)


@compiled
def lose_governor(block: Floats, x: int, c: Any, machine: int, width: int) -> None:
    """Let a machine's gate stay where it is, whatever its speed."""
    o = machine * N_MACHINE_ROWS * width + x
    m = load_machine_input(block, o + MACHINE.input * width, width)
    if m.inv_droop > 0.0:
        gate = load_machine_state(block, o, width).governor.gate
        held = MachineInput(m.voltage_reference, gate, m.inv_two_h, 0.0, m.connected)
        store_machine_input(held, block, o + MACHINE.input * width, width)


@compiled
def _connected_units(block: Floats, x: int, c: Any, width: int) -> npt.NDArray[np.complex128]:
    """Return the internal admittance of every unit, zero for one that is disconnected [p.u.]."""
    n_sync = c["machines"].shape[0]
    unit_y: npt.NDArray[np.complex128] = c["unit_y"].copy()
    for i in range(n_sync):
        at = (i * N_MACHINE_ROWS + MACHINE.input) * width + x
        unit_y[i] *= load_machine_input(block, at, width).connected
    for j in range(c["share"].shape[0]):
        at = (wtg_row(c, j) + WTG.input) * width + x
        unit_y[n_sync + j] *= load_wtg_input(block, at, width).connected
    return unit_y


@compiled
def _served_load(block: Floats, x: int, c: Any, step: float, width: int) -> float:
    """Return the share of every load that shedding has left in a network that was reduced at a step."""
    served = 1.0
    for k in range(c["shedding"].shape[0]):
        acted = -1.0 - block[(rows_of(c).shedding + k) * width + x]
        if 0.0 <= acted <= step:
            served -= c["shedding"][k]["share"]
    return served


@compiled
def _full_admittance(
    step: float,
    ramp_step: float,
    lane: int,
    plant: Plant,
    data: LaneData,
    unit_y: npt.NDArray[np.complex128],
    served: float,
) -> npt.NDArray[np.complex128]:
    """Return the bus admittance matrix of a lane with its loads, events and units, without load noise [p.u.].

    `step` decides which events have struck, `ramp_step` how far a ramp has come; `served` is the share of the loads
    that is left, of those switched on by events too.
    """
    c = plant.constants[0]
    bus_y = np.empty(plant.buses.shape[0], dtype=np.complex128)
    for k in range(bus_y.shape[0]):
        bus_y[k] = plant.buses[k]["shunt"] + served * data.load_y[lane, k]
    open_branch = np.zeros(plant.branches.shape[0], dtype=np.bool_)
    for event in data.events[lane]:
        if step >= event["start"]:
            over = step >= event["end"]
            level = 1.0 if over else (ramp_step - event["start"]) / (event["end"] - event["start"])
            if event["branch"] >= 0 and not (over and event["end"] > event["start"]):
                open_branch[event["branch"]] = True
            elif event["bus"] >= 0:
                bus_y[event["bus"]] += served * level * event["admittance"]
    for i in range(unit_y.shape[0]):
        bus_y[c["unit_bus"][i]] += unit_y[i]
    return assemble_admittance(plant.branches, open_branch, bus_y)


@compiled
def bus_voltages(
    block: Floats, x: int, lane: int, plant: Plant, data: LaneData, noise_mw: float, width: int
) -> npt.NDArray[np.complex128]:
    """Return the bus voltages of a lane at its present state, in the frame of its first unit's rotor, (n_bus,) [p.u.].

    Args:
        block: one block's rows, flat, with the internal voltages of the latest evaluation.
        x: the lane's column in the block.
        lane: its row in `data`.
        plant, data: constants and what the lane was given.
        noise_mw: load noise that acts [MW].
        width: lanes of the block.
    """
    c, rows = plant.constants[0], rows_of(plant.constants[0])
    own = rows.lane * width + x
    last, following = block[own + LANE.last_change * width], block[own + LANE.next_change * width]
    unit_y = _connected_units(block, x, c, width)
    # The network as it was last reduced: an event that strikes just now is seen by the next step.
    served = _served_load(block, x, c, last, width)
    y = _full_admittance(last, 0.5 * (last + following), lane, plant, data, unit_y, served)
    noise_bus = data.noise_bus[lane]
    y[noise_bus, noise_bus] += noise_mw * block[own + LANE.noise_per_mw * width]
    injected = np.zeros((y.shape[0], 1), dtype=np.complex128)
    for i in range(unit_y.shape[0]):
        emf = load_phasor(block, (rows.voltage + 2 * i) * width + x, width)
        injected[c["unit_bus"][i], 0] += unit_y[i] * complex(emf.re, emf.im)
    solve_in_place(y, injected)
    return injected[:, 0]


@inlined
def _phasor(value: complex) -> Phasor:
    return Phasor(value.real, value.imag)


@compiled
def _store_reduction(
    block: Floats,
    x: int,
    c: Any,
    unit_y: npt.NDArray[np.complex128],
    z: npt.NDArray[np.complex128],
    noise_bus: int,
    width: int,
) -> None:
    """Write Y_red = diag(y) - diag(y) Z diag(y), the noise bus's transfer u = diag(y) Z e and its impedance."""
    rows, n = rows_of(c), unit_y.shape[0]
    for i in range(n):
        bus = c["unit_bus"][i]
        for j in range(n):
            value = -unit_y[i] * z[bus, j] * unit_y[j]
            if i == j:
                value += unit_y[i]
            store_phasor(_phasor(value), block, (rows.fixed_admittance + 2 * (i * n + j)) * width + x, width)
        store_phasor(_phasor(unit_y[i] * z[bus, n]), block, (rows.transfer + 2 * i) * width + x, width)
    store_phasor(_phasor(z[noise_bus, n]), block, (rows.lane + LANE.noise_z) * width + x, width)


@inlined
def combine_load_noise(block: Floats, c: Any, noise_y: Floats, lanes: Lanes) -> None:
    """Put the load noise into the reduced admittance of every lane of a block by a rank-one update.

    Y = Y0 + Δy/(1 + Δy z) u uᵀ (Sherman-Morrison): exact for one bus of a network without phase shifters, whose Z is
    symmetric, and cheap enough for every control interval.
    `noise_y` (width) is Δy, a conductance [p.u.].
    """
    width, rows = len(lanes), rows_of(c)
    n = c["unit_bus"].shape[0]
    factor = (rows.lane + LANE.noise_factor) * width
    for x in range(width):
        dy = noise_y[x]
        z = load_phasor(block, (rows.lane + LANE.noise_z) * width + x, width)
        d_re, d_im = 1.0 + dy * z.re, dy * z.im
        size = dy / (d_re * d_re + d_im * d_im)
        store_phasor(Phasor(size * d_re, -size * d_im), block, factor + x, width)
    for i in range(n):
        for j in range(n):
            at = 2 * (i * n + j) * width
            for x in range(width):
                u_i = load_phasor(block, (rows.transfer + 2 * i) * width + x, width)
                u_j = load_phasor(block, (rows.transfer + 2 * j) * width + x, width)
                f = load_phasor(block, factor + x, width)
                y0 = load_phasor(block, rows.fixed_admittance * width + at + x, width)
                v_re = u_i.re * u_j.re - u_i.im * u_j.im
                v_im = u_i.re * u_j.im + u_i.im * u_j.re
                y = Phasor(y0.re + f.re * v_re - f.im * v_im, y0.im + f.re * v_im + f.im * v_re)
                store_phasor(y, block, rows.admittance * width + at + x, width)
