"""The grid-forming converter on the base of its turbine, and what an extended one has besides.

    δ̇ = ω_n (ω - ω_ref),    2H ω̇ = P_st - p - D_p (ω - ω_st),    τ ẋ = (ω - ω_st) - x
    P_st = max(g(ω) + Δk, 0) ω_m³ + D_p x

are tracking law, transient damping and swing equation. g is piecewise linear through (ω_min, k_min), (ω_st, k_nominal),
(ω_max, k_max) and constant outside; a policy adds Δk. 1/τ = 0 leaves the plain droop (x ≡ 0); τ = 0 puts ω - ω_st in
the place of x (the state stays 0) and cancels the droop. In an extended converter g sees ω + Δω, and P_st has a limit.
Source: paper, equations (6), (7), (35)-(37).

An extended converter. Current. (E - V)/(jX_g) keeps its angle, and its size is cut to I_max: the voltage behind X_g
becomes E' = E - jX_v I with the smallest X_v ≥ 0 that holds |I| ≤ I_max. Seen from the unit the rest of the network is
a voltage behind an impedance Z that includes X_g, so

    X_v = sqrt(max((|ΔE|/I_max)² - R², 0)) - X,    ΔE = I_0 Z,    Z = R + jX,    I = ΔE/(Z + jX_v)

with I_0 the current without the limit. Power. A frequency is added to the angle's equation,

    δ̇ = ω_n (ω + Δω - ω_ref),    Δω = min(k_p (p_top - p) + x_o, 0) + max(k_p (p_min - p) + x_u, 0)
    ẋ_o = k_i (p_top - p), x_o ≤ 0,    ẋ_u = k_i (p_min - p), x_u ≥ 0,    p_top = min(p_max, T_max ω_m)

p_top is also the most that k ω_m³ can be. ω + Δω is the frequency of the voltage, and what everything that measures one
sees; ω is that of the swing equation, whose droop keeps it near the set-point while the limiter acts. Rotor. It gives
max(p, p_min): a chopper burns what the grid presses into the converter. Its heat cools with a time constant; once it
exceeds what the chopper stands, the group disconnects. Voltage. Droop, reactive limits and one integrator,

    Ė = K_iv e,    e = max(min(V_ref - V - m_q (q - q_ref), K_q (q_max - q)), K_q (-q_max - q)),    E_min ≤ E ≤ E_max

E is the voltage behind X_g, V and q are those of the terminal. Where a reactive limit is exceeded its own error takes
over, so that one integrator serves both and nothing winds up. While the current is limited E rises less, and not at all
where the limiter takes CUT_FULL or more from the voltage: Ė ≤ max(1 - X_v |I| / CUT_FULL, 0) K_iv e for e > 0.

Source: REGFM_A1 (W. Du et al., PNNL-32278), its current limiter and its active power limiters; there the terminal
voltage is the last iterate's, here the limit holds with the network's solution. Its voltage control, with the takeover
of IEEE 421.5's excitation limiters in place of two integrators more, and without the filters of its measurements.
"""

import math
from typing import NamedTuple

from wtg_gym.physics import parameters
from wtg_gym.systems.elementary import fma, limited_rate, select


class Corners(NamedTuple):
    """Frequencies at the corners of g [p.u.]."""

    frequency_min: float  # ω_min
    frequency_setpoint: float  # ω_st
    frequency_max: float  # ω_max


class Converter(NamedTuple):
    two_h: float  # 2H [s]
    inv_two_h: float  # [1/s]
    droop_gain: float  # D_p [p.u./p.u.]
    corners: Corners
    reactance: float  # X_g between its voltage and the bus [p.u.]
    overload_limit: float  # power above which it is overloaded [p.u.]


class ConverterState(NamedTuple):
    angle: float  # δ of its voltage against the first unit's rotor [rad]
    speed: float  # ω [p.u.]
    filter: float  # x, the filtered frequency deviation [p.u.]


class Law(NamedTuple):
    """The tracking law in use: its coefficients [p.u.], and what a policy makes of it."""

    k_min: float
    k_nominal: float
    k_max: float
    k_offset: float  # Δk [p.u.]
    inv_tau: float  # 1/τ [1/s]
    droop_cancelled: float  # 1 where τ = 0, else 0


def converter_constants(p: parameters.GridFormingParameters) -> Converter:
    """Return the constants."""
    h, corners = p.inertia_constant_s, parameters.constants_of(Corners, p)
    return parameters.constants_of(Converter, p, two_h=2.0 * h, inv_two_h=0.5 / h, corners=corners)


def tracking_coefficient(speed: float, k_min: float, k_nominal: float, k_max: float, c: Corners) -> float:
    """Return g(ω) [p.u.]: coefficients at the three corner frequencies, frequency in p.u.

    Source: paper, equation (37); the linear g of equation (21) has its middle corner on the line.
    """
    # The spans are the same for all environments: reciprocals are computed once, a division would be for each.
    # The middle corner itself belongs to the side below: so has g one slope there too, where a plant rests.
    is_below = speed <= c.frequency_setpoint
    away = select(is_below, c.frequency_setpoint - speed, speed - c.frequency_setpoint)
    below, above = 1.0 / (c.frequency_setpoint - c.frequency_min), 1.0 / (c.frequency_max - c.frequency_setpoint)
    share = min(away * select(is_below, below, above), 1.0)
    return fma(share, select(is_below, k_min, k_max) - k_nominal, k_nominal)


def converter_rates(
    s: ConverterState,
    rotor_speed: float,
    power: float,
    law: Law,
    c: Converter,
    reference_speed: float,
    omega_n: float,
    limiter: tuple[float, float] | None = None,
) -> tuple[ConverterState, float]:
    """Return the rates, and the tracking coefficient k in use [p.u.].

    They are those at a rotor speed ω_m, a power p into the grid, and a speed of the first unit [p.u.]; `limiter` of an
    extended converter is Δω and the most that k ω_m³ can be [p.u.].
    """
    deviation = s.speed - c.corners.frequency_setpoint
    frequency = s.speed if limiter is None else s.speed + limiter[0]
    k = max(tracking_coefficient(frequency, law.k_min, law.k_nominal, law.k_max, c.corners) + law.k_offset, 0.0)
    damping = s.filter + law.droop_cancelled * (deviation - s.filter)
    tracked = k * rotor_speed * rotor_speed * rotor_speed
    if limiter is not None:
        tracked = min(tracked, limiter[1])
    rates = ConverterState(
        angle=omega_n * (frequency - reference_speed),
        speed=c.inv_two_h * (tracked - power + c.droop_gain * (damping - deviation)),
        filter=law.inv_tau * (deviation - s.filter),
    )
    return rates, k


#: Stands for no limit where infinity would make 0 · ∞ [p.u.].
_UNLIMITED = 1e9
#: Voltage that the current limiter takes from E, from which on E does not rise [p.u.]; a design value.
CUT_FULL = 0.02


class ConverterLimits(NamedTuple):
    """Constants of current and power limits and of the chopper."""

    current_max: float  # I_max [p.u.]
    power_max: float  # p_max [p.u.]
    power_min: float  # p_min ≤ 0 [p.u.]
    torque_max: float  # T_max [p.u.]
    power_gain: float  # k_p [p.u. of frequency per p.u. of power]
    power_integral_gain: float  # k_i [1/s]
    chopper_energy: float  # that the chopper stands [p.u. s]
    heat_kept: float  # share of its heat that is left after a simulation step


class LimitState(NamedTuple):
    """States of the power limiters and the chopper."""

    over_power: float  # x_o [p.u.]
    under_power: float  # x_u [p.u.]
    energy_chopped: float  # ∫ (max(p, p_min) - p) dt [p.u. s]


def converter_limits(p: parameters.ConverterLimitParameters | None, simulation_dt: float) -> ConverterLimits:
    """Return the constants for a simulation step [s]; None for a converter without limits."""
    if p is None:
        return ConverterLimits(_UNLIMITED, _UNLIMITED, -_UNLIMITED, _UNLIMITED, 0.0, 0.0, _UNLIMITED, 0.0)
    return parameters.constants_of(ConverterLimits, p, heat_kept=math.exp(-simulation_dt / p.chopper_cooling_s))


#: Voltage above which a group stays connected for a time only [p.u.], and that time [s]. Source: Australian National
#: Electricity Rules, S5.2.5.4, automatic access standard. (IEEE 2800-2022 asks for 1 s above 1.1 p.u.)
OVER_VOLTAGES = ((1.10, 1200.0), (1.15, 20.0), (1.20, 2.0), (1.25, 0.2), (1.30, 0.02))


class OverVoltage(NamedTuple):
    """The simulation steps at which the voltage was last below each of `OVER_VOLTAGES`."""

    step_110: float
    step_115: float
    step_120: float
    step_125: float
    step_130: float


def most_power(rotor_speed: float, c: ConverterLimits) -> float:
    """Return p_top, the most that a turbine gives for long at a rotor speed [p.u.]."""
    return min(c.power_max, c.torque_max * rotor_speed)


def limiting_reactance(current_re: float, current_im: float, y_re: float, y_im: float, current_max: float) -> float:
    """Return X_v [p.u.], 0 where nothing is to be limited.

    The current I_0 is the unit's without its limit, all other units as they are; y is 1/Z, the unit's own entry of the
    reduced admittance matrix, 0 of a group that has tripped; all are on one base [p.u.].
    """
    inverse = 1.0 / max(fma(y_re, y_re, y_im * y_im), 1e-20)
    r, x = y_re * inverse, -y_im * inverse
    current, largest = fma(current_re, current_re, current_im * current_im), current_max * current_max
    target = math.sqrt(max(current * inverse / largest - r * r, 0.0)) - x
    # Exactly zero without an excess, whatever the rounding of the root.
    return select(current > largest, max(target, 0.0), 0.0)


def power_limiter(s: LimitState, power: float, most: float, c: ConverterLimits) -> tuple[LimitState, float, float]:
    """Return the rates, Δω and the power that the rotor gives [p.u.], at a power into the grid and with its limit."""
    over, under = most - power, c.power_min - power
    shift = min(fma(c.power_gain, over, s.over_power), 0.0) + max(fma(c.power_gain, under, s.under_power), 0.0)
    drawn = max(power, c.power_min)
    rates = LimitState(
        over_power=limited_rate(c.power_integral_gain * over, s.over_power, -_UNLIMITED, 0.0),
        under_power=limited_rate(c.power_integral_gain * under, s.under_power, 0.0, _UNLIMITED),
        energy_chopped=drawn - power,
    )
    return rates, shift, drawn


class VoltageControl(NamedTuple):
    """Constants of voltage control."""

    integral_gain: float  # K_iv [1/s]; 0 for a constant voltage behind X_g
    droop: float  # m_q [p.u./p.u.]
    reactive_max: float  # q_max [p.u.]
    takeover_gain: float  # K_q [p.u./p.u.]
    internal_voltage_min: float  # E_min [p.u.]
    internal_voltage_max: float  # E_max [p.u.]


class VoltageInput(NamedTuple):
    """Constant over a run."""

    voltage_reference: float  # V_ref [p.u.]
    reactive_reference: float  # q_ref [p.u.]


def voltage_control(p: parameters.VoltageControlParameters | None) -> VoltageControl:
    """Return the constants; None for a constant voltage behind X_g."""
    if p is None:
        return VoltageControl(0.0, 0.0, 0.0, 0.0, 0.0, math.inf)
    return parameters.constants_of(VoltageControl, p)


def emf_rate(emf: float, voltage: float, reactive: float, cut: float, u: VoltageInput, c: VoltageControl) -> float:
    """Return Ė [p.u./s]; `cut` is X_v |I|, what the limiter takes from E, V and q are of the terminal [p.u.]."""
    error = u.voltage_reference - voltage - c.droop * (reactive - u.reactive_reference)
    error = min(error, c.takeover_gain * (c.reactive_max - reactive))
    error = max(error, c.takeover_gain * (-c.reactive_max - reactive))
    rate = limited_rate(c.integral_gain * error, emf, c.internal_voltage_min, c.internal_voltage_max)
    return select(rate > 0.0, rate * max(1.0 - cut * (1.0 / CUT_FULL), 0.0), rate)
