"""The governor IEEEG1 with its steam turbine on one shaft: a lead-lag, a valve with limits, four passes of steam.

    T_1 ẋ = Δω/R - x,    y = x + (T_2/T_1)(Δω/R - x)
    ġ = (g_ref - y - g)/T_3  with U_c ≤ ġ ≤ U_o and non-windup limits P_min … P_max
    T_4 ṡ_1 = g - s_1,    T_5 ṡ_2 = s_1 - s_2,    T_6 ṡ_3 = s_2 - s_3,    T_7 ṡ_4 = s_3 - s_4
    T_m = K_1 s_1 + K_3 s_2 + K_5 s_3 + K_7 s_4

Δω is the speed's deviation ω - 1 beyond the dead band, and 1/R is K. Source: IEEE Committee Report: Dynamic Models for
Steam and Hydro Turbines in Power System Studies, 1973, and the standard model IEEEG1 of PSS/E. ANDES divides the shares
K by their sum; here they count as they are, which is the same where they add up to 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants, lag, lead_lag
from wtg_gym.physics.control_parameters import BoilerGovernorParameters
from wtg_gym.physics.governor import beyond_dead_band
from wtg_gym.physics.machine_controls import governor
from wtg_gym.systems.elementary import clip, limited_rate, select


class Ieeeg1State(NamedTuple):
    """States."""

    governing: float  # x [p.u.]
    valve: float  # g [p.u.]
    steam_1: float  # s_1 [p.u.]
    steam_2: float
    steam_3: float
    steam_4: float


def ieeeg1_rates(s: Ieeeg1State, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[Ieeeg1State, float]:
    """Return the rates and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use."""
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = inv_droop * beyond_dead_band(speed - 1.0, c.dead_band_pu)
    governing, led = lead_lag(s.governing, demand, c.lead_time_s, c.inv_lag_time)
    wanted = clip(c.inv_valve_time * (reference - led - s.valve), c.closing_rate_pu_s, c.opening_rate_pu_s)
    valve = limited_rate(wanted, s.valve, c.gate_min_pu, c.gate_max_pu)
    steam_1, after_1 = lag(s.steam_1, clip(s.valve, c.gate_min_pu, c.gate_max_pu), c.inv_pass_time_1)
    steam_2, after_2 = lag(s.steam_2, after_1, c.inv_pass_time_2)
    steam_3, after_3 = lag(s.steam_3, after_2, c.inv_pass_time_3)
    steam_4, after_4 = lag(s.steam_4, after_3, c.inv_pass_time_4)
    rates = Ieeeg1State(acts * governing, acts * valve, steam_1, steam_2, steam_3, steam_4)
    torque = c.fraction_1 * after_1 + c.fraction_2 * after_2 + c.fraction_3 * after_3 + c.fraction_4 * after_4
    return rates, torque


def ieeeg1_start(torque: float, c: Any) -> Ieeeg1State:
    """Return the equilibrium at a torque [p.u.]."""
    valve = torque / (c.fraction_1 + c.fraction_2 + c.fraction_3 + c.fraction_4)
    return Ieeeg1State(0.0, valve, valve, valve, valve, valve)


IEEEG1 = governor(Constants(BoilerGovernorParameters), Ieeeg1State, ieeeg1_rates, ieeeg1_start)
