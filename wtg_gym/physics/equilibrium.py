"""The exact equilibrium a lane starts from: turbines, power flow, then every state backwards."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.extension_unit import EXTENSIONS
from wtg_gym.physics.hydro_unit import HYDRO
from wtg_gym.physics.integration import combine_load_noise, evaluate, start, start_machines
from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import (
    EXTENSION,
    N_EXTENSION_ROWS,
    N_HYDRO_ROWS,
    N_MACHINE_ROWS,
    N_WTG_ROWS,
    OF_LANE,
    WTG,
    Floats,
    n_rows_of,
    place_of,
)
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.network import assemble_admittance, solve_power_flow
from wtg_gym.physics.reduction import refresh_network
from wtg_gym.physics.units import UNITS
from wtg_gym.physics.wind_turbine import Turbine, turbine_equilibrium
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.compiled import compiled, inlined, internal
from wtg_gym.systems.programs import NONE
from wtg_gym.systems.records import reader

_read_turbine = reader(Turbine)
_MACHINE_CONNECTED, _GATE, _FIELD_VOLTAGE = (
    place_of(MACHINES, name) for name in ("connected", "gate", "field_voltage")
)
_WTG_SPEED, _ROTOR_SPEED, _PITCH_INTEGRAL, _PITCH = (
    place_of(GROUPS, name) for name in ("speed", "rotor_speed", "pitch_integral", "pitch")
)
_WTG_EMF, _WTG_CONNECTED, _K_NOMINAL, _WIND_START, _WIND_END = (
    place_of(GROUPS, name) for name in ("emf", "connected", "k_nominal", "wind_start", "wind_end")
)
_POWER, _PEAK_POWER, _LEAST_TSR, _LARGEST_TSR, _OVERLOAD_TIME = (
    place_of(GROUPS, name) for name in ("power", "peak_power", "least_tsr", "largest_tsr", "overload_time")
)
_HYDRO_GATE = place_of(HYDRO, "hydro_gate")
_INTERNAL_VOLTAGE, _REACTANCE = (place_of(EXTENSIONS, name) for name in ("internal_voltage", "limiting_reactance"))
#: Rows of a group's states, and of a unit in scratch.
_N_WTG_STATES, _UNIT_STRIDE = WTG.given, n_rows_of(UNITS.scratch)


@inlined
def _machine_at(plant: Plant, i: int) -> int:
    """Return the first row of machine i."""
    row: int = plant.facts[0]["machines"] + i * N_MACHINE_ROWS
    return row


@inlined
def _group_at(plant: Plant, j: int) -> int:
    """Return the first row of WTG group j."""
    row: int = plant.facts[0]["groups"] + j * N_WTG_ROWS
    return row


@inlined
def _hydro_at(plant: Plant, h: int) -> int:
    """Return the first row of hydro governor h."""
    row: int = plant.facts[0]["hydro"] + h * N_HYDRO_ROWS
    return row


@inlined
def _extension_at(plant: Plant, j: int) -> int:
    """Return the first row of what WTG group j has as an extended one."""
    row: int = plant.facts[0]["extensions"] + j * N_EXTENSION_ROWS
    return row


class StartFailure(IntEnum):
    """Why a lane cannot start; 0 means it can."""

    NONE = 0
    NO_TURBINE_EQUILIBRIUM = 1
    POWER_FLOW_DIVERGED = 2
    GOVERNOR_LIMIT = 3
    EXCITER_LIMIT = 4
    CONVERTER_LIMIT = 5
    INTERNAL_VOLTAGE_LIMIT = 6


@compiled
def prepare_lanes(
    rows: Floats,
    scratch: Floats,
    plant: Plant,
    data: LaneData,
    load_levels: Floats,
    failures: npt.NDArray[np.int64],
) -> None:
    """Put lanes of rows (n, n_rows, 1) into equilibrium.

    Args:
        rows, plant, data: as for :func:`_prepare_lane`.
        scratch: (n_scratch, 1).
        load_levels: shares of the nominal load (n,).
        failures: takes why a lane cannot start, and the index of the unit that cannot, machines first (n, 2).
    """
    for lane in range(rows.shape[0]):
        failure, unit = _prepare_lane(rows[lane], scratch, lane, plant, data, load_levels[lane])
        if failure == 0:
            arrays = rows[lane], scratch
            combine_load_noise(arrays, plant.tables, NONE)
            evaluate(arrays, plant.tables, NONE)
            start(arrays, plant.tables, NONE)
            for j in range(plant.share.shape[0]):
                # Overload counts from the first step on.
                rows[lane, _group_at(plant, j) + _OVERLOAD_TIME, 0] = 0.0
            failure, unit = _limit_failure(rows[lane], plant)
        failures[lane, 0], failures[lane, 1] = failure, unit


@internal
def _prepare_lane(
    block: Floats, scratch: Floats, lane: int, plant: Plant, data: LaneData, load_level: float
) -> tuple[int, int]:
    """Put a one-lane block into the equilibrium of its wind, law and load, at nominal frequency.

    The laws and the machines' inv_two_h and inv_droop must be set; `data.events` holds load events as P + jQ [p.u.],
    which are turned into admittances here; `data.load_y` is filled.

    Returns:
        why it cannot start, and the index of the unit that cannot, machines first.
    """
    buses = plant.buses
    n_sync = plant.machines.shape[0]
    n_bus = buses.shape[0]
    power = np.empty(n_bus, dtype=np.complex128)
    shunt = np.empty(n_bus, dtype=np.complex128)
    for k in range(n_bus):
        power[k], shunt[k] = -load_level * buses[k]["load"], buses[k]["shunt"]
    for i in range(n_sync):
        power[plant.unit_bus[i]] += plant.dispatch[i]
    for j in range(plant.share.shape[0]):
        if not _start_turbine(block, j, plant, data.wind[lane, j, 0]):
            return StartFailure.NO_TURBINE_EQUILIBRIUM.value, n_sync + j
        power[plant.unit_bus[n_sync + j]] += _start_power(block, plant, j)
    open_branch = np.zeros(plant.branches.shape[0], dtype=np.bool_)
    y = assemble_admittance(plant.branches, open_branch, shunt)
    magnitude, angle = np.empty(n_bus), np.zeros(n_bus)
    holds_voltage = np.empty(n_bus, dtype=np.bool_)
    for k in range(n_bus):
        magnitude[k], holds_voltage[k] = buses[k]["voltage"], buses[k]["holds_voltage"]
    if solve_power_flow(y, plant.facts[0]["slack"], holds_voltage, power, magnitude, angle) < 0:
        return StartFailure.POWER_FLOW_DIVERGED.value, 0
    if plant.extension.shape[0] > 0:
        # At most every bus lets go of its voltage.
        for _ in range(n_bus):
            if not _release_voltages(plant, y, load_level, holds_voltage, power, magnitude, angle):
                break
            if solve_power_flow(y, plant.facts[0]["slack"], holds_voltage, power, magnitude, angle) < 0:
                return StartFailure.POWER_FLOW_DIVERGED.value, 0
    voltage = np.empty(n_bus, dtype=np.complex128)
    for k in range(n_bus):
        voltage[k] = magnitude[k] * complex(math.cos(angle[k]), math.sin(angle[k]))
    _start_loads(lane, plant, data, load_level, magnitude)
    _start_units(block, scratch, plant, load_level, y, voltage, power)
    _start_clock(block, lane, plant, data, magnitude)
    return StartFailure.NONE.value, 0


@internal
def _release_voltages(
    plant: Plant,
    y: npt.NDArray[np.complex128],
    load_level: float,
    holds_voltage: npt.NDArray[np.bool_],
    power: npt.NDArray[np.complex128],
    magnitude: Floats,
    angle: Floats,
) -> bool:
    """Turn buses whose WTG groups lack the reactive power to hold the voltage into PQ buses; return whether any is.

    A bus with a machine too keeps its voltage: the machine gives what is missing.
    """
    n_bus = magnitude.shape[0]
    limit, gain = plant.extension[0]["voltage.reactive_max"], plant.extension[0]["voltage.gain"]
    found = False
    for k in range(n_bus):
        machines, _, share = _sizes_at(plant, k)
        if holds_voltage[k] and machines == 0.0 and share > 0.0 and gain > 0.0 and k != plant.facts[0]["slack"]:
            injected = 0j
            for m in range(n_bus):
                injected += y[k, m] * magnitude[m] * complex(math.cos(angle[m]), math.sin(angle[m]))
            flow = magnitude[k] * complex(math.cos(angle[k]), math.sin(angle[k])) * injected.conjugate()
            asked = flow.imag + load_level * plant.buses[k]["load"].imag
            if abs(asked) > limit * share * (1.0 + 1e-9):
                given = math.copysign(limit * share, asked)
                holds_voltage[k] = False
                power[k] = complex(power[k].real, given - load_level * plant.buses[k]["load"].imag)
                found = True
    return found


@internal
def _sizes_at(plant: Plant, bus: int) -> tuple[float, float, float]:
    """Return the sums over a bus's units: the machines' ratings, their reactive weights, the groups' shares."""
    n_sync = plant.machines.shape[0]
    ratings, weights, shares = 0.0, 0.0, 0.0
    for i in range(n_sync):
        if plant.unit_bus[i] == bus:
            ratings += plant.machines[i]["rating"]
            weights += plant.machines[i]["reactive_weight"]
    for j in range(plant.share.shape[0]):
        if plant.unit_bus[n_sync + j] == bus:
            shares += plant.share[j]
    return ratings, weights, shares


@internal
def _start_turbine(block: Floats, j: int, plant: Plant, wind: float) -> bool:
    """Set the states of WTG group j, all but its angle and voltage; return whether it has an equilibrium."""
    o = _group_at(plant, j)
    rotor_speed, pitch, found = turbine_equilibrium(
        wind, block[o + _K_NOMINAL, 0], _read_turbine(plant.turbine[0]), plant.cells
    )
    for row in range(o, o + _N_WTG_STATES):
        block[row, 0] = 0.0
    block[o + _WTG_SPEED, 0], block[o + _ROTOR_SPEED, 0] = 1.0, rotor_speed
    block[o + _PITCH_INTEGRAL, 0], block[o + _PITCH, 0] = pitch, pitch
    block[o + _WTG_CONNECTED, 0], block[o + _WIND_START, 0], block[o + _WIND_END, 0] = 1.0, wind, wind
    block[o + _PEAK_POWER, 0], block[o + _LEAST_TSR, 0], block[o + _LARGEST_TSR, 0] = -math.inf, math.inf, -math.inf
    return found


@internal
def _start_power(block: Floats, plant: Plant, j: int) -> float:
    """Return what WTG group j feeds in before any policy has acted [p.u. of the system base]."""
    o = _group_at(plant, j)
    power: float = plant.share[j] * block[o + _K_NOMINAL, 0] * block[o + _ROTOR_SPEED, 0] ** 3
    return power


@internal
def _start_loads(lane: int, plant: Plant, data: LaneData, load_level: float, magnitude: Floats) -> None:
    """Turn loads and load events from power at the initial voltage into admittances."""
    for k in range(magnitude.shape[0]):
        data.load_y[lane, k] = load_level * plant.buses[k]["load"].conjugate() / magnitude[k] ** 2
    events = data.events[lane]
    for e in range(events.shape[0]):
        if events[e]["bus"] >= 0:
            square = magnitude[events[e]["bus"]] ** 2
            power = events[e]["admittance"]
            events[e]["admittance"] = complex(power.real / square, power.imag / -square)


@internal
def _start_units(
    block: Floats,
    scratch: Floats,
    plant: Plant,
    load_level: float,
    y: npt.NDArray[np.complex128],
    voltage: npt.NDArray[np.complex128],
    power: npt.NDArray[np.complex128],
) -> None:
    """Share each bus's power among its units and set their internal states; angles count from the first unit."""
    n_sync, n_wtg = plant.machines.shape[0], plant.share.shape[0]
    for i in range(n_sync + n_wtg):
        bus = plant.unit_bus[i]
        injected = 0j
        for k in range(voltage.shape[0]):
            injected += y[bus, k] * voltage[k]
        flow = voltage[bus] * injected.conjugate()
        reactive = _reactive_share(plant, i, (flow + load_level * plant.buses[bus]["load"]).imag)
        if i < n_sync:
            active = plant.dispatch[i]
            if bus == plant.facts[0]["slack"]:
                # The machines there share the active power that is missing, by rating.
                active += (flow.real - power[bus].real) * plant.machines[i]["rating"] / _sizes_at(plant, bus)[0]
        else:
            active = _start_power(block, plant, i - n_sync)
        current = (complex(active, reactive) / voltage[bus]).conjugate()
        if i < n_sync:
            at = plant.facts[0]["starts"] + i * _UNIT_STRIDE
            scratch[at, 0] = active
            scratch[at + 1, 0], scratch[at + 2, 0], scratch[at + 3, 0] = (
                voltage[bus].real,
                voltage[bus].imag,
                abs(voltage[bus]),
            )
            scratch[at + 4, 0], scratch[at + 5, 0] = current.real, current.imag
            block[_machine_at(plant, i) + _MACHINE_CONNECTED, 0] = 1.0
        else:
            emf = voltage[bus] + current / plant.unit_y[i]
            _start_voltage(block, i - n_sync, plant, emf, reactive, voltage[bus])
    start_machines((block, scratch), plant.tables, NONE)
    reference = block[_machine_at(plant, 0), 0] if n_sync > 0 else block[_group_at(plant, 0), 0]
    for i in range(n_sync):
        block[_machine_at(plant, i), 0] -= reference
    for j in range(n_wtg):
        block[_group_at(plant, j), 0] -= reference
    block[plant.facts[0]["lane"] + OF_LANE.angle, 0] = reference


@internal
def _reactive_share(plant: Plant, unit: int, total: float) -> float:
    """Return the reactive power of a unit, of the total at its bus, in proportion to the units' weights.

    Beside machines, WTG groups with voltage control give no more than their limit.
    """
    bus, n_sync = plant.unit_bus[unit], plant.machines.shape[0]
    _, machines, groups = _sizes_at(plant, bus)
    weight = plant.machines[unit]["reactive_weight"] if unit < n_sync else plant.share[unit - n_sync]
    reactive = total * weight / (machines + groups) if plant.buses[bus]["holds_voltage"] else 0.0
    if plant.extension.shape[0] > 0:
        limit = plant.extension[0]["voltage.reactive_max"] * groups
        controls = plant.extension[0]["voltage.gain"] > 0.0
        if controls and groups > 0.0 and machines > 0.0 and reactive != 0.0:
            given = min(max(total * groups / (machines + groups), -limit), limit)
            reactive = (total - given) * weight / machines if unit < n_sync else given * weight / groups
    return reactive


@internal
def _start_voltage(block: Floats, j: int, plant: Plant, emf: complex, reactive: float, voltage: complex) -> None:
    """Set the internal voltage of WTG group j, and what holds it."""
    o = _group_at(plant, j)
    block[o, 0], block[o + _WTG_EMF, 0] = math.atan2(emf.imag, emf.real), abs(emf)
    if plant.extension.shape[0] > 0:
        at = _extension_at(plant, j)
        for row in range(at, at + EXTENSION.references):
            block[row, 0] = 0.0
        block[at + _INTERNAL_VOLTAGE, 0] = abs(emf)
        block[at + EXTENSION.references, 0] = abs(voltage)
        block[at + EXTENSION.references + 1, 0] = reactive / plant.share[j]


@internal
def _limit_failure(block: Floats, plant: Plant) -> tuple[int, int]:
    """Return why a machine or converter would start beyond its limits, and the index of that unit."""
    machines = plant.machines
    for i in range(machines.shape[0]):
        o, machine = _machine_at(plant, i), machines[i]
        if not machine["governor.gate_min"] <= block[o + _GATE, 0] <= machine["governor.gate_max"]:
            return StartFailure.GOVERNOR_LIMIT.value, i
        if not machine["exciter.field_min"] <= block[o + _FIELD_VOLTAGE, 0] <= machine["exciter.field_max"]:
            return StartFailure.EXCITER_LIMIT.value, i
    for h in range(plant.hydro.shape[0]):
        governor, gate = plant.hydro[h], block[_hydro_at(plant, h) + _HYDRO_GATE, 0]
        if not governor["gate_min"] <= gate <= governor["gate_max"]:
            return StartFailure.GOVERNOR_LIMIT.value, governor["machine"]
    if plant.extension.shape[0] > 0:
        limits = plant.extension[0]
        for j in range(plant.share.shape[0]):
            at, power = _extension_at(plant, j), block[_group_at(plant, j) + _POWER, 0]
            if block[at + _REACTANCE, 0] > 0.0 or not limits["limits.power_min"] <= power <= limits["limits.power_max"]:
                return StartFailure.CONVERTER_LIMIT.value, machines.shape[0] + j
            if not limits["voltage.emf_min"] <= block[at + _INTERNAL_VOLTAGE, 0] <= limits["voltage.emf_max"]:
                return StartFailure.INTERNAL_VOLTAGE_LIMIT.value, machines.shape[0] + j
    return StartFailure.NONE.value, 0


@internal
def _start_clock(block: Floats, lane: int, plant: Plant, data: LaneData, magnitude: Floats) -> None:
    """Set clock, network and statistics of a lane."""
    own = plant.facts[0]["lane"]
    block[own + OF_LANE.active, 0] = 1.0
    block[own + OF_LANE.status, 0] = 0.0
    noise_voltage = magnitude[data.noise_bus[lane]]
    block[own + OF_LANE.noise_per_mw, 0] = 1.0 / (plant.facts[0]["base_mva"] * noise_voltage * noise_voltage)
    block[own + OF_LANE.noise_y, 0] = 0.0
    # An event at t = 0 strikes in the first step, not before the equilibrium.
    block[own + OF_LANE.step, 0] = -1.0
    refresh_network(block, 0, lane, plant, data)
    block[own + OF_LANE.step, 0] = 0.0
    block[own + OF_LANE.healthy_step, 0] = 0.0
    block[own + OF_LANE.coi_min, 0] = math.inf
    block[own + OF_LANE.coi_max, 0] = -math.inf
