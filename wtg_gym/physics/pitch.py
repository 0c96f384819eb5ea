"""Pitch protection: a PI controller on the larger of the power and the speed excess, with a lagging, slow drive.

    e = max(p_w - p_max, K_ω (ω_m - ω_m,max)) / (1 + β/β_K),    İ = K_βI e,    T_β β̇ = I + K_βP e - β

with limits on I, on the demand and on β̇. In an extended group p_max depends on the frequency as the prescribed power
does: its shares at ω_min, ω_st and ω_max are 1, 1 - d_n and 1 - d_pr, so that a group holds its reserve above rated
wind too. Like WECC's pitch controller WTGPT_A it acts on speed and power, but with one
PI. Source of gain schedule and rate limit: J. Jonkman et al.: Definition of a 5-MW Reference Wind Turbine,
NREL/TP-500-38060.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.parameters import PitchParameters
from wtg_gym.systems.elementary import clip, limited_rate


class Pitch(NamedTuple):
    """Constants."""

    power_limit: float  # p_max at ω_st [p.u.]
    power_limit_low: float  # at ω_min
    power_limit_high: float  # at ω_max
    rotor_limit: float  # ω_m,max [p.u.]
    speed_weight: float  # K_ω [p.u./p.u.]
    gain_p: float  # K_βP [deg/p.u.]
    gain_i: float  # K_βI [deg/(p.u. s)]
    inv_schedule: float  # 1/β_K [1/deg]
    inv_actuator: float  # 1/T_β [1/s]
    rate_limit: float  # [deg/s]
    angle_max: float  # [deg]


class PitchState(NamedTuple):
    """States."""

    pitch_integral: float  # I [deg]
    pitch: float  # β [deg]


def pitch_constants(p: PitchParameters, shares: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Pitch:
    """Return the constants; `shares` of the largest captured power are the limits at ω_min, ω_st and ω_max."""
    low, nominal, high = (p.captured_power_limit_pu * share for share in shares)
    return Pitch(
        power_limit=nominal,
        power_limit_low=low,
        power_limit_high=high,
        rotor_limit=p.rotor_speed_limit_pu,
        speed_weight=p.speed_weight,
        gain_p=p.proportional_gain_deg,
        gain_i=p.integral_gain_deg_s,
        inv_schedule=1.0 / p.gain_schedule_deg,
        inv_actuator=1.0 / p.actuator_time_s,
        rate_limit=p.rate_limit_deg_s,
        angle_max=p.largest_angle_deg,
    )


def pitch_rates(s: PitchState, captured: float, rotor_speed: float, power_limit: float, c: Pitch) -> PitchState:
    """Return the rates [deg/s] at a captured power, a rotor speed and a limit p_max [p.u.].

    The integral has non-windup limits, so that it and the blades stay exactly at zero while there is no excess.
    """
    excess = max(captured - power_limit, c.speed_weight * (rotor_speed - c.rotor_limit))
    scheduled = excess / (1.0 + s.pitch * c.inv_schedule)
    demand = clip(s.pitch_integral + c.gain_p * scheduled, 0.0, c.angle_max)
    return PitchState(
        pitch_integral=limited_rate(c.gain_i * scheduled, s.pitch_integral, 0.0, c.angle_max),
        pitch=clip((demand - s.pitch) * c.inv_actuator, -c.rate_limit, c.rate_limit),
    )


def pitch_limited(s: PitchState, c: Pitch) -> PitchState:
    """Return the states, held within their limits."""
    return PitchState(clip(s.pitch_integral, 0.0, c.angle_max), clip(s.pitch, 0.0, c.angle_max))
