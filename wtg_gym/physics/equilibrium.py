"""The exact equilibrium a lane starts from: turbines, power flow, then every state backwards."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.dynamics import evaluate_rates
from wtg_gym.physics.integration import track_extremes
from wtg_gym.physics.layout import (
    N_SYNC_STATES,
    EventColumn,
    Floats,
    LaneData,
    LaneRow,
    Lanes,
    Plant,
    SyncRow,
    WtgRow,
    lane_row,
)
from wtg_gym.physics.network import assemble_admittance, solve_power_flow
from wtg_gym.physics.reduction import combine_load_noise, refresh_network
from wtg_gym.physics.synchronous_machine import MachineConstant, SyncState
from wtg_gym.physics.wind_turbine import TurbineConstant, WtgState, captured_power


class StartFailure(IntEnum):
    """Why no equilibrium was found; 0 means it was."""

    NONE = 0
    NO_TURBINE_EQUILIBRIUM = 1
    POWER_FLOW_DIVERGED = 2
    GOVERNOR_LIMIT = 3
    EXCITER_LIMIT = 4


@compiled
def _captured(rotor: float, wind: float, pitch: float, t: Floats) -> float:
    return captured_power(
        rotor,
        wind,
        pitch,
        t[TurbineConstant.TIP_SPEED],
        t[TurbineConstant.WIND_POWER],
        t[TurbineConstant.C1],
        t[TurbineConstant.C2],
        t[TurbineConstant.C3],
        t[TurbineConstant.C5],
        t[TurbineConstant.C6],
        t[TurbineConstant.C7],
        t[TurbineConstant.C8],
    )


@compiled
def turbine_equilibrium(wind: float, k: float, t: Floats) -> tuple[float, float, bool]:
    """Return (rotor speed [p.u.], pitch [deg], found) at which the captured power equals k ω_m³, right of the maximum.

    The over-speed root of p_w(ω_m) = k ω_m³ at β = 0, unless captured power or rotor speed would exceed the pitch
    protection's limits: then the limit, and the smallest pitch angle that holds it on a falling branch of C_p.
    """
    scale = wind / t[TurbineConstant.TIP_SPEED]
    low, high = 3.5 * scale, 20.0 * scale
    if _captured(low, wind, 0.0, t) <= k * low**3 or _captured(high, wind, 0.0, t) >= k * high**3:
        return 0.0, 0.0, False
    rotor = _bisect_rotor(low, high, wind, k, t)
    limit = min((t[TurbineConstant.POWER_LIMIT] / k) ** (1.0 / 3.0), t[TurbineConstant.ROTOR_LIMIT])
    if rotor <= limit:
        return rotor, 0.0, True
    target = k * limit**3
    step = 0.02
    before = 0.0
    while before < t[TurbineConstant.PITCH_MAX]:
        after = before + step
        if _captured(limit, wind, before, t) > target >= _captured(limit, wind, after, t):
            return limit, _bisect_pitch(before, after, limit, wind, target, t), True
        before = after
    return 0.0, 0.0, False


@compiled
def _bisect_rotor(low: float, high: float, wind: float, k: float, t: Floats) -> float:
    for _ in range(80):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if _captured(middle, wind, 0.0, t) > k * middle**3:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@compiled
def _bisect_pitch(low: float, high: float, rotor: float, wind: float, target: float, t: Floats) -> float:
    for _ in range(80):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if _captured(rotor, wind, middle, t) > target:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@compiled
def start_lanes(
    rows: Floats, plant: Plant, data: LaneData, load_levels: Floats, failures: npt.NDArray[np.int64], lanes: Lanes
) -> None:
    """Call :func:`start_lane` for every lane of rows (n, n_rows), and write what it returns into failures (n,)."""
    for lane in range(rows.shape[0]):
        failures[lane] = start_lane(rows[lane], lane, plant, data, load_levels[lane], lanes)


@compiled
def start_lane(block: Floats, lane: int, plant: Plant, data: LaneData, load_level: float, lanes: Lanes) -> int:
    """Put a one-lane block into the equilibrium of its wind, law and load, at nominal frequency.

    The law's rows (K_MIN … DROOP_CANCELLED) and the machines' INV_TWO_H and INV_DROOP must be set; `data.events` holds
    load events as P, Q [p.u.] and is turned into admittances here; `data.load_y` is filled. `lanes` has length one.

    Returns:
        a :class:`StartFailure`.
    """
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    n_bus = plant.shunt_y.shape[0]
    power = np.zeros(n_bus, dtype=np.complex128)
    for k in range(n_bus):
        power[k] = -load_level * plant.load[k]
    for i in range(n_sync):
        power[plant.unit_bus[i]] += plant.dispatch[i]
    for j in range(n_wtg):
        o = n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS
        rotor, pitch, found = turbine_equilibrium(data.wind[lane, j, 0], block[o + WtgRow.K_NOMINAL], plant.turbine)
        if not found:
            return 1
        for s in range(WtgRow.EMF):
            block[o + s] = 0.0
        block[o + WtgState.SPEED] = 1.0
        block[o + WtgState.ROTOR_SPEED] = rotor
        block[o + WtgState.PITCH_INTEGRAL] = pitch
        block[o + WtgState.PITCH] = pitch
        block[o + WtgRow.CONNECTED] = 1.0
        block[o + WtgRow.WIND_START] = data.wind[lane, j, 0]
        block[o + WtgRow.WIND_END] = data.wind[lane, j, 0]
        power[plant.unit_bus[n_sync + j]] += _start_power(block, plant, j)
    open_branch = np.zeros(plant.branch_from.shape[0], dtype=np.bool_)
    y = assemble_admittance(plant.branch_from, plant.branch_to, plant.branch_y, open_branch, plant.shunt_y)
    magnitude, angle = plant.voltage.copy(), np.zeros(n_bus)
    if solve_power_flow(y, plant.slack, plant.holds_voltage, power, magnitude, angle) < 0:
        return 2
    voltage = np.empty(n_bus, dtype=np.complex128)
    for k in range(n_bus):
        voltage[k] = magnitude[k] * complex(math.cos(angle[k]), math.sin(angle[k]))
    _start_loads(lane, plant, data, load_level, magnitude)
    failure = _start_units(block, plant, load_level, y, voltage)
    _start_rows(block, lane, plant, data, magnitude, lanes)
    return failure


@compiled
def _start_power(block: Floats, plant: Plant, j: int) -> float:
    """Return what WTG group j feeds in before any policy has acted [p.u. of the system base]."""
    o = len(plant.syncs) * SyncRow.N_ROWS + j * WtgRow.N_ROWS
    power: float = plant.share[j] * block[o + WtgRow.K_NOMINAL] * block[o + WtgState.ROTOR_SPEED] ** 3
    return power


@compiled
def _start_loads(lane: int, plant: Plant, data: LaneData, load_level: float, magnitude: Floats) -> None:
    """Turn loads and load events from power at the initial voltage into admittances."""
    for k in range(magnitude.shape[0]):
        data.load_y[lane, k] = load_level * plant.load[k].conjugate() / magnitude[k] ** 2
    events = data.events[lane]
    for e in range(events.shape[0]):
        bus = int(events[e, EventColumn.BUS])
        if bus >= 0:
            square = magnitude[bus] ** 2
            events[e, EventColumn.CONDUCTANCE] /= square
            events[e, EventColumn.SUSCEPTANCE] /= -square


@compiled
def _start_units(
    block: Floats,
    plant: Plant,
    load_level: float,
    y: npt.NDArray[np.complex128],
    voltage: npt.NDArray[np.complex128],
) -> int:
    """Share each bus's power among its units and set their internal states; angles count from the first unit."""
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    n_bus = voltage.shape[0]
    reference = 0.0
    for i in range(n_sync + n_wtg):
        bus = plant.unit_bus[i]
        injected = 0j
        for k in range(n_bus):
            injected += y[bus, k] * voltage[k]
        total = voltage[bus] * injected.conjugate() + load_level * plant.load[bus]
        weight, weight_all, machines_all, fixed = 0.0, 0.0, 0.0, 0.0
        for u in range(n_sync + n_wtg):
            if plant.unit_bus[u] == bus:
                if u < n_sync:
                    size = plant.machines[u, MachineConstant.REACTIVE_WEIGHT]
                    machines_all += plant.machines[u, MachineConstant.RATING]
                    fixed += plant.dispatch[u]
                else:
                    size = plant.share[u - n_sync]
                    fixed += _start_power(block, plant, u - n_sync)
                weight_all += size
                if u == i:
                    weight = size
        # Reactive power in proportion to the weights; at the slack bus the machines share missing power by rating.
        reactive = total.imag * weight / weight_all if plant.holds_voltage[bus] else 0.0
        if i < n_sync:
            active = plant.dispatch[i]
            if bus == plant.slack:
                active += (total.real - fixed) * plant.machines[i, MachineConstant.RATING] / machines_all
            delta = _start_machine(block, i, plant, complex(active, reactive), voltage[bus])
        else:
            o = n_sync * SyncRow.N_ROWS + (i - n_sync) * WtgRow.N_ROWS
            active = _start_power(block, plant, i - n_sync)
            current = (complex(active, reactive) / voltage[bus]).conjugate()
            emf = voltage[bus] + current / plant.unit_y[i]
            block[o + WtgRow.EMF] = abs(emf)
            delta = math.atan2(emf.imag, emf.real)
            block[o + WtgState.ANGLE] = delta
        if i == 0:
            reference = delta
    for i in range(n_sync):
        block[(i * SyncRow.N_ROWS + SyncState.ANGLE)] -= reference
    for j in range(n_wtg):
        block[(n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS + WtgState.ANGLE)] -= reference
    block[lane_row(plant) + LaneRow.ANGLE] = reference
    return _limit_failure(block, plant)


@compiled
def _limit_failure(block: Floats, plant: Plant) -> int:
    """Return the :class:`StartFailure` of a machine that would start beyond its gate or field limits."""
    for i in range(len(plant.syncs)):
        gate = block[i * SyncRow.N_ROWS + SyncState.GATE]
        field = block[i * SyncRow.N_ROWS + SyncState.FIELD_VOLTAGE]
        m = plant.machines[i]
        if not m[MachineConstant.GATE_MIN] <= gate <= m[MachineConstant.GATE_MAX]:
            return 3
        if not m[MachineConstant.FIELD_MIN] <= field <= m[MachineConstant.FIELD_MAX]:
            return 4
    return 0


@compiled
def _start_machine(block: Floats, i: int, plant: Plant, power: complex, voltage: complex) -> float:
    """Set the states of a synchronous machine from terminal power and voltage; return its rotor angle [rad]."""
    m = plant.machines[i]
    o = i * SyncRow.N_ROWS
    for s in range(4 * N_SYNC_STATES):
        block[o + s] = 0.0
    reactance, resistance = m[MachineConstant.INTERNAL_REACTANCE], m[MachineConstant.RESISTANCE]
    x_q = reactance + m[MachineConstant.X_Q_FIELD]
    x_q_transient, x_d_transient = reactance, reactance
    if m[MachineConstant.X_D_LEAK] > 0.0:
        # x'_d - x'' = (x'_d - x_l)(1 - γ_d), and likewise on the q axis.
        x_d_transient += m[MachineConstant.X_D_LEAK] * (1.0 - m[MachineConstant.GAMMA_D])
        x_q_transient += m[MachineConstant.X_Q_LEAK] * (1.0 - m[MachineConstant.GAMMA_Q])
        x_q = x_q_transient + m[MachineConstant.X_Q_FIELD]
    current = (power / voltage).conjugate()
    axis = voltage + complex(resistance, x_q) * current
    delta = math.atan2(axis.imag, axis.real)
    sine, cosine = math.sin(delta), math.cos(delta)
    i_d, i_q = current.real * sine - current.imag * cosine, current.real * cosine + current.imag * sine
    v_q = voltage.real * cosine + voltage.imag * sine
    field_flux = v_q + resistance * i_q + x_d_transient * i_d
    damper_flux = m[MachineConstant.X_Q_FIELD] * i_q
    field_voltage = field_flux + m[MachineConstant.X_D_FIELD] * i_d
    gain = m[MachineConstant.EXCITER_GAIN]
    error = field_voltage / gain if gain > 0.0 else 0.0
    torque = power.real + resistance * (i_d * i_d + i_q * i_q)
    gate = torque / m[MachineConstant.RATING]
    block[o + SyncState.ANGLE] = delta
    block[o + SyncState.SPEED] = 1.0
    block[o + SyncState.FIELD_FLUX] = field_flux
    block[o + SyncState.DAMPER_FLUX] = damper_flux
    block[o + SyncState.FLUX_D] = field_flux - m[MachineConstant.X_D_LEAK] * i_d
    block[o + SyncState.FLUX_Q] = -damper_flux - m[MachineConstant.X_Q_LEAK] * i_q
    block[o + SyncState.LEAD_LAG] = error
    block[o + SyncState.FIELD_VOLTAGE] = field_voltage
    block[o + SyncState.GATE] = gate
    block[o + SyncState.REHEAT] = gate
    block[o + SyncRow.VOLTAGE_REFERENCE] = abs(voltage) + error
    block[o + SyncRow.GATE_REFERENCE] = gate
    return delta


@compiled
def _start_rows(block: Floats, lane: int, plant: Plant, data: LaneData, magnitude: Floats, lanes: Lanes) -> None:
    """Set clock, network and statistics of a lane, and evaluate its first rates and powers."""
    n_sync = len(plant.syncs)
    own = lane_row(plant)
    block[own + LaneRow.ACTIVE] = 1.0
    block[own + LaneRow.STATUS] = 0.0
    noise_voltage = magnitude[data.noise_bus[lane]]
    block[own + LaneRow.NOISE_PER_MW] = 1.0 / (plant.base_mva * noise_voltage * noise_voltage)
    # An event at t = 0 strikes in the first step, not before the equilibrium.
    block[own + LaneRow.STEP] = -1.0
    refresh_network(block, 0, lane, plant, data, len(lanes))
    block[own + LaneRow.STEP] = 0.0
    combine_load_noise(block, plant, np.zeros(1), lanes)
    evaluate_rates(block.reshape((1, block.shape[0])), plant, lanes)
    block[own + LaneRow.COI_MIN] = math.inf
    block[own + LaneRow.COI_MAX] = -math.inf
    for j in range(len(plant.wtgs)):
        o = n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS
        block[o + WtgRow.PEAK_POWER] = -math.inf
        block[o + WtgRow.LEAST_TSR] = math.inf
        block[o + WtgRow.LARGEST_TSR] = -math.inf
    track_extremes(block, plant, lanes)
    block[own + LaneRow.STEP] = 0.0
    block[own + LaneRow.HEALTHY_STEP] = 0.0
    for j in range(len(plant.wtgs)):
        block[n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS + WtgRow.OVERLOAD_TIME] = 0.0
