"""The governor GAST with its gas turbine: a valve with limits, combustion, a limit of the exhaust temperature.

    T_1 ġ = min(g_ref - Δω/R, A_T + K_T (A_T - θ)) - g  with non-windup limits V_min … V_max
    T_2 ċ = g - c,    T_3 θ̇ = c - θ,    T_m = c - D_t (ω - 1)

Δω is the speed's deviation ω - 1 beyond the dead band. Source: the standard model GAST of PSS/E, as ANDES defines it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants, lag
from wtg_gym.physics.control_parameters import GasGovernorParameters
from wtg_gym.physics.governor import beyond_dead_band
from wtg_gym.physics.machine_controls import governor
from wtg_gym.systems.elementary import clip, limited_rate, select


class GastState(NamedTuple):
    """States."""

    valve: float  # g [p.u.]
    combustion: float  # c [p.u.]
    exhaust: float  # θ [p.u.]


def gast_rates(s: GastState, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[GastState, float]:
    """Return the rates and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use."""
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = reference - inv_droop * beyond_dead_band(speed - 1.0, c.dead_band_pu)
    allowed = c.load_limit_pu + c.temperature_gain * (c.load_limit_pu - s.exhaust)
    wanted = c.inv_valve_time * (min(demand, allowed) - s.valve)
    valve = limited_rate(wanted, s.valve, c.gate_min_pu, c.gate_max_pu)
    combusting, burnt = lag(s.combustion, clip(s.valve, c.gate_min_pu, c.gate_max_pu), c.inv_turbine_time)
    rates = GastState(acts * valve, combusting, c.inv_exhaust_time * (burnt - s.exhaust))
    return rates, burnt - c.turbine_damping_pu * (speed - 1.0)


def gast_start(torque: float, c: Any) -> GastState:
    """Return the equilibrium at a torque [p.u.]."""
    return GastState(torque, torque, torque)


GAST = governor(Constants(GasGovernorParameters), GastState, gast_rates, gast_start)
