"""The network as the units see it: Kron reduction per topology."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import N_MACHINE_ROWS, N_WTG_ROWS, OF_LANE, Floats, place_of
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.network import assemble_admittance, solve_in_place, transfer_impedances
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.compiled import compiled, inlined, internal

_OF_MACHINE, _OF_GROUP = place_of(MACHINES, "connected"), place_of(GROUPS, "connected")
_GATE, _REFERENCE, _DROOP = (place_of(MACHINES, name) for name in ("gate", "gate_reference", "inv_droop"))


@compiled
def refresh_network(block: Floats, x: int, lane: int, plant: Plant, data: LaneData) -> None:
    """Kron-reduce the network of one lane as it is from its present step on, and note when it changes next.

    Units and governors that events take away are switched off. Load ramps are staircases: constant over a control
    interval at the value of its middle.
    """
    facts = plant.facts[0]
    own = facts["lane"]
    step = block[own + OF_LANE.step, x]
    following = math.inf
    for event in data.events[lane]:
        if step < event["start"]:
            following = min(following, event["start"])
        elif step < event["end"]:
            passed = math.floor(step / facts["n_substeps"])
            boundary = (passed + 1.0) * facts["n_substeps"] if event["bus"] >= 0 else math.inf
            following = min(following, min(boundary, event["end"]))
        # A second time it changes nothing.
        if step >= event["start"] and event["unit"] >= 0:
            block[_connected(plant, event["unit"]), x] = 0.0
        if step >= event["start"] and event["governor"] >= 0:
            lose_governor(block, facts["machines"] + event["governor"] * N_MACHINE_ROWS, x)
    block[own + OF_LANE.last_change, x] = step
    block[own + OF_LANE.next_change, x] = following
    unit_y = _connected_units(block, x, plant)
    served = _served_load(block, x, plant, step)
    y = _full_admittance(step, 0.5 * (step + following), lane, plant, data, unit_y, served)
    noise_bus = data.noise_bus[lane]
    z = transfer_impedances(y, plant.unit_bus, noise_bus)
    _store_reduction(block, x, plant, unit_y, z, noise_bus)


@inlined
def _connected(plant: Plant, unit: int) -> int:
    """Return the row that says whether a unit is connected."""
    facts, n_sync = plant.facts[0], plant.machines.shape[0]
    if unit < n_sync:
        at = facts["machines"] + unit * N_MACHINE_ROWS + _OF_MACHINE
    else:
        at = facts["groups"] + (unit - n_sync) * N_WTG_ROWS + _OF_GROUP
    row: int = at
    return row


@inlined
def lose_governor(block: Floats, machine: int, x: int) -> None:
    """Let the gate of the machine whose rows begin at `machine` stay where it is, whatever its speed."""
    if block[machine + _DROOP, x] > 0.0:
        block[machine + _REFERENCE, x] = block[machine + _GATE, x]
        block[machine + _DROOP, x] = 0.0


@internal
def _connected_units(block: Floats, x: int, plant: Plant) -> npt.NDArray[np.complex128]:
    """Return the internal admittance of every unit, zero for one that is disconnected [p.u.]."""
    unit_y: npt.NDArray[np.complex128] = plant.unit_y.copy()
    for unit in range(unit_y.shape[0]):
        unit_y[unit] *= block[_connected(plant, unit), x]
    return unit_y


@internal
def _served_load(block: Floats, x: int, plant: Plant, step: float) -> float:
    """Return the share of every load that shedding has left in a network that was reduced at a step."""
    served = 1.0
    for k in range(plant.shedding.shape[0]):
        acted = -1.0 - block[plant.facts[0]["stages"] + k, x]
        if 0.0 <= acted <= step:
            served -= plant.shedding[k]["share"]
    return served


@internal
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
        bus_y[plant.unit_bus[i]] += unit_y[i]
    return assemble_admittance(plant.branches, open_branch, bus_y)


@compiled
def bus_voltages(
    block: Floats,
    x: int,
    lane: int,
    plant: Plant,
    data: LaneData,
    internal: npt.NDArray[np.complex128],
) -> npt.NDArray[np.complex128]:
    """Return the bus voltages of a lane, in the frame of its first unit's rotor, (n_bus,) [p.u.].

    Args:
        block: one block's rows (n_rows, width).
        x: the lane's column in the block.
        lane: its row in `data`.
        plant, data: constants and what the lane was given.
        internal: voltages behind the units' internal impedances (n_unit,) [p.u.].
    """
    own = plant.facts[0]["lane"]
    last, following = block[own + OF_LANE.last_change, x], block[own + OF_LANE.next_change, x]
    unit_y = _connected_units(block, x, plant)
    # The network as it was last reduced: an event that strikes just now is seen by the next step.
    served = _served_load(block, x, plant, last)
    y = _full_admittance(last, 0.5 * (last + following), lane, plant, data, unit_y, served)
    noise_bus = data.noise_bus[lane]
    y[noise_bus, noise_bus] += block[own + OF_LANE.noise_y, x]
    injected = np.zeros((y.shape[0], 1), dtype=np.complex128)
    for i in range(unit_y.shape[0]):
        injected[plant.unit_bus[i], 0] += unit_y[i] * internal[i]
    solve_in_place(y, injected)
    return injected[:, 0]


@inlined
def _store(value: complex, block: Floats, row: int, x: int) -> None:
    block[row, x], block[row + 1, x] = value.real, value.imag


@internal
def _store_reduction(
    block: Floats,
    x: int,
    plant: Plant,
    unit_y: npt.NDArray[np.complex128],
    z: npt.NDArray[np.complex128],
    noise_bus: int,
) -> None:
    """Write Y_red = diag(y) - diag(y) Z diag(y), the noise bus's transfer u = diag(y) Z e and its impedance."""
    facts, n = plant.facts[0], unit_y.shape[0]
    for i in range(n):
        bus = plant.unit_bus[i]
        for j in range(n):
            value = -unit_y[i] * z[bus, j] * unit_y[j]
            if i == j:
                value += unit_y[i]
            _store(value, block, facts["pairs"] + 2 * (i * n + j), x)
        _store(unit_y[i] * z[bus, n], block, facts["units"] + 2 * i, x)
    _store(z[noise_bus, n], block, facts["lane"] + OF_LANE.noise_z, x)
