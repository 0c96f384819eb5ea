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

from typing import NamedTuple

from wtg_gym.physics.control_blocks import inverse, lag, lead_lag
from wtg_gym.physics.control_parameters import BoilerGovernorParameters
from wtg_gym.physics.governor import beyond_dead_band
from wtg_gym.physics.machine_controls import governor
from wtg_gym.systems.elementary import clip, limited_rate, select


class Ieeeg1(NamedTuple):
    """Constants, on the base of the machine."""

    machine: int  # whose governor it is
    lead_time: float  # T_2 [s]
    inv_lag_time: float  # 1/T_1 [1/s]
    inv_valve_time: float  # 1/T_3 [1/s]
    closing_rate: float  # U_c [p.u./s]
    opening_rate: float  # U_o [p.u./s]
    gate_min: float  # P_min [p.u.]
    gate_max: float  # P_max [p.u.]
    inv_pass_time_1: float  # 1/T_4 [1/s]
    inv_pass_time_2: float  # 1/T_5
    inv_pass_time_3: float  # 1/T_6
    inv_pass_time_4: float  # 1/T_7
    fraction_1: float  # K_1
    fraction_2: float  # K_3
    fraction_3: float  # K_5
    fraction_4: float  # K_7
    dead_band: float  # [p.u.]


class Ieeeg1State(NamedTuple):
    """States."""

    governing: float  # x [p.u.]
    valve: float  # g [p.u.]
    steam_1: float  # s_1 [p.u.]
    steam_2: float
    steam_3: float
    steam_4: float


def ieeeg1_constants(machine: int, p: BoilerGovernorParameters) -> Ieeeg1:
    """Return the constants of the governor of a machine, given by its index."""
    return Ieeeg1(
        machine=machine,
        lead_time=p.lead_time_s,
        inv_lag_time=inverse(p.lag_time_s),
        inv_valve_time=1.0 / p.valve_time_s,
        closing_rate=p.closing_rate_pu_s,
        opening_rate=p.opening_rate_pu_s,
        gate_min=p.gate_min_pu,
        gate_max=p.gate_max_pu,
        inv_pass_time_1=inverse(p.pass_time_1_s),
        inv_pass_time_2=inverse(p.pass_time_2_s),
        inv_pass_time_3=inverse(p.pass_time_3_s),
        inv_pass_time_4=inverse(p.pass_time_4_s),
        fraction_1=p.fraction_1,
        fraction_2=p.fraction_2,
        fraction_3=p.fraction_3,
        fraction_4=p.fraction_4,
        dead_band=p.dead_band_pu,
    )


def ieeeg1_rates(
    s: Ieeeg1State, speed: float, reference: float, inv_droop: float, c: Ieeeg1
) -> tuple[Ieeeg1State, float]:
    """Return the rates and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use."""
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = inv_droop * beyond_dead_band(speed - 1.0, c.dead_band)
    governing, led = lead_lag(s.governing, demand, c.lead_time, c.inv_lag_time)
    wanted = clip(c.inv_valve_time * (reference - led - s.valve), c.closing_rate, c.opening_rate)
    held = clip(s.valve, c.gate_min, c.gate_max)
    steam_1, after_1 = lag(s.steam_1, held, c.inv_pass_time_1)
    steam_2, after_2 = lag(s.steam_2, after_1, c.inv_pass_time_2)
    steam_3, after_3 = lag(s.steam_3, after_2, c.inv_pass_time_3)
    steam_4, after_4 = lag(s.steam_4, after_3, c.inv_pass_time_4)
    rates = Ieeeg1State(
        acts * governing,
        acts * limited_rate(wanted, s.valve, c.gate_min, c.gate_max),
        steam_1,
        steam_2,
        steam_3,
        steam_4,
    )
    torque = c.fraction_1 * after_1 + c.fraction_2 * after_2 + c.fraction_3 * after_3 + c.fraction_4 * after_4
    return rates, torque


def ieeeg1_limited(s: Ieeeg1State, c: Ieeeg1) -> Ieeeg1State:
    """Return the states, held within their limits."""
    return s._replace(valve=clip(s.valve, c.gate_min, c.gate_max))


def ieeeg1_start(torque: float, c: Ieeeg1) -> Ieeeg1State:
    """Return the equilibrium at a torque [p.u.]."""
    valve = torque / (c.fraction_1 + c.fraction_2 + c.fraction_3 + c.fraction_4)
    return Ieeeg1State(0.0, valve, valve, valve, valve, valve)


def _limits(c: Ieeeg1) -> tuple[float, float]:
    return c.gate_min, c.gate_max


IEEEG1 = governor(
    "governors IEEEG1",
    Ieeeg1State,
    Ieeeg1,
    ieeeg1_constants,
    ieeeg1_rates,
    ieeeg1_limited,
    ieeeg1_start,
    _limits,
)
