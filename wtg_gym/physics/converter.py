"""The grid-forming converter: tracking law, transient damping and swing equation, on the base of its turbine.

    δ̇ = ω_n (ω - ω_ref),    2H ω̇ = P_st - p - D_p (ω - ω_st),    τ ẋ = (ω - ω_st) - x
    P_st = max(g(ω) + Δk, 0) ω_m³ + D_p x

g is piecewise linear through (ω_min, k_min), (ω_st, k_nominal), (ω_max, k_max) and constant outside; a policy adds Δk.
In an extended converter g sees ω + Δω, and P_st has a limit (:mod:`~wtg_gym.physics.extended_converter`).
1/τ = 0 leaves the plain droop (x ≡ 0); τ = 0 puts ω - ω_st in the place of x (the state stays 0) and cancels the droop.
Source: paper, equations (6), (7), (35)-(37).
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.systems.elementary import fma, select


class Corners(NamedTuple):
    """Frequencies at the corners of g [p.u.]."""

    frequency_min: float  # ω_min
    frequency_setpoint: float  # ω_st
    frequency_max: float  # ω_max


class Converter(NamedTuple):
    """Constants of a converter."""

    two_h: float  # 2H [s]
    inv_two_h: float  # [1/s]
    droop_gain: float  # D_p [p.u./p.u.]
    corners: Corners
    reactance: float  # X_g between its voltage and the bus [p.u.]
    overload: float  # power above which it is overloaded [p.u.]


class ConverterState(NamedTuple):
    """States."""

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


def converter_constants(p: GridFormingParameters) -> Converter:
    """Return the constants."""
    return Converter(
        two_h=2.0 * p.inertia_constant_s,
        inv_two_h=0.5 / p.inertia_constant_s,
        droop_gain=p.droop_gain_pu,
        corners=Corners(p.frequency_min_pu, p.frequency_setpoint_pu, p.frequency_max_pu),
        reactance=p.reactance_pu,
        overload=p.overload_limit_pu,
    )


def tracking_coefficient(speed: float, k_min: float, k_nominal: float, k_max: float, c: Corners) -> float:
    """Return g(ω) [p.u.]: coefficients at the three corner frequencies, frequency in p.u.

    Source: paper, equation (37); the linear g of equation (21) has its middle corner on the line.
    """
    # The spans are the same for all lanes: their reciprocals are computed once, a division would be repeated per lane.
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

    Args:
        s, law, c: states, law, constants.
        rotor_speed: ω_m [p.u.].
        power: p into the grid [p.u.].
        reference_speed: of the first unit [p.u.].
        omega_n: nominal angular frequency ω_n [rad/s].
        limiter: of an extended converter: Δω [p.u.], and the most that P_st can be [p.u.].
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
