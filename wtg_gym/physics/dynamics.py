"""The right-hand side, written once, and its fixed-step integration.

The same functions serve the single environment (one lane), the batched one (blocks of lanes), the linearisation and the
cross-checks: they are compiled once per lane width, which arrives as a tuple whose length the compiler knows.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.elementary import sine_cosine
from wtg_gym.physics.layout import (
    N_SYNC_STATES,
    N_WTG_STATES,
    EventColumn,
    LaneData,
    LaneRow,
    Plant,
    Status,
    SyncRow,
    WtgRow,
)
from wtg_gym.physics.network import assemble_admittance, transfer_impedances
from wtg_gym.physics.synchronous_machine import (
    MachineConstant,
    SyncState,
    exciter_rates,
    flux_rates,
    governor_rates,
    subtransient_voltage,
)
from wtg_gym.physics.tracking_law import tracking_coefficient
from wtg_gym.physics.wind_turbine import TurbineConstant, WtgState, captured_power, pitch_rates

Floats = npt.NDArray[np.float64]
#: A tuple of zeros as long as a block is wide; its length is known to the compiler.
Lanes = tuple[int, ...]


@compiled
def derivatives(block: Floats, plant: Plant, fraction: float, lanes: Lanes) -> None:
    """Evaluate the time derivatives of every lane of a block, in place.

    Args:
        block: one block's rows, flat (see :mod:`wtg_gym.physics.layout`).
        plant: constants.
        fraction: where in the control interval, 0 … 1 [-]; the wind is linear between its ends.
        lanes: a tuple as long as the block is wide.
    """
    _internal_voltages(block, plant, lanes)
    _unit_currents(block, plant, lanes)
    _machine_rates(block, plant, lanes)
    _wtg_rates(block, plant, fraction, lanes)
    width = len(lanes)
    lane = lane_row(plant) * width
    for x in range(width):
        block[lane + LaneRow.RATE * width + x] = plant.angular_frequency * (block[SyncState.SPEED * width + x] - 1.0)


@compiled
def network_row(plant: Plant) -> int:
    return len(plant.syncs) * SyncRow.N_ROWS + len(plant.wtgs) * WtgRow.N_ROWS


@compiled
def lane_row(plant: Plant) -> int:
    n = (len(plant.syncs) + len(plant.wtgs))
    return network_row(plant) + 6 * n + 4 * n * n


@compiled
def _internal_voltages(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """Voltages behind the internal impedances, in the network frame."""
    width = len(lanes)
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    n = n_sync + n_wtg
    e_re = network_row(plant) * width
    e_im = e_re + n * width
    for i in range(n_sync):
        o = i * SyncRow.N_ROWS * width
        gamma_d = plant.machines[i, MachineConstant.GAMMA_D]
        gamma_q = plant.machines[i, MachineConstant.GAMMA_Q]
        for x in range(width):
            sine, cosine = sine_cosine(block[o + SyncState.ANGLE * width + x])
            e_d, e_q = subtransient_voltage(
                block[o + SyncState.FIELD_FLUX * width + x],
                block[o + SyncState.DAMPER_FLUX * width + x],
                block[o + SyncState.FLUX_D * width + x],
                block[o + SyncState.FLUX_Q * width + x],
                gamma_d,
                gamma_q,
            )
            block[o + SyncRow.SINE * width + x] = sine
            block[o + SyncRow.COSINE * width + x] = cosine
            block[o + SyncRow.E_D * width + x] = e_d
            block[o + SyncRow.E_Q * width + x] = e_q
            block[e_re + i * width + x] = e_d * sine + e_q * cosine
            block[e_im + i * width + x] = e_q * sine - e_d * cosine
    for j in range(n_wtg):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        at = (n_sync + j) * width
        for x in range(width):
            sine, cosine = sine_cosine(block[o + WtgState.ANGLE * width + x])
            emf = block[o + WtgRow.EMF * width + x]
            block[e_re + at + x] = emf * cosine
            block[e_im + at + x] = emf * sine


@compiled
def _unit_currents(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """I = Y E with the reduced admittance of the lane's topology."""
    width = len(lanes)
    n = (len(plant.syncs) + len(plant.wtgs))
    e_re = network_row(plant) * width
    e_im = e_re + n * width
    i_re = e_im + n * width
    i_im = i_re + n * width
    g = e_re + 6 * n * width
    b = g + n * n * width
    for i in range(n):
        for x in range(width):
            block[i_re + i * width + x] = 0.0
            block[i_im + i * width + x] = 0.0
        for j in range(n):
            at = (i * n + j) * width
            for x in range(width):
                re, im = block[e_re + j * width + x], block[e_im + j * width + x]
                y_re, y_im = block[g + at + x], block[b + at + x]
                block[i_re + i * width + x] += y_re * re - y_im * im
                block[i_im + i * width + x] += y_re * im + y_im * re


@compiled
def _machine_rates(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """Swing, fluxes, exciter and governor of the synchronous machines."""
    width = len(lanes)
    n = (len(plant.syncs) + len(plant.wtgs))
    i_re = (network_row(plant) + 2 * n) * width
    i_im = i_re + n * width
    for i in range(len(plant.syncs)):
        m = plant.machines[i]
        o = i * SyncRow.N_ROWS * width
        rate = o + SyncRow.RATE * width
        reactance, resistance = m[MachineConstant.INTERNAL_REACTANCE], m[MachineConstant.RESISTANCE]
        gamma_d2, gamma_q2 = m[MachineConstant.GAMMA_D2], m[MachineConstant.GAMMA_Q2]
        x_d_field, x_d_leak = m[MachineConstant.X_D_FIELD], m[MachineConstant.X_D_LEAK]
        x_q_field, x_q_leak = m[MachineConstant.X_Q_FIELD], m[MachineConstant.X_Q_LEAK]
        inv_t_d, inv_t_dd = m[MachineConstant.INV_T_D0_TRANSIENT], m[MachineConstant.INV_T_D0_SUBTRANSIENT]
        inv_t_q, inv_t_qq = m[MachineConstant.INV_T_Q0_TRANSIENT], m[MachineConstant.INV_T_Q0_SUBTRANSIENT]
        damping, rating = m[MachineConstant.DAMPING], m[MachineConstant.RATING]
        gain, lead_lag_ratio = m[MachineConstant.EXCITER_GAIN], m[MachineConstant.LEAD_LAG_RATIO]
        inv_lag, inv_exciter = m[MachineConstant.INV_LAG_TIME], m[MachineConstant.INV_EXCITER_TIME]
        field_min, field_max = m[MachineConstant.FIELD_MIN], m[MachineConstant.FIELD_MAX]
        inv_gate, inv_reheat = m[MachineConstant.INV_GATE_TIME], m[MachineConstant.INV_REHEAT_TIME]
        lead_reheat, turbine_damping = m[MachineConstant.LEAD_REHEAT_RATIO], m[MachineConstant.TURBINE_DAMPING]
        gate_min, gate_max = m[MachineConstant.GATE_MIN], m[MachineConstant.GATE_MAX]
        for x in range(width):
            sine, cosine = block[o + SyncRow.SINE * width + x], block[o + SyncRow.COSINE * width + x]
            re, im = block[i_re + i * width + x], block[i_im + i * width + x]
            i_d, i_q = re * sine - im * cosine, re * cosine + im * sine
            e_d, e_q = block[o + SyncRow.E_D * width + x], block[o + SyncRow.E_Q * width + x]
            v_d = e_d - resistance * i_d + reactance * i_q
            v_q = e_q - resistance * i_q - reactance * i_d
            voltage = math.sqrt(v_d * v_d + v_q * v_q)
            power = e_d * i_d + e_q * i_q
            speed = block[o + SyncState.SPEED * width + x]
            field_voltage = block[o + SyncState.FIELD_VOLTAGE * width + x]
            gate, reheat = block[o + SyncState.GATE * width + x], block[o + SyncState.REHEAT * width + x]
            field_rate, damper_rate, d_rate, q_rate = flux_rates(
                block[o + SyncState.FIELD_FLUX * width + x],
                block[o + SyncState.DAMPER_FLUX * width + x],
                block[o + SyncState.FLUX_D * width + x],
                block[o + SyncState.FLUX_Q * width + x],
                field_voltage,
                i_d,
                i_q,
                gamma_d2,
                gamma_q2,
                x_d_field,
                x_d_leak,
                x_q_field,
                x_q_leak,
                inv_t_d,
                inv_t_dd,
                inv_t_q,
                inv_t_qq,
            )
            lead_lag_rate, exciter_rate = exciter_rates(
                block[o + SyncState.LEAD_LAG * width + x],
                field_voltage,
                block[o + SyncRow.VOLTAGE_REFERENCE * width + x] - voltage,
                gain,
                lead_lag_ratio,
                inv_lag,
                inv_exciter,
                field_min,
                field_max,
            )
            gate_rate, reheat_rate = governor_rates(
                gate,
                reheat,
                speed,
                block[o + SyncRow.GATE_REFERENCE * width + x],
                block[o + SyncRow.INV_DROOP * width + x],
                inv_gate,
                inv_reheat,
                gate_min,
                gate_max,
            )
            held = min(max(gate, gate_min), gate_max)
            torque = rating * (reheat + lead_reheat * (held - reheat) - turbine_damping * (speed - 1.0))
            block[o + SyncRow.POWER * width + x] = power
            block[o + SyncRow.VOLTAGE * width + x] = voltage
            block[o + SyncRow.TORQUE * width + x] = torque
            block[rate + SyncState.ANGLE * width + x] = plant.angular_frequency * (
                speed - block[SyncState.SPEED * width + x]
            )
            block[rate + SyncState.SPEED * width + x] = block[o + SyncRow.INV_TWO_H * width + x] * (
                torque - power - damping * (speed - 1.0)
            )
            block[rate + SyncState.FIELD_FLUX * width + x] = field_rate
            block[rate + SyncState.DAMPER_FLUX * width + x] = damper_rate
            block[rate + SyncState.FLUX_D * width + x] = d_rate
            block[rate + SyncState.FLUX_Q * width + x] = q_rate
            block[rate + SyncState.LEAD_LAG * width + x] = lead_lag_rate
            block[rate + SyncState.FIELD_VOLTAGE * width + x] = exciter_rate
            block[rate + SyncState.GATE * width + x] = gate_rate
            block[rate + SyncState.REHEAT * width + x] = reheat_rate


@compiled
def _wtg_rates(block: Floats, plant: Plant, fraction: float, lanes: Lanes) -> None:
    """Rotor, pitch, tracking law and grid-forming swing of the WTG groups."""
    width = len(lanes)
    n_sync, n = len(plant.syncs), (len(plant.syncs) + len(plant.wtgs))
    e_re = network_row(plant) * width
    e_im = e_re + n * width
    i_re = e_im + n * width
    i_im = i_re + n * width
    t = plant.turbine
    tip_speed, wind_power = t[TurbineConstant.TIP_SPEED], t[TurbineConstant.WIND_POWER]
    c1, c2, c3 = t[TurbineConstant.C1], t[TurbineConstant.C2], t[TurbineConstant.C3]
    c5, c6, c7, c8 = (
        t[TurbineConstant.C5],
        t[TurbineConstant.C6],
        t[TurbineConstant.C7],
        t[TurbineConstant.C8],
    )
    inv_two_h_rotor, inv_two_h = t[TurbineConstant.INV_TWO_H_ROTOR], t[TurbineConstant.INV_TWO_H]
    droop_gain, setpoint = t[TurbineConstant.DROOP_GAIN], t[TurbineConstant.SPEED_SETPOINT]
    speed_min, speed_max = t[TurbineConstant.SPEED_MIN], t[TurbineConstant.SPEED_MAX]
    power_limit, rotor_limit = t[TurbineConstant.POWER_LIMIT], t[TurbineConstant.ROTOR_LIMIT]
    speed_weight, pitch_kp = t[TurbineConstant.SPEED_WEIGHT], t[TurbineConstant.PITCH_KP]
    pitch_ki, inv_schedule = t[TurbineConstant.PITCH_KI], t[TurbineConstant.INV_SCHEDULE]
    inv_actuator, pitch_rate_limit = t[TurbineConstant.INV_ACTUATOR], t[TurbineConstant.PITCH_RATE]
    pitch_max = t[TurbineConstant.PITCH_MAX]
    for j in range(len(plant.wtgs)):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        rate = o + WtgRow.RATE * width
        at = (n_sync + j) * width
        inv_share = 1.0 / plant.share[j]
        for x in range(width):
            power = inv_share * (
                block[e_re + at + x] * block[i_re + at + x] + block[e_im + at + x] * block[i_im + at + x]
            )
            wind = block[o + WtgRow.WIND_START * width + x] + fraction * (
                block[o + WtgRow.WIND_END * width + x] - block[o + WtgRow.WIND_START * width + x]
            )
            speed = block[o + WtgState.SPEED * width + x]
            rotor = block[o + WtgState.ROTOR_SPEED * width + x]
            pitch = block[o + WtgState.PITCH * width + x]
            captured = captured_power(rotor, wind, pitch, tip_speed, wind_power, c1, c2, c3, c5, c6, c7, c8)
            integral_rate, pitch_rate = pitch_rates(
                block[o + WtgState.PITCH_INTEGRAL * width + x],
                pitch,
                max(captured - power_limit, speed_weight * (rotor - rotor_limit)),
                pitch_kp,
                pitch_ki,
                inv_schedule,
                inv_actuator,
                pitch_rate_limit,
                pitch_max,
            )
            k = tracking_coefficient(
                speed,
                block[o + WtgRow.K_MIN * width + x],
                block[o + WtgRow.K_NOMINAL * width + x],
                block[o + WtgRow.K_MAX * width + x],
                speed_min,
                setpoint,
                speed_max,
            )
            k = max(k + block[o + WtgRow.K_OFFSET * width + x], 0.0)
            deviation = speed - setpoint
            filtered = block[o + WtgState.FILTER * width + x]
            damping = filtered + block[o + WtgRow.DROOP_CANCELLED * width + x] * (deviation - filtered)
            tracked = k * rotor * rotor * rotor
            connected = block[o + WtgRow.CONNECTED * width + x]
            block[o + WtgRow.WIND * width + x] = wind
            block[o + WtgRow.POWER * width + x] = power
            block[o + WtgRow.CAPTURED * width + x] = connected * captured
            block[o + WtgRow.COEFFICIENT * width + x] = k
            block[rate + WtgState.ANGLE * width + x] = (
                connected * plant.angular_frequency * (speed - block[SyncState.SPEED * width + x])
            )
            block[rate + WtgState.SPEED * width + x] = (
                connected * inv_two_h * (tracked - power + droop_gain * (damping - deviation))
            )
            block[rate + WtgState.ROTOR_SPEED * width + x] = connected * inv_two_h_rotor * (captured - power)
            block[rate + WtgState.FILTER * width + x] = (
                connected * block[o + WtgRow.INV_TAU * width + x] * (deviation - filtered)
            )
            block[rate + WtgState.PITCH_INTEGRAL * width + x] = connected * integral_rate
            block[rate + WtgState.PITCH * width + x] = connected * pitch_rate
            block[rate + WtgState.ENERGY_CAPTURED * width + x] = connected * captured
            block[rate + WtgState.ENERGY_DELIVERED * width + x] = connected * power


@compiled
def _stage(block: Floats, plant: Plant, weight: float, ahead: float, first: bool, lanes: Lanes) -> None:
    """Add a Runge-Kutta stage's rates to the sum and move the states `ahead` [s] from the base along them."""
    width = len(lanes)
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    for i in range(n_sync):
        o = i * SyncRow.N_ROWS * width
        _stage_rows(block, o, N_SYNC_STATES * width, weight, ahead, first)
    for j in range(n_wtg):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        _stage_rows(block, o, N_WTG_STATES * width, weight, ahead, first)
    _stage_rows(block, lane_row(plant) * width, width, weight, ahead, first)


@compiled
def _stage_rows(block: Floats, o: int, count: int, weight: float, ahead: float, first: bool) -> None:
    # States, rates, base and sum of a record follow each other at the same distance.
    if first:
        for r in range(o, o + count):
            value, rate = block[r], block[r + count]
            block[r + 2 * count] = value
            block[r + 3 * count] = rate
            block[r] = value + ahead * rate
    else:
        for r in range(o, o + count):
            rate = block[r + count]
            block[r + 3 * count] += weight * rate
            block[r] = block[r + 2 * count] + ahead * rate


@compiled
def _finish_rows(block: Floats, o: int, count: int, sixth: float, active: int, width: int) -> None:
    # An ended lane keeps its base exactly: nothing, not even a rounding, is added to it.
    for r in range(o, o + count, width):
        for x in range(width):
            base = block[r + 2 * count + x]
            moved = base + sixth * block[r + 3 * count + x]
            block[r + x] = moved if block[active + x] > 0.5 else base


@compiled
def runge_kutta_step(block: Floats, plant: Plant, step: int, lanes: Lanes) -> None:
    """Advance a block by one simulation step with the classical fourth-order method.

    Args:
        block, plant, lanes: as for :func:`derivatives`.
        step: number of the step within the control interval, for the wind's interpolation.
    """
    width = len(lanes)
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    h = plant.simulation_dt
    part = 1.0 / plant.n_substeps
    for stage in range(4):
        ahead = 0.5 * h if stage < 2 else h
        weight = 2.0 if stage == 1 or stage == 2 else 1.0
        offset = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        derivatives(block, plant, (step + offset) * part, lanes)
        _stage(block, plant, weight, ahead, stage == 0, lanes)
    active = (lane_row(plant) + LaneRow.ACTIVE) * width
    for i in range(n_sync):
        o = i * SyncRow.N_ROWS * width
        _finish_rows(block, o, N_SYNC_STATES * width, h / 6.0, active, width)
        field_min = plant.machines[i, MachineConstant.FIELD_MIN]
        field_max = plant.machines[i, MachineConstant.FIELD_MAX]
        gate_min = plant.machines[i, MachineConstant.GATE_MIN]
        gate_max = plant.machines[i, MachineConstant.GATE_MAX]
        _clip_row(block, o + SyncState.FIELD_VOLTAGE * width, field_min, field_max, width)
        _clip_row(block, o + SyncState.GATE * width, gate_min, gate_max, width)
    for j in range(n_wtg):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        _finish_rows(block, o, N_WTG_STATES * width, h / 6.0, active, width)
        pitch_max = plant.turbine[TurbineConstant.PITCH_MAX]
        _clip_row(block, o + WtgState.PITCH_INTEGRAL * width, 0.0, pitch_max, width)
        _clip_row(block, o + WtgState.PITCH * width, 0.0, pitch_max, width)
    _finish_rows(block, lane_row(plant) * width, width, h / 6.0, active, width)


@compiled
def _clip_row(block: Floats, o: int, low: float, high: float, width: int) -> None:
    for x in range(width):
        block[o + x] = min(max(block[o + x], low), high)


@compiled
def track_extremes(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """Update the frequency of the centre of inertia and the extremes of running lanes after a simulation step."""
    width = len(lanes)
    n_sync = len(plant.syncs)
    lane = lane_row(plant) * width
    tip_speed = plant.turbine[TurbineConstant.TIP_SPEED]
    overload = plant.turbine[TurbineConstant.OVERLOAD]
    two_h_wtg = plant.turbine[TurbineConstant.TWO_H]
    for x in range(width):
        momentum, inertia = 0.0, 0.0
        for i in range(n_sync):
            o = i * SyncRow.N_ROWS * width
            two_h = 1.0 / block[o + SyncRow.INV_TWO_H * width + x]
            momentum += two_h * (block[o + SyncState.SPEED * width + x] - 1.0)
            inertia += two_h
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
            two_h = two_h_wtg * plant.share[j] * block[o + WtgRow.CONNECTED * width + x]
            momentum += two_h * (block[o + WtgState.SPEED * width + x] - 1.0)
            inertia += two_h
        coi = 1.0 + momentum / inertia
        running = block[lane + LaneRow.ACTIVE * width + x] > 0.5
        lowest, highest = block[lane + LaneRow.COI_MIN * width + x], block[lane + LaneRow.COI_MAX * width + x]
        block[lane + LaneRow.COI * width + x] = coi
        block[lane + LaneRow.COI_MIN * width + x] = min(lowest, coi)
        block[lane + LaneRow.COI_MAX * width + x] = max(highest, coi)
        block[lane + LaneRow.STEP * width + x] += 1.0 if running else 0.0
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
            # The row holds the power of the step's last stage, which lies at the step's end.
            power = block[o + WtgRow.POWER * width + x]
            ratio = tip_speed * block[o + WtgState.ROTOR_SPEED * width + x] / block[o + WtgRow.WIND * width + x]
            peak = block[o + WtgRow.PEAK_POWER * width + x]
            least = block[o + WtgRow.LEAST_TSR * width + x]
            largest = block[o + WtgRow.LARGEST_TSR * width + x]
            turning = running and block[o + WtgRow.CONNECTED * width + x] > 0.5
            block[o + WtgRow.PEAK_POWER * width + x] = max(peak, power) if turning else peak
            block[o + WtgRow.LEAST_TSR * width + x] = min(least, ratio) if turning else least
            block[o + WtgRow.LARGEST_TSR * width + x] = max(largest, ratio) if turning else largest
            block[o + WtgRow.OVERLOAD_TIME * width + x] += plant.simulation_dt if turning and power > overload else 0.0


@compiled
def refresh_network(block: Floats, x: int, lane: int, plant: Plant, data: LaneData, width: int) -> None:
    """Kron-reduce the network of one lane as it is from its present step on, and note when it changes next.

    Load ramps are staircases: constant over a control interval at the value of its middle.
    """
    n_sync, n = len(plant.syncs), (len(plant.syncs) + len(plant.wtgs))
    own = lane_row(plant) * width
    step = block[own + LaneRow.STEP * width + x]
    n_bus = plant.shunt_y.shape[0]
    events = data.events[lane]
    following = math.inf
    for e in range(events.shape[0]):
        start, end = events[e, EventColumn.START], events[e, EventColumn.END]
        if step < start:
            following = min(following, start)
        elif step < end:
            boundary = (math.floor(step / plant.n_substeps) + 1.0) * plant.n_substeps
            following = min(following, min(boundary, end))
    block[own + LaneRow.NEXT_CHANGE * width + x] = following
    bus_y = np.empty(n_bus, dtype=np.complex128)
    for k in range(n_bus):
        bus_y[k] = plant.shunt_y[k] + data.load_y[lane, k]
    open_branch = np.zeros(plant.branch_from.shape[0], dtype=np.bool_)
    for e in range(events.shape[0]):
        start, end = events[e, EventColumn.START], events[e, EventColumn.END]
        if step >= start:
            level = 1.0 if step >= end else (0.5 * (step + following) - start) / (end - start)
            branch = int(events[e, EventColumn.BRANCH])
            if branch >= 0:
                open_branch[branch] = True
            else:
                bus_y[int(events[e, EventColumn.BUS])] += level * complex(
                    events[e, EventColumn.CONDUCTANCE], events[e, EventColumn.SUSCEPTANCE]
                )
    unit_y = plant.unit_y.copy()
    for j in range(len(plant.wtgs)):
        connected = block[(n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS + WtgRow.CONNECTED) * width + x]
        unit_y[n_sync + j] *= connected
    for i in range(n):
        bus_y[plant.unit_bus[i]] += unit_y[i]
    y = assemble_admittance(plant.branch_from, plant.branch_to, plant.branch_y, open_branch, bus_y)
    noise_bus = data.noise_bus[lane]
    z = transfer_impedances(y, plant.unit_bus, noise_bus)
    _store_reduction(block, x, plant, unit_y, z, noise_bus, width)


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
    n = (len(plant.syncs) + len(plant.wtgs))
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


@compiled
def combine_load_noise(block: Floats, plant: Plant, noise_y: Floats, lanes: Lanes) -> None:
    """Put the load noise into the reduced admittance of every lane of a block by a rank-one update.

    Y = Y0 + Δy/(1 + Δy z) u uᵀ (Sherman-Morrison); exact for one bus, and cheap enough for every control interval.
    `noise_y` (width) is Δy, a conductance [p.u.].
    """
    width = len(lanes)
    n = (len(plant.syncs) + len(plant.wtgs))
    own = lane_row(plant) * width
    u_re = (network_row(plant) + 4 * n) * width
    u_im = u_re + n * width
    g = u_im + n * width
    b = g + n * n * width
    g0 = b + n * n * width
    b0 = g0 + n * n * width
    for i in range(n):
        for j in range(n):
            at = (i * n + j) * width
            for x in range(width):
                dy = noise_y[x]
                d_re = 1.0 + dy * block[own + LaneRow.NOISE_Z_RE * width + x]
                d_im = dy * block[own + LaneRow.NOISE_Z_IM * width + x]
                size = dy / (d_re * d_re + d_im * d_im)
                f_re, f_im = size * d_re, -size * d_im
                u_i_re, u_i_im = block[u_re + i * width + x], block[u_im + i * width + x]
                u_j_re, u_j_im = block[u_re + j * width + x], block[u_im + j * width + x]
                v_re = u_i_re * u_j_re - u_i_im * u_j_im
                v_im = u_i_re * u_j_im + u_i_im * u_j_re
                block[g + at + x] = block[g0 + at + x] + f_re * v_re - f_im * v_im
                block[b + at + x] = block[b0 + at + x] + f_re * v_im + f_im * v_re


@compiled
def advance_interval(block: Floats, first_lane: int, plant: Plant, data: LaneData, noise_y: Floats, lanes: Lanes) -> None:
    """Advance every running lane of a block by one control interval.

    The control inputs (K_OFFSET, INV_TAU) are rows of the block and hold over the interval. On return the rows hold
    powers, coefficients and rates at the interval's end; `noise_y` (width) is scratch.
    """
    width = len(lanes)
    n_sync = len(plant.syncs)
    own = lane_row(plant) * width
    last = data.wind.shape[2] - 1
    for x in range(width):
        index = int(block[own + LaneRow.STEP * width + x]) // plant.n_substeps
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
            block[o + WtgRow.WIND_START * width + x] = data.wind[first_lane + x, j, min(index, last)]
            block[o + WtgRow.WIND_END * width + x] = data.wind[first_lane + x, j, min(index + 1, last)]
        noise = data.noise[first_lane + x, min(index, data.noise.shape[1] - 1)]
        noise_y[x] = noise * block[own + LaneRow.NOISE_PER_MW * width + x]
    combine_load_noise(block, plant, noise_y, lanes)
    for step in range(plant.n_substeps):
        changed = False
        for x in range(width):
            if block[own + LaneRow.STEP * width + x] >= block[own + LaneRow.NEXT_CHANGE * width + x]:
                refresh_network(block, x, first_lane + x, plant, data, width)
                changed = True
        if changed:
            # For the whole block: a lane without a change gets the same bits again.
            combine_load_noise(block, plant, noise_y, lanes)
        runge_kutta_step(block, plant, step, lanes)
        track_extremes(block, plant, lanes)
    update_status(block, plant, width)
    derivatives(block, plant, 1.0, lanes)


@compiled
def update_status(block: Floats, plant: Plant, width: int) -> None:
    """End lanes that stalled, over-sped, left the frequency limits or are no longer finite; or trip their groups."""
    n_sync = len(plant.syncs)
    own = lane_row(plant) * width
    t = plant.turbine
    for x in range(width):
        if block[own + LaneRow.ACTIVE * width + x] < 0.5:
            continue
        coi = block[own + LaneRow.COI * width + x]
        status = 0
        if coi < t[TurbineConstant.COI_MIN] or coi > t[TurbineConstant.COI_MAX]:
            status = Status.FREQUENCY_LIMIT
        total = coi
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width + x
            rotor = block[o + WtgState.ROTOR_SPEED * width]
            ratio = t[TurbineConstant.TIP_SPEED] * rotor / block[o + WtgRow.WIND * width]
            total += rotor + block[o + WtgState.SPEED * width]
            failure = 0
            if ratio < t[TurbineConstant.STALL_TIP_SPEED_RATIO]:
                if block[o + WtgState.PITCH * width] < t[TurbineConstant.STALL_PITCH]:
                    failure = Status.STALL
            elif rotor > t[TurbineConstant.OVER_SPEED]:
                failure = Status.OVER_SPEED
            if failure != 0 and block[o + WtgRow.CONNECTED * width] > 0.5:
                if plant.trips_groups:
                    block[o + WtgRow.CONNECTED * width] = 0.0
                    block[own + LaneRow.NEXT_CHANGE * width + x] = block[own + LaneRow.STEP * width + x]
                else:
                    status = failure
        if not math.isfinite(total):
            status = Status.NUMERICAL_FAILURE
        if status != 0:
            block[own + LaneRow.STATUS * width + x] = status
            block[own + LaneRow.ACTIVE * width + x] = 0.0


@compiled
def advance_blocks(
    blocks: Floats, first: int, last: int, plant: Plant, data: LaneData, lanes: Lanes
) -> None:
    """Advance the blocks first … last - 1 of `blocks` (n_blocks, n_rows · width) by one control interval."""
    noise_y = np.empty(len(lanes))
    for b in range(first, last):
        advance_interval(blocks[b], b * len(lanes), plant, data, noise_y, lanes)


@compiled
def evaluate_rates(blocks: Floats, plant: Plant, lanes: Lanes) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, in place."""
    for b in range(blocks.shape[0]):
        derivatives(blocks[b], plant, 0.0, lanes)
