"""The power system stabiliser STAB1: a washout of the speed deviation, two lead-lags, a limit.

    V_s = K · sT/(1 + sT) · (1 + sT_1)/(1 + sT_3) · (1 + sT_2)/(1 + sT_4) · (ω - 1),  within ±H_lim

Source: the standard model STAB1 of PSS/E, whose data hold K/T in place of K.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.control_blocks import inverse, lag, lead_lag
from wtg_gym.physics.control_parameters import SpeedStabiliserParameters
from wtg_gym.physics.machine_controls import stabiliser
from wtg_gym.systems.elementary import clip


class Stab1(NamedTuple):
    """Constants."""

    machine: int  # whose stabiliser it is
    gain: float  # K [p.u./p.u.]
    inv_washout_time: float  # 1/T [1/s]
    lead_time_1: float  # T_1 [s]
    inv_lag_time_1: float  # 1/T_3 [1/s]
    lead_time_2: float  # T_2 [s]
    inv_lag_time_2: float  # 1/T_4 [1/s]
    limit: float  # H_lim [p.u.]


class Stab1State(NamedTuple):
    """States."""

    washout: float  # [p.u.]
    lead_lag_1: float
    lead_lag_2: float


def stab1_constants(machine: int, p: SpeedStabiliserParameters) -> Stab1:
    """Return the constants of the stabiliser of a machine, given by its index."""
    return Stab1(
        machine=machine,
        gain=p.gain,
        inv_washout_time=inverse(p.washout_time_s),
        lead_time_1=p.lead_time_1_s,
        inv_lag_time_1=inverse(p.lag_time_1_s),
        lead_time_2=p.lead_time_2_s,
        inv_lag_time_2=inverse(p.lag_time_2_s),
        limit=p.signal_limit_pu,
    )


def stab1_rates(s: Stab1State, deviation: float, voltage: float, c: Stab1) -> tuple[Stab1State, float]:
    """Return the rates and the signal [p.u.] at a speed deviation ω - 1 [p.u.]; the voltage does not count."""
    washout, slow = lag(s.washout, deviation, c.inv_washout_time)
    first, led = lead_lag(s.lead_lag_1, c.gain * (deviation - slow), c.lead_time_1, c.inv_lag_time_1)
    second, signal = lead_lag(s.lead_lag_2, led, c.lead_time_2, c.inv_lag_time_2)
    return Stab1State(washout, first, second), clip(signal, -c.limit, c.limit)


def stab1_start(deviation: float, c: Stab1) -> Stab1State:
    """Return the equilibrium at a constant speed deviation [p.u.], which gives no signal."""
    return Stab1State(deviation, 0.0, 0.0)


STAB1 = stabiliser("stabilisers STAB1", Stab1State, Stab1, stab1_constants, stab1_rates, stab1_start)
