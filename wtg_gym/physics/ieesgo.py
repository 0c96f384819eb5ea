"""The governor IEESGO with its steam turbine: a lag, a lead-lag, a limit, three stages of steam.

    T_1 ẋ = Δω/R - x,    T_3 ż = x - z,    y = z + (T_2/T_3)(x - z)
    T_4 ṡ_1 = clip(g_ref - y, P_min, P_max) - s_1,    T_5 ṡ_2 = s_1 - s_2,    T_6 ṡ_3 = s_2 - s_3
    T_m = (1 - K_2) s_1 + K_2 (1 - K_3) s_2 + K_2 K_3 s_3

Δω is the speed's deviation ω - 1 beyond the dead band, and 1/R is K_1. A lost governor keeps what its inlet gives, s_1.
Source: the standard model IEESGO of PSS/E, as ANDES defines it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants, lag, lead_lag
from wtg_gym.physics.control_parameters import ReheatGovernorParameters
from wtg_gym.physics.governor import beyond_dead_band
from wtg_gym.physics.machine_controls import governor
from wtg_gym.systems.elementary import clip, select


class IeesgoState(NamedTuple):
    """States."""

    controlling: float  # x [p.u.]
    governing: float  # z [p.u.]
    valve: float  # s_1 [p.u.]
    reheated: float  # s_2 [p.u.]
    crossed: float  # s_3 [p.u.]


def ieesgo_rates(s: IeesgoState, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[IeesgoState, float]:
    """Return the rates and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use."""
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = inv_droop * beyond_dead_band(speed - 1.0, c.dead_band_pu)
    controlling, lagged = lag(s.controlling, demand, c.inv_lag_time)
    governing, led = lead_lag(s.governing, lagged, c.lead_time_s, c.inv_governor_time)
    valve, steam = lag(s.valve, clip(reference - led, c.gate_min_pu, c.gate_max_pu), c.inv_inlet_time)
    reheating, reheated = lag(s.reheated, steam, c.inv_reheat_time)
    crossing, crossed = lag(s.crossed, reheated, c.inv_crossover_time)
    rates = IeesgoState(acts * controlling, acts * governing, acts * valve, reheating, crossing)
    behind = reheated + c.fraction_3 * (crossed - reheated)
    return rates, steam + c.fraction_2 * (behind - steam)


def ieesgo_start(torque: float, c: Any) -> IeesgoState:
    """Return the equilibrium at a torque [p.u.]."""
    return IeesgoState(0.0, 0.0, torque, torque, torque)


IEESGO = governor(Constants(ReheatGovernorParameters), IeesgoState, ieesgo_rates, ieesgo_start)
