"""GENROU without saturation, SEXS exciter and TGOV1 governor, as plain-float functions.

All quantities are on the system base (reactances × 100/S_n, 2H × S_n/100), except the governor, which works on the
machine's base. A classical machine is the same equations with inverse time constants of zero and one reactance, so
that one right-hand side serves both. Source: P. W. Sauer, M. A. Pai: Power System Dynamics and Stability, chapters
3 and 6 (two-axis subtransient model, x''_q = x''_d); exciter and governor as in the PSS/E and ANDES model libraries.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.elementary import limited_rate
from wtg_gym.physics.parameters import SynchronousMachineParameters


class SyncState(IntEnum):
    """State columns of a synchronous machine."""

    ANGLE = 0  # rotor angle against the first unit's rotor [rad]
    SPEED = 1  # [p.u.]
    FIELD_FLUX = 2  # E'_q [p.u.]
    DAMPER_FLUX = 3  # E'_d [p.u.]
    FLUX_D = 4  # ψ_1d [p.u.]
    FLUX_Q = 5  # ψ_2q [p.u.]
    LEAD_LAG = 6  # exciter lead-lag [p.u.]
    FIELD_VOLTAGE = 7  # E_fd [p.u.]
    GATE = 8  # governor gate [p.u. of the machine]
    REHEAT = 9  # turbine lead-lag [p.u. of the machine]


class MachineConstant(IntEnum):
    """Columns of the table of machine constants (system base)."""

    INTERNAL_REACTANCE = 0
    RESISTANCE = 1
    GAMMA_D = 2
    GAMMA_D2 = 3
    GAMMA_Q = 4
    GAMMA_Q2 = 5
    X_D_FIELD = 6  # x_d - x'_d
    X_D_LEAK = 7  # x'_d - x_l
    X_Q_FIELD = 8
    X_Q_LEAK = 9
    INV_T_D0_TRANSIENT = 10
    INV_T_D0_SUBTRANSIENT = 11
    INV_T_Q0_TRANSIENT = 12
    INV_T_Q0_SUBTRANSIENT = 13
    DAMPING = 14
    EXCITER_GAIN = 15
    LEAD_LAG_RATIO = 16
    INV_LAG_TIME = 17
    INV_EXCITER_TIME = 18
    FIELD_MIN = 19
    FIELD_MAX = 20
    INV_GATE_TIME = 21
    LEAD_REHEAT_RATIO = 22  # T_2 / T_3
    INV_REHEAT_TIME = 23
    GATE_MIN = 24
    GATE_MAX = 25
    TURBINE_DAMPING = 26
    RATING = 27  # S_n / system base
    TWO_H = 28  # on the system base [s]
    INV_DROOP = 29
    REACTIVE_WEIGHT = 30  # rating, or what shares the reactive power of its bus instead [p.u.]


@compiled
def subtransient_voltage(
    field_flux: float, damper_flux: float, flux_d: float, flux_q: float, gamma_d: float, gamma_q: float
) -> tuple[float, float]:
    """Return (E''_d, E''_q) [p.u.] behind x''. Source: Sauer and Pai, subtransient flux linkages."""
    e_d = gamma_q * damper_flux - (1.0 - gamma_q) * flux_q
    e_q = gamma_d * field_flux + (1.0 - gamma_d) * flux_d
    return e_d, e_q


@compiled
def flux_rates(
    field_flux: float,
    damper_flux: float,
    flux_d: float,
    flux_q: float,
    field_voltage: float,
    i_d: float,
    i_q: float,
    gamma_d2: float,
    gamma_q2: float,
    x_d_field: float,
    x_d_leak: float,
    x_q_field: float,
    x_q_leak: float,
    inv_t_d: float,
    inv_t_dd: float,
    inv_t_q: float,
    inv_t_qq: float,
) -> tuple[float, float, float, float]:
    """Return the rates of (E'_q, E'_d, ψ_1d, ψ_2q) [p.u./s]; currents [p.u.], inverse time constants [1/s]."""
    damper_d = flux_d + x_d_leak * i_d - field_flux
    damper_q = flux_q + x_q_leak * i_q + damper_flux
    field_flux_rate = inv_t_d * (field_voltage - field_flux - x_d_field * (i_d - gamma_d2 * damper_d))
    damper_flux_rate = inv_t_q * (-damper_flux + x_q_field * (i_q - gamma_q2 * damper_q))
    return field_flux_rate, damper_flux_rate, -inv_t_dd * damper_d, -inv_t_qq * damper_q


@compiled
def exciter_rates(
    lead_lag: float,
    field_voltage: float,
    voltage_error: float,
    gain: float,
    lead_lag_ratio: float,
    inv_lag_time: float,
    inv_exciter_time: float,
    field_min: float,
    field_max: float,
) -> tuple[float, float]:
    """Return the rates of (lead-lag state, E_fd) of SEXS [p.u./s]; error = V_ref - V [p.u.]."""
    lead = lead_lag + lead_lag_ratio * (voltage_error - lead_lag)
    field_rate = inv_exciter_time * (gain * lead - field_voltage)
    return inv_lag_time * (voltage_error - lead_lag), limited_rate(field_rate, field_voltage, field_min, field_max)


@compiled
def governor_rates(
    gate: float,
    reheat: float,
    speed: float,
    reference: float,
    inv_droop: float,
    inv_gate_time: float,
    inv_reheat_time: float,
    gate_min: float,
    gate_max: float,
) -> tuple[float, float]:
    """Return the rates of (gate, reheat) of TGOV1 [p.u. of the machine/s]; speed [p.u.]."""
    demand = reference - inv_droop * (speed - 1.0)
    gate_rate = limited_rate(inv_gate_time * (demand - gate), gate, gate_min, gate_max)
    held = min(max(gate, gate_min), gate_max)
    return gate_rate, inv_reheat_time * (held - reheat)


def machine_constants(machine: SynchronousMachineParameters, base_mva: float) -> npt.NDArray[np.float64]:
    """Return the row of :class:`MachineConstant` values of one machine on the system base `base_mva` [MVA].

    Raises:
        ValueError: the reactances are not ordered x_d ≥ x'_d ≥ x'' > x_l, as the model needs.
    """
    c = MachineConstant
    row = np.zeros(len(c))
    scale = base_mva / machine.rating_mva
    row[c.RATING] = row[c.REACTIVE_WEIGHT] = 1.0 / scale
    if machine.reactive_weight is not None:
        row[c.REACTIVE_WEIGHT] = machine.reactive_weight / base_mva
    row[c.TWO_H] = machine.two_h_s / scale
    row[c.DAMPING] = machine.damping_pu / scale
    row[c.RESISTANCE] = machine.resistance * scale
    row[c.FIELD_MIN], row[c.FIELD_MAX] = -np.inf, np.inf
    row[c.GATE_MIN], row[c.GATE_MAX] = -np.inf, np.inf
    if machine.classical:
        row[c.INTERNAL_REACTANCE] = machine.x_d_transient * scale
        row[c.GAMMA_D] = row[c.GAMMA_Q] = 1.0
    else:
        _genrou_constants(machine, scale, row)
        if machine.exciter is not None:
            exciter = machine.exciter
            row[c.EXCITER_GAIN] = exciter.gain
            row[c.LEAD_LAG_RATIO] = exciter.lead_lag_ratio
            row[c.INV_LAG_TIME] = 1.0 / exciter.lag_time_s
            row[c.INV_EXCITER_TIME] = 1.0 / exciter.exciter_time_s
            row[c.FIELD_MIN], row[c.FIELD_MAX] = exciter.field_min_pu, exciter.field_max_pu
    if machine.governor is not None:
        governor = machine.governor
        row[c.INV_DROOP] = 1.0 / governor.droop_pu
        row[c.INV_GATE_TIME] = 1.0 / governor.gate_time_s
        row[c.LEAD_REHEAT_RATIO] = governor.lead_time_s / governor.reheat_time_s
        row[c.INV_REHEAT_TIME] = 1.0 / governor.reheat_time_s
        row[c.GATE_MIN], row[c.GATE_MAX] = governor.gate_min_pu, governor.gate_max_pu
        row[c.TURBINE_DAMPING] = governor.turbine_damping_pu
    return row


def _genrou_constants(m: SynchronousMachineParameters, scale: float, row: npt.NDArray[np.float64]) -> None:
    for axis, x, x_transient in (("d", m.x_d, m.x_d_transient), ("q", m.x_q, m.x_q_transient)):
        if not x >= x_transient >= m.x_subtransient > m.x_leakage >= 0.0:
            raise ValueError(
                f"machine at bus {m.bus}: reactances of the {axis} axis must satisfy x ≥ x' ≥ x'' > x_l ≥ 0, "
                f"got {x:g}, {x_transient:g}, {m.x_subtransient:g}, {m.x_leakage:g} p.u."
            )
    c = MachineConstant
    row[c.INTERNAL_REACTANCE] = m.x_subtransient * scale
    span_d, span_q = m.x_d_transient - m.x_leakage, m.x_q_transient - m.x_leakage
    row[c.GAMMA_D] = (m.x_subtransient - m.x_leakage) / span_d
    row[c.GAMMA_Q] = (m.x_subtransient - m.x_leakage) / span_q
    row[c.GAMMA_D2] = (m.x_d_transient - m.x_subtransient) / (span_d * span_d * scale)
    row[c.GAMMA_Q2] = (m.x_q_transient - m.x_subtransient) / (span_q * span_q * scale)
    row[c.X_D_FIELD] = (m.x_d - m.x_d_transient) * scale
    row[c.X_Q_FIELD] = (m.x_q - m.x_q_transient) * scale
    row[c.X_D_LEAK], row[c.X_Q_LEAK] = span_d * scale, span_q * scale
    row[c.INV_T_D0_TRANSIENT] = 1.0 / m.t_d0_transient_s
    row[c.INV_T_D0_SUBTRANSIENT] = 1.0 / m.t_d0_subtransient_s
    row[c.INV_T_Q0_TRANSIENT] = 1.0 / m.t_q0_transient_s
    row[c.INV_T_Q0_SUBTRANSIENT] = 1.0 / m.t_q0_subtransient_s
