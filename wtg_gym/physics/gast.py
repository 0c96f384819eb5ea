"""The governor GAST with its gas turbine: a valve with limits, combustion, a limit of the exhaust temperature.

    T_1 ġ = min(g_ref - Δω/R, A_T + K_T (A_T - θ)) - g  with non-windup limits V_min … V_max
    T_2 ċ = g - c,    T_3 θ̇ = c - θ,    T_m = c - D_t (ω - 1)

Δω is the speed's deviation ω - 1 beyond the dead band. Source: the standard model GAST of PSS/E, as ANDES defines it.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.control_blocks import inverse, lag
from wtg_gym.physics.control_parameters import GasGovernorParameters
from wtg_gym.physics.governor import beyond_dead_band
from wtg_gym.physics.machine_controls import governor
from wtg_gym.systems.elementary import clip, limited_rate, select


class Gast(NamedTuple):
    """Constants, on the base of the machine."""

    machine: int  # whose governor it is
    inv_valve_time: float  # 1/T_1 [1/s]
    inv_turbine_time: float  # 1/T_2 [1/s]
    inv_exhaust_time: float  # 1/T_3 [1/s]
    load_limit: float  # A_T [p.u.]
    temperature_gain: float  # K_T [p.u./p.u.]
    gate_min: float  # V_min [p.u.]
    gate_max: float  # V_max [p.u.]
    turbine_damping: float  # D_t [p.u./p.u.]
    dead_band: float  # [p.u.]


class GastState(NamedTuple):
    """States."""

    valve: float  # g [p.u.]
    combustion: float  # c [p.u.]
    exhaust: float  # θ [p.u.]


def gast_constants(machine: int, p: GasGovernorParameters) -> Gast:
    """Return the constants of the governor of a machine, given by its index."""
    return Gast(
        machine=machine,
        inv_valve_time=1.0 / p.valve_time_s,
        inv_turbine_time=inverse(p.turbine_time_s),
        inv_exhaust_time=1.0 / p.exhaust_time_s,
        load_limit=p.load_limit_pu,
        temperature_gain=p.temperature_gain,
        gate_min=p.gate_min_pu,
        gate_max=p.gate_max_pu,
        turbine_damping=p.turbine_damping_pu,
        dead_band=p.dead_band_pu,
    )


def gast_rates(s: GastState, speed: float, reference: float, inv_droop: float, c: Gast) -> tuple[GastState, float]:
    """Return the rates and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use."""
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = reference - inv_droop * beyond_dead_band(speed - 1.0, c.dead_band)
    allowed = c.load_limit + c.temperature_gain * (c.load_limit - s.exhaust)
    valve = c.inv_valve_time * (min(demand, allowed) - s.valve)
    combusting, burnt = lag(s.combustion, clip(s.valve, c.gate_min, c.gate_max), c.inv_turbine_time)
    rates = GastState(
        valve=acts * limited_rate(valve, s.valve, c.gate_min, c.gate_max),
        combustion=combusting,
        exhaust=c.inv_exhaust_time * (burnt - s.exhaust),
    )
    return rates, burnt - c.turbine_damping * (speed - 1.0)


def gast_limited(s: GastState, c: Gast) -> GastState:
    """Return the states, held within their limits."""
    return s._replace(valve=clip(s.valve, c.gate_min, c.gate_max))


def gast_start(torque: float, c: Gast) -> GastState:
    """Return the equilibrium at a torque [p.u.]."""
    return GastState(torque, torque, torque)


def _limits(c: Gast) -> tuple[float, float]:
    # At rest the temperature allows as much as the ambient one.
    return c.gate_min, min(c.gate_max, c.load_limit)


GAST = governor("governors GAST", GastState, Gast, gast_constants, gast_rates, gast_limited, gast_start, _limits)
