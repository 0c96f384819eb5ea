"""The right-hand side, written once.

The same functions serve the single environment (one lane), the batched one (blocks of lanes), the linearisation and the
cross-checks: they are compiled once per lane width, which arrives as a tuple whose length the compiler knows.
"""

from __future__ import annotations

import math

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.elementary import fma, sine_cosine
from wtg_gym.physics.layout import Floats, LaneRow, Lanes, Plant, SyncRow, WtgRow, lane_row, network_row
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


@inlined
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


@inlined
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


@inlined
def _unit_currents(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """I = Y E with the reduced admittance of the lane's topology."""
    width = len(lanes)
    n = len(plant.syncs) + len(plant.wtgs)
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
                block[i_re + i * width + x] += fma(y_re, re, -(y_im * im))
                block[i_im + i * width + x] += fma(y_re, im, y_im * re)


@inlined
def _machine_rates(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """Swing, fluxes, exciter and governor of the synchronous machines."""
    width = len(lanes)
    n = len(plant.syncs) + len(plant.wtgs)
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


@inlined
def _wtg_rates(block: Floats, plant: Plant, fraction: float, lanes: Lanes) -> None:
    """Rotor, pitch, tracking law and grid-forming swing of the WTG groups."""
    width = len(lanes)
    n_sync, n = len(plant.syncs), len(plant.syncs) + len(plant.wtgs)
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
def evaluate_rates(blocks: Floats, plant: Plant, lanes: Lanes) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, in place."""
    for b in range(blocks.shape[0]):
        derivatives(blocks[b], plant, 0.0, lanes)
