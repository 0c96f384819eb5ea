"""The power system stabiliser IEEEST on the speed deviation: a filter, two lead-lags, a washout, limits.

    V_s = (1 + A_5 s + A_6 s²) / ((1 + A_1 s + A_2 s²)(1 + A_3 s + A_4 s²))
          · (1 + sT_1)/(1 + sT_2) · (1 + sT_3)/(1 + sT_4) · K_S sT_5/(1 + sT_6) · (ω - 1),  within L_Smin … L_Smax

With T_5 = 0 the washout is a lag of T_6. Where the terminal voltage is not between V_CL and V_CU there is no signal.

Source: the standard model IEEEST of PSS/E, after IEEE Std 421.5 (PSS1A), as ANDES defines it. Unlike ANDES, which takes
the second part of the filter away where A_4 is 0, the numerator keeps its effect then.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants, inverse, lag, lead_lag
from wtg_gym.physics.control_parameters import FilterStabiliserParameters
from wtg_gym.physics.machine_controls import stabiliser
from wtg_gym.systems.elementary import clip, select


class Denominator(NamedTuple):
    """1 + A s + B s²."""

    linear: float  # A [s]
    inv_linear: float  # 1/A where B is 0 [1/s]; 0 for no denominator, or one of the second degree
    inv_square: float  # 1/B [1/s²]; 0 for one of the first degree, or none


class IeeestState(NamedTuple):
    """States."""

    slope_1: float  # rate of the next [p.u./s]
    filter_1: float  # [p.u.]
    slope_2: float
    filter_2: float
    lead_lag_1: float
    lead_lag_2: float
    washout: float


def _denominator(linear: float, square: float) -> Denominator:
    return Denominator(linear, 0.0 if square else inverse(linear), inverse(square))


def _besides(p: FilterStabiliserParameters) -> dict[str, Any]:
    return {
        "first": _denominator(p.filter_a1_s, p.filter_a2_s2),
        "second": _denominator(p.filter_a3_s, p.filter_a4_s2),
        "voltage_min": p.voltage_min_pu or -math.inf,
        "voltage_max": p.voltage_max_pu or math.inf,
    }


def _divided(
    slope: float, state: float, given: float, given_rate: float, given_slope_rate: float, c: Denominator
) -> tuple[float, float, float]:
    """Return what divides a signal by 1 + A s + B s²: the rates of both states, and the output.

    Without a denominator the rates are those of the signal itself, as far as they are known.
    """
    exists = (c.inv_linear > 0.0) | (c.inv_square > 0.0)
    slope_rate = c.inv_square * (given - state - c.linear * slope)
    rate = select(c.inv_square > 0.0, slope, c.inv_linear * (given - state))
    return (
        select(exists, slope_rate, given_slope_rate),
        select(exists, rate, given_rate),
        select(exists, state, given),
    )


def ieeest_rates(s: IeeestState, deviation: float, voltage: float, c: Any) -> tuple[IeeestState, float]:
    """Return the rates and the signal [p.u.] at a speed deviation ω - 1 and a terminal voltage [p.u.]."""
    slope_1, filter_1, once = _divided(s.slope_1, s.filter_1, deviation, 0.0, 0.0, c.first)
    slope_2, filter_2, twice = _divided(s.slope_2, s.filter_2, once, filter_1, slope_1, c.second)
    filtered = twice + c.filter_a5_s * filter_2 + c.filter_a6_s2 * slope_2
    first, led = lead_lag(s.lead_lag_1, filtered, c.lead_time_1_s, c.inv_lag_time_1)
    second, led = lead_lag(s.lead_lag_2, led, c.lead_time_2_s, c.inv_lag_time_2)
    washout, slow = lag(s.washout, c.gain * led, c.inv_washout_time)
    washed = select(c.washout_gain_s > 0.0, c.washout_gain_s * washout, slow)
    acts = (c.voltage_min < voltage) & (voltage < c.voltage_max)
    rates = IeeestState(slope_1, filter_1, slope_2, filter_2, first, second, washout)
    return rates, select(acts, clip(washed, c.signal_min_pu, c.signal_max_pu), 0.0)


def ieeest_start(deviation: float, c: Any) -> IeeestState:
    """Return the equilibrium at a constant speed deviation [p.u.]."""
    return IeeestState(0.0, deviation, 0.0, deviation, deviation, deviation, c.gain * deviation)


IEEEST = stabiliser(Constants(FilterStabiliserParameters, besides=_besides), IeeestState, ieeest_rates, ieeest_start)
