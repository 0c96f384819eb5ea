"""The power system stabiliser STAB1: a washout of the speed deviation, two lead-lags, a limit.

    V_s = K · sT/(1 + sT) · (1 + sT_1)/(1 + sT_3) · (1 + sT_2)/(1 + sT_4) · (ω - 1),  within ±H_lim

Source: the standard model STAB1 of PSS/E, whose data hold K/T in place of K.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants, lag, lead_lag
from wtg_gym.physics.control_parameters import SpeedStabiliserParameters
from wtg_gym.physics.machine_controls import stabiliser
from wtg_gym.systems.elementary import clip


class Stab1State(NamedTuple):
    """States."""

    washout: float  # [p.u.]
    lead_lag_1: float
    lead_lag_2: float


def stab1_rates(s: Stab1State, deviation: float, voltage: float, c: Any) -> tuple[Stab1State, float]:
    """Return the rates and the signal [p.u.] at a speed deviation ω - 1 [p.u.]; the voltage does not count."""
    washout, slow = lag(s.washout, deviation, c.inv_washout_time)
    first, led = lead_lag(s.lead_lag_1, c.gain * (deviation - slow), c.lead_time_1_s, c.inv_lag_time_1)
    second, signal = lead_lag(s.lead_lag_2, led, c.lead_time_2_s, c.inv_lag_time_2)
    return Stab1State(washout, first, second), clip(signal, -c.signal_limit_pu, c.signal_limit_pu)


def stab1_start(deviation: float, c: Any) -> Stab1State:
    """Return the equilibrium at a constant speed deviation [p.u.], which gives no signal."""
    return Stab1State(deviation, 0.0, 0.0)


STAB1 = stabiliser(Constants(SpeedStabiliserParameters), Stab1State, stab1_rates, stab1_start)
