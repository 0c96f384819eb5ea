"""Rotor, pitch protection and grid-forming swing equation of one WTG, as plain-float functions on its own base."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.aerodynamics import power_coefficient_at, tracking_point
from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.elementary import limited_rate
from wtg_gym.physics.parameters import (
    GridFormingParameters,
    PitchParameters,
    ProtectionParameters,
    TurbineParameters,
)


class WtgState(IntEnum):
    """State columns of a WTG group."""

    ANGLE = 0  # angle of its voltage against the first unit's [rad]
    SPEED = 1  # frequency ω of the grid-forming control [p.u.]
    ROTOR_SPEED = 2  # ω_m [p.u.]
    FILTER = 3  # x of the tracking law [p.u.]
    PITCH_INTEGRAL = 4  # [deg]
    PITCH = 5  # β [deg]
    ENERGY_CAPTURED = 6  # ∫ p_w dt [p.u. s]
    ENERGY_DELIVERED = 7  # ∫ p dt [p.u. s]


class TurbineConstant(IntEnum):
    """Entries of the table of turbine and control constants (own base)."""

    C1 = 0
    C2 = 1
    C3 = 2
    C5 = 3
    C6 = 4
    C7 = 5
    C8 = 6
    TIP_SPEED = 7  # ω_tn R [m/s]
    WIND_POWER = 8  # ρ π R² / (2 S_n) [p.u. s³/m³]
    INV_TWO_H_ROTOR = 9
    INV_TWO_H = 10
    DROOP_GAIN = 11
    SPEED_SETPOINT = 12
    SPEED_MIN = 13
    SPEED_MAX = 14
    POWER_LIMIT = 15
    ROTOR_LIMIT = 16
    SPEED_WEIGHT = 17
    PITCH_KP = 18
    PITCH_KI = 19
    INV_SCHEDULE = 20
    INV_ACTUATOR = 21
    PITCH_RATE = 22
    PITCH_MAX = 23
    OVERLOAD = 24
    TIP_SPEED_RATIO_OPT = 25
    TIP_SPEED_RATIO_LIMIT = 26  # λ_pr
    AVAILABLE_PER_CUBIC_WIND = 27  # available power / v³ at β = 0 [p.u. s³/m³]
    REACTANCE = 28  # X_g on the own base [p.u.]
    TWO_H = 29  # 2H of the grid-forming control [s]
    RATED_MW = 30
    STALL_TIP_SPEED_RATIO = 31
    STALL_PITCH = 32
    OVER_SPEED = 33
    COI_MIN = 34  # frequency limits [p.u.]
    COI_MAX = 35
    ANGLE_SPREAD = 36  # largest difference of the units' angles [rad]
    LOW_VOLTAGE = 37  # [p.u.]
    LOW_VOLTAGE_TIME = 38  # [s]


@compiled
def captured_power(
    rotor_speed: float,
    wind: float,
    pitch_deg: float,
    tip_speed: float,
    wind_power: float,
    c1: float,
    c2: float,
    c3: float,
    c5: float,
    c6: float,
    c7: float,
    c8: float,
) -> float:
    """Return p_w [p.u.] at rotor speed ω_m [p.u.], wind [m/s] and pitch [deg]. Source: paper, equation `pw`."""
    tip = tip_speed * max(rotor_speed, 1e-3)
    return wind_power * wind * wind * wind * power_coefficient_at(tip, wind, pitch_deg, c1, c2, c3, c5, c6, c7, c8)


@compiled
def pitch_rates(
    integral: float,
    pitch: float,
    excess: float,
    gain_p: float,
    gain_i: float,
    inv_schedule: float,
    inv_actuator: float,
    rate_limit: float,
    angle_max: float,
) -> tuple[float, float]:
    """Return the rates of (integral, pitch angle) [deg/s] for an excess of power or speed [p.u.].

    The integral has non-windup limits, so that pitch and integral stay exactly at zero while the excess is negative.
    """
    scheduled = excess / (1.0 + pitch * inv_schedule)
    integral_rate = limited_rate(gain_i * scheduled, integral, 0.0, angle_max)
    demand = min(max(integral + gain_p * scheduled, 0.0), angle_max)
    return integral_rate, min(max((demand - pitch) * inv_actuator, -rate_limit), rate_limit)


def turbine_constants(
    turbine: TurbineParameters,
    pitch: PitchParameters,
    control: GridFormingParameters,
    protection: ProtectionParameters,
) -> npt.NDArray[np.float64]:
    """Return the table of :class:`TurbineConstant` values."""
    c, cp = TurbineConstant, turbine.power_coefficient
    best = tracking_point(0.0, turbine)
    values = {
        c.C1: cp.c1,
        c.C2: cp.c2,
        c.C3: cp.c3,
        c.C5: cp.c5,
        c.C6: cp.c6,
        c.C7: cp.c7,
        c.C8: cp.c8,
        c.TIP_SPEED: turbine.tip_speed_ratio_per_speed_m_s,
        c.WIND_POWER: turbine.wind_power_pu_per_cubic_wind,
        c.INV_TWO_H_ROTOR: 0.5 / turbine.inertia_constant_s,
        c.INV_TWO_H: 0.5 / control.inertia_constant_s,
        c.DROOP_GAIN: control.droop_gain_pu,
        c.SPEED_SETPOINT: control.frequency_setpoint_pu,
        c.SPEED_MIN: control.frequency_min_pu,
        c.SPEED_MAX: control.frequency_max_pu,
        c.POWER_LIMIT: pitch.captured_power_limit_pu,
        c.ROTOR_LIMIT: pitch.rotor_speed_limit_pu,
        c.SPEED_WEIGHT: pitch.speed_weight,
        c.PITCH_KP: pitch.proportional_gain_deg,
        c.PITCH_KI: pitch.integral_gain_deg_s,
        c.INV_SCHEDULE: 1.0 / pitch.gain_schedule_deg,
        c.INV_ACTUATOR: 1.0 / pitch.actuator_time_s,
        c.PITCH_RATE: pitch.rate_limit_deg_s,
        c.PITCH_MAX: pitch.largest_angle_deg,
        c.OVERLOAD: control.overload_limit_pu,
        c.TIP_SPEED_RATIO_OPT: best.tip_speed_ratio,
        c.TIP_SPEED_RATIO_LIMIT: tracking_point(control.deloading_limit, turbine).tip_speed_ratio,
        c.AVAILABLE_PER_CUBIC_WIND: turbine.wind_power_pu_per_cubic_wind * best.power_coefficient,
        c.REACTANCE: control.reactance_pu,
        c.TWO_H: 2.0 * control.inertia_constant_s,
        c.RATED_MW: turbine.rated_power_mw,
        c.STALL_TIP_SPEED_RATIO: protection.stall_tip_speed_ratio,
        c.STALL_PITCH: protection.stall_pitch_deg,
        c.OVER_SPEED: protection.over_speed_pu,
        c.COI_MIN: protection.frequency_min_pu,
        c.COI_MAX: protection.frequency_max_pu,
        c.ANGLE_SPREAD: math.radians(protection.angle_spread_max_deg),
        c.LOW_VOLTAGE: protection.low_voltage_pu,
        c.LOW_VOLTAGE_TIME: protection.low_voltage_time_s,
    }
    return np.array([values[key] for key in TurbineConstant])
