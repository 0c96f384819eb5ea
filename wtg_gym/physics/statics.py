"""Where a strategy has an equilibrium: the static side of primary frequency regulation."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.scenario import WIND_SPEED_RANGE, require_range
from wtg_gym.physics.tracking_law import TrackingLaw, tracking_coefficient


def power_margin_pu(
    frequency_pu: float,
    law: TrackingLaw,
    wind_m_s: float,
    turbine: TurbineParameters | None = None,
    control: GridFormingParameters | None = None,
) -> float:
    """Return how much more than the law demands a rotor could capture in steady state, at best over its speed [p.u.].

    max over ω_m of p_w(ω_m) - g(ω) ω_m³ - D_p (ω_st - ω), the last term only where the law keeps its droop (τ = ∞).
    Negative: there is no equilibrium. Blades at fine pitch. Source: paper, section on MPPT.

    Args:
        frequency_pu: grid frequency ω [p.u.].
        law: the strategy.
        wind_m_s: wind speed [m/s].
        turbine, control: parameters; the paper's by default.
    """
    turbine, control = turbine or TurbineParameters(), control or GridFormingParameters()
    k = tracking_coefficient(
        frequency_pu,
        law.k_min,
        law.k_nominal,
        law.k_max,
        control.frequency_min_pu,
        control.frequency_setpoint_pu,
        control.frequency_max_pu,
    )
    in_wind = turbine.wind_power_pu_per_cubic_wind * wind_m_s**3
    scale = wind_m_s / turbine.tip_speed_ratio_per_speed_m_s

    def shortfall(ratio: float) -> float:
        captured = in_wind * float(power_coefficient(ratio, 0.0, turbine.power_coefficient))
        return float(k * (scale * ratio) ** 3 - captured)

    # The difference has one maximum, on the way from stall to over-speed; a coarse look brackets it.
    ratios = np.linspace(2.0, 12.0, 41)
    nearest = float(ratios[np.argmin([shortfall(r) for r in ratios])])
    best = minimize_scalar(
        shortfall, bounds=(nearest - 0.25, nearest + 0.25), method="bounded", options={"xatol": 1e-9}
    )
    droop = control.droop_gain_pu if math.isinf(law.damping_time_constant_s) else 0.0
    return -float(best.fun) - droop * (control.frequency_setpoint_pu - frequency_pu)


def critical_frequency_pu(
    law: TrackingLaw,
    wind_m_s: float,
    turbine: TurbineParameters | None = None,
    control: GridFormingParameters | None = None,
    *,
    lowest_pu: float = 0.9,
) -> float | None:
    """Return the frequency below which a strategy has no equilibrium at a wind speed [p.u.].

    Args:
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 m/s [m/s].
        turbine, control: parameters; the paper's by default.
        lowest_pu: lowest frequency looked at [p.u.].

    Returns:
        the critical frequency, or None where there is an equilibrium down to `lowest_pu`.

    Raises:
        ValueError: the wind is out of range, or there is no equilibrium at nominal frequency either.
    """
    require_range("wind", wind_m_s, *WIND_SPEED_RANGE, "m/s")
    control = control or GridFormingParameters()

    def margin(frequency: float) -> float:
        return power_margin_pu(frequency, law, wind_m_s, turbine, control)

    nominal = control.frequency_setpoint_pu
    if margin(nominal) < 0.0:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s even at nominal frequency")
    if margin(lowest_pu) >= 0.0:
        return None
    return float(brentq(margin, lowest_pu, nominal, xtol=1e-12))
