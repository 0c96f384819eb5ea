"""The synchronous machine: swing equation and GENROU's fluxes, with its exciter and its governor.

    δ̇ = ω_n (ω - ω_ref),    2H ω̇ = T_m - T_e - D (ω - 1),    T_e = p
    T'_d0 Ė'_q = E_fd - E'_q - (x_d - x'_d)(i_d - γ_d2 (ψ_1d + (x'_d - x_l) i_d - E'_q)) - S E''_q
    T'_q0 Ė'_d = -E'_d + (x_q - x'_q)(i_q - γ_q2 (ψ_2q + (x'_q - x_l) i_q + E'_d)) - S E''_d (x_q - x_l)/(x_d - x_l)
    T''_d0 ψ̇_1d = -(ψ_1d + (x'_d - x_l) i_d - E'_q),    T''_q0 ψ̇_2q = -(ψ_2q + (x'_q - x_l) i_q + E'_d)

    E''_q = γ_d E'_q + (1 - γ_d) ψ_1d,    E''_d = γ_q E'_d - (1 - γ_q) ψ_2q
    V_d = E''_d - r i_d + x'' i_q,    V_q = E''_q - r i_q - x'' i_d,    p = E''_d i_d + E''_q i_q
    S = B (ψ - A)²/ψ for ψ > A,    ψ = √(E''_d² + E''_q²)

with γ_d = (x'' - x_l)/(x'_d - x_l), γ_d2 = (x'_d - x'')/(x'_d - x_l)², and γ_q, γ_q2 alike; x''_q = x''_d = x''.
S is saturation by the flux ψ of the air gap, in plants that have any: A and B are those of the parabola through S(1.0)
and S(1.2), see :func:`saturated`. Neglected are stator transients and the effect of speed on voltages; so the
electrical torque T_e equals the air-gap power p [p.u.]. All values are on the system base, those of the governor on the
machine's. Source: P. Sauer, M. Pai: Power System Dynamics and Stability, chapter 3 (subtransient model);
P. Kundur: Power System Stability and Control, chapter 3; saturation: GENROU of PSS/E, as ANDES defines it.
"""

import math
from typing import Any, NamedTuple

from wtg_gym.physics import machine_parameters
from wtg_gym.physics.parameters import constants_of
from wtg_gym.systems.elementary import clip, limited_rate, select


class Saturation(NamedTuple):
    threshold: float  # A [p.u.]
    gain: float  # B [1/p.u.]; 0 for no saturation


def saturation_constants(what: str, first: tuple[float, float], second: tuple[float, float]) -> Saturation:
    """Return the parabola through two points (E, S); none where both S, or the second, are 0.

    A ValueError says that E, or E S, does not rise from the first point to the second, and `what` it is of.
    """
    (e_1, s_1), (e_2, s_2) = first, second
    if s_1 == 0.0 and s_2 == 0.0:
        return Saturation(0.0, 0.0)
    if not (e_1 < e_2 and e_1 * s_1 < e_2 * s_2):
        raise ValueError(
            f"{what}: saturation must rise from S({e_1:g} p.u.) = {s_1:g} to S({e_2:g} p.u.) = {s_2:g}, times the "
            "voltage too"
        )
    ratio = math.sqrt(e_1 * s_1 / (e_2 * s_2))
    threshold = (e_1 - ratio * e_2) / (1.0 - ratio)
    return Saturation(threshold, e_2 * s_2 / (e_2 - threshold) ** 2)


def saturated(value: float, c: Saturation) -> float:
    """Return E S(E) [p.u.] of saturation of iron at a value E [p.u.], by a parabola.

        E S(E) = B (E - A)²  for E > A,  else 0

    through two given points (E_1, S_1) and (E_2, S_2): with a = √(E_1 S_1 / (E_2 S_2)),

        A = (E_1 - a E_2) / (1 - a),    B = E_2 S_2 / (E_2 - A)²

    Source: PSS/E and ANDES, for GENROU as for exciters. Where S_1 is 0, A is E_1, and saturation begins there; ANDES
    has none then.
    """
    excess = max(value - c.threshold, 0.0)
    return c.gain * (excess * excess)


class Exciter(NamedTuple):
    """Constants of SEXS."""

    gain: float  # K [p.u./p.u.]; 0 without an exciter
    lead_lag_ratio: float  # T_A / T_B
    inv_lag_time: float  # 1 / T_B [1/s]
    inv_exciter_time: float  # 1 / T_E [1/s]
    field_min: float  # [p.u.]
    field_max: float


class ExciterState(NamedTuple):
    lead_lag: float  # x [p.u.]
    field_voltage: float  # E_fd [p.u.]


def exciter_constants(parameters: machine_parameters.AnyExciter | None) -> Exciter:
    """Return the constants of an exciter; without one the field voltage stays, unless another model sets it."""
    if not isinstance(parameters, machine_parameters.ExciterParameters):
        return Exciter(0.0, 0.0, 0.0, 0.0, -float("inf"), float("inf"))
    return constants_of(Exciter, parameters)


def exciter_rates(s: ExciterState, voltage_error: float, c: Exciter) -> ExciterState:
    """Return the rates [p.u./s] of the exciter SEXS at a voltage error ΔV = V_ref - V [p.u.].

        T_B ẋ = ΔV - x,    T_E Ė_fd = K (x + (T_A/T_B)(ΔV - x)) - E_fd  with non-windup limits

    Source: the standard model SEXS, as PSS/E and ANDES define it.
    """
    error = voltage_error - s.lead_lag
    lead = s.lead_lag + c.lead_lag_ratio * error
    field_rate = c.inv_exciter_time * (c.gain * lead - s.field_voltage)
    return ExciterState(
        lead_lag=c.inv_lag_time * error,
        field_voltage=limited_rate(field_rate, s.field_voltage, c.field_min, c.field_max),
    )


def exciter_start(field_voltage: float, c: Exciter) -> tuple[ExciterState, float]:
    """Return the equilibrium that gives a field voltage [p.u.], and the voltage error that it needs [p.u.]."""
    error = select(c.gain > 0.0, field_voltage / c.gain, 0.0)
    return ExciterState(error, field_voltage), error


class Governor(NamedTuple):
    """Constants of TGOV1, on the base of the machine."""

    inv_droop: float  # 1/R of the case [p.u./p.u.], 0 without a governor; a scenario may replace it, see MachineInput
    inv_gate_time: float  # 1 / T_1 [1/s]
    lead_reheat_ratio: float  # T_2 / T_3
    inv_reheat_time: float  # 1 / T_3 [1/s]
    gate_min: float  # [p.u.]; of a governor that is a unit of its own, of its reference
    gate_max: float
    turbine_damping: float  # D_t [p.u./p.u.]
    dead_band: float  # [p.u.]
    is_unit: float  # 1 where the torque is that of a governor that is a unit of its own


class GovernorState(NamedTuple):
    gate: float  # g [p.u.]
    reheat: float  # x [p.u.]


def gate_limits(p: Any) -> tuple[float, float]:
    """Return the limits of a gate at rest [p.u.], from parameters or constants."""
    # Of a gas turbine the temperature allows as much as the ambient one.
    return p.gate_min_pu, min(p.gate_max_pu, getattr(p, "load_limit_pu", math.inf))


def governor_constants(parameters: machine_parameters.AnyGovernor | None) -> Governor:
    """Return the constants of a governor; without one, or with one that is a unit of its own, its gate stands still."""
    if not isinstance(parameters, machine_parameters.GovernorParameters):
        inv_droop, is_unit = (0.0, 0.0) if parameters is None else (1.0 / parameters.droop_pu, 1.0)
        limits = (-math.inf, math.inf) if parameters is None else gate_limits(parameters)
        return Governor(inv_droop, 0.0, 0.0, 0.0, *limits, 0.0, 0.0, is_unit)
    ratio = parameters.lead_time_s / parameters.reheat_time_s
    return constants_of(Governor, parameters, lead_reheat_ratio=ratio, is_unit=0.0)


def beyond_dead_band(deviation: float, dead_band: float) -> float:
    """Return how far a deviation lies beyond a dead band, without a step at its edge."""
    # Its slope without a dead band is 1 everywhere, at a deviation of exactly zero too.
    edge = select(deviation < 0.0, -dead_band, dead_band)
    return select(abs(deviation) < dead_band, 0.0, deviation - edge)


def governor_rates(
    s: GovernorState, speed: float, reference: float, inv_droop: float, c: Governor
) -> tuple[GovernorState, float]:
    """Return the rates [p.u./s] and the torque [p.u.] of TGOV1, a droop, a gate with non-windup limits, a reheater.

        T_1 ġ = g_ref - Δω/R - g,    T_3 ẋ = g - x,    T_m = x + (T_2/T_3)(g - x) - D_t (ω - 1)

    Δω is the deviation of the speed ω [p.u.] beyond the dead band, g_ref the reference of the gate [p.u.], and 1/R that
    in use. Source: the standard model TGOV1; the output is taken as torque, as in ANDES.
    """
    demand = reference - inv_droop * beyond_dead_band(speed - 1.0, c.dead_band)
    held = clip(s.gate, c.gate_min, c.gate_max)
    rates = GovernorState(
        gate=limited_rate(c.inv_gate_time * (demand - s.gate), s.gate, c.gate_min, c.gate_max),
        reheat=c.inv_reheat_time * (held - s.reheat),
    )
    return rates, s.reheat + c.lead_reheat_ratio * (held - s.reheat) - c.turbine_damping * (speed - 1.0)


class Machine(NamedTuple):
    internal_reactance: float  # x'', or x'_d of a classical machine [p.u.]
    resistance: float
    gamma_d: float  # (x'' - x_l) / (x'_d - x_l)
    gamma_d2: float  # (x'_d - x'') / (x'_d - x_l)²
    gamma_q: float
    gamma_q2: float
    x_d_field: float  # x_d - x'_d
    x_d_leak: float  # x'_d - x_l
    x_q_field: float
    x_q_leak: float
    inv_t_d0_transient: float  # [1/s]
    inv_t_d0_subtransient: float
    inv_t_q0_transient: float
    inv_t_q0_subtransient: float
    damping: float  # D [p.u./p.u.]
    rating: float  # S_n / system base
    two_h: float  # [s]
    reactive_weight: float  # weight in sharing its bus's initial reactive power [p.u.]; its rating by default
    exciter: Exciter
    governor: Governor


class RotorSaturation(NamedTuple):
    """Constants of a rotor's saturation."""

    curve: Saturation
    q_weight: float  # of the q axis, (x_q - x_l)/(x_d - x_l)


class Saturating(NamedTuple):
    """What saturation takes from the voltages that drive both fluxes [p.u.]."""

    d: float  # S E''_q
    q: float  # S E''_d (x_q - x_l)/(x_d - x_l)


class MachineState(NamedTuple):
    angle: float  # δ of the rotor against the first unit's [rad]
    speed: float  # ω [p.u.]
    e_q_transient: float  # E'_q
    e_d_transient: float  # E'_d
    psi_1d: float  # ψ_1d
    psi_2q: float  # ψ_2q
    exciter: ExciterState
    governor: GovernorState


class MachineInput(NamedTuple):
    """Inputs of a synchronous machine, constant between events."""

    voltage_reference: float  # V_ref [p.u.]
    gate_reference: float  # g_ref [p.u. of the machine]
    inv_two_h: float  # [1/s]
    inv_droop: float  # 1/R [p.u. of the machine]; 0 without a governor, or once it is lost
    connected: float  # 1, or 0 after an outage


class MachineVoltage(NamedTuple):
    """The voltage behind x'' in the rotor's frame, and the frame's angle."""

    sine: float
    cosine: float
    e_d: float  # E''_d [p.u.]
    e_q: float  # E''_q [p.u.]


class MachineOutput(NamedTuple):
    power: float  # of the air gap [p.u.]
    voltage: float  # at the terminal [p.u.]
    torque: float  # mechanical [p.u.]


def in_rotor(e: MachineVoltage, i_re: float, i_im: float) -> tuple[float, float]:
    """Return a current in the rotor's frame, i_d and i_q."""
    return i_re * e.sine - i_im * e.cosine, i_re * e.cosine + i_im * e.sine


def terminal_voltage(e: MachineVoltage, i_re: float, i_im: float, c: Machine) -> float:
    """Return the voltage at the terminal [p.u.], at a current into the network in its frame [p.u.]."""
    i_d, i_q = in_rotor(e, i_re, i_im)
    v_d = e.e_d - c.resistance * i_d + c.internal_reactance * i_q
    v_q = e.e_q - c.resistance * i_q - c.internal_reactance * i_d
    return math.sqrt(v_d * v_d + v_q * v_q)


def saturation_factor(e_d: float, e_q: float, c: RotorSaturation) -> float:
    """Return S at a voltage behind x'' by its components [p.u.]."""
    flux = math.sqrt(e_d * e_d + e_q * e_q)
    return saturated(flux, c.curve) / max(flux, 1e-9)


def machine_limited(s: MachineState, c: Machine) -> MachineState:
    """Return the states, held within their limits."""
    field_voltage = clip(s.exciter.field_voltage, c.exciter.field_min, c.exciter.field_max)
    gate = clip(s.governor.gate, c.governor.gate_min, c.governor.gate_max)
    return s._replace(exciter=s.exciter._replace(field_voltage=field_voltage), governor=s.governor._replace(gate=gate))


def machine_constants(m: machine_parameters.SynchronousMachineParameters, base_mva: float) -> Machine:
    """Return the constants of a machine on the system base `base_mva` [MVA].

    A ValueError says that the reactances are not ordered x_d ≥ x'_d ≥ x'' > x_l, as the model needs.
    """
    scale = base_mva / m.rating_mva
    classical = {"internal_reactance": m.x_d_transient * scale, "gamma_d": 1.0, "gamma_q": 1.0}
    rotor = dict.fromkeys(Machine._fields, 0.0) | classical if m.classical else _genrou(m, scale)
    shared: dict[str, Any] = {
        "resistance": m.resistance * scale,
        "damping": m.damping_pu / scale,
        "rating": 1.0 / scale,
        "two_h": m.two_h_s / scale,
        "reactive_weight": 1.0 / scale if m.reactive_weight is None else m.reactive_weight / base_mva,
        "exciter": exciter_constants(None if m.classical else m.exciter),
        "governor": governor_constants(m.governor),
    }
    return constants_of(Machine, m, **{**rotor, **shared})


def _genrou(m: machine_parameters.SynchronousMachineParameters, scale: float) -> dict[str, float]:
    for axis, x, x_transient in (("d", m.x_d, m.x_d_transient), ("q", m.x_q, m.x_q_transient)):
        if not x >= x_transient >= m.x_subtransient > m.x_leakage >= 0.0:
            raise ValueError(
                f"machine at bus {m.bus}: reactances of the {axis} axis must satisfy x ≥ x' ≥ x'' > x_l ≥ 0, "
                f"got {x:g}, {x_transient:g}, {m.x_subtransient:g}, {m.x_leakage:g} p.u."
            )
    span_d, span_q = m.x_d_transient - m.x_leakage, m.x_q_transient - m.x_leakage
    return {
        "internal_reactance": m.x_subtransient * scale,
        "gamma_d": (m.x_subtransient - m.x_leakage) / span_d,
        "gamma_q": (m.x_subtransient - m.x_leakage) / span_q,
        "gamma_d2": (m.x_d_transient - m.x_subtransient) / (span_d * span_d * scale),
        "gamma_q2": (m.x_q_transient - m.x_subtransient) / (span_q * span_q * scale),
        "x_d_field": (m.x_d - m.x_d_transient) * scale,
        "x_q_field": (m.x_q - m.x_q_transient) * scale,
        "x_d_leak": span_d * scale,
        "x_q_leak": span_q * scale,
    }


def rotor_saturation(m: machine_parameters.SynchronousMachineParameters) -> RotorSaturation:
    """Return the constants of a machine's saturation. A ValueError says that S(1.2) is too small beside S(1.0)."""
    if m.classical:
        return RotorSaturation(Saturation(0.0, 0.0), 1.0)
    curve = saturation_constants(f"machine at bus {m.bus}", (1.0, m.saturation_1_0), (1.2, m.saturation_1_2))
    return RotorSaturation(curve, (m.x_q - m.x_leakage) / (m.x_d - m.x_leakage))
