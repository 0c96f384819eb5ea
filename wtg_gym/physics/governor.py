"""Governors with their turbines: steam (TGOV1) and hydro (HYGOV).

TGOV1, a droop, a gate with non-windup limits, a reheater:

    T_1 ġ = g_ref - Δω/R - g,    T_3 ẋ = g - x,    T_m = x + (T_2/T_3)(g - x) - D_t (ω - 1)

Δω is the speed's deviation ω - 1 beyond the dead band. Source: the standard model TGOV1; the output is taken as torque,
as in ANDES, and the reference counts in gate units.

HYGOV, permanent and temporary droop, gate servo, inelastic water:

    T_f ė = R (g_ref - c) - Δω - e,    ċ = e/(r T_r) + ė/r with |ċ| ≤ v_max and non-windup limits,    T_g ġ = c - g
    T_w q̇ = 1 - h,    h = (q/g)²,    T_m = A_t h (q - q_nl) - D_t g (ω - 1)

Source: HYGOV of PSS/E, as ANDES defines it; P. Kundur: Power System Stability and Control, section 9.1.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants
from wtg_gym.physics.machine_parameters import AnyGovernor, GovernorParameters, HydroGovernorParameters
from wtg_gym.systems.elementary import clip, limited_rate, select

#: The gate is kept this far open in h = (q/g)² [p.u.].
_LEAST_GATE = 0.01


class Governor(NamedTuple):
    """Constants, on the base of the machine."""

    inv_droop: float  # 1/R of the case [p.u./p.u.], 0 without a governor; a scenario may replace it, see MachineInput
    inv_gate_time: float  # 1 / T_1 [1/s]
    lead_reheat_ratio: float  # T_2 / T_3
    inv_reheat_time: float  # 1 / T_3 [1/s]
    gate_min: float  # [p.u.]; of a governor that is a unit of its own, of its reference
    gate_max: float
    turbine_damping: float  # D_t [p.u./p.u.]
    dead_band: float  # [p.u.]
    is_unit: float  # 1 where the torque is that of a governor that is a unit of its own


class GovernorState(NamedTuple):
    """States."""

    gate: float  # g [p.u.]
    reheat: float  # x [p.u.]


def gate_limits(p: Any) -> tuple[float, float]:
    """Return the limits of a gate at rest [p.u.], from parameters or constants."""
    # Of a gas turbine the temperature allows as much as the ambient one.
    return p.gate_min_pu, min(p.gate_max_pu, getattr(p, "load_limit_pu", math.inf))


def governor_constants(parameters: AnyGovernor | None) -> Governor:
    """Return the constants of a governor; without one, or with one that is a unit of its own, its gate stands still."""
    if not isinstance(parameters, GovernorParameters):
        inv_droop, is_unit = (0.0, 0.0) if parameters is None else (1.0 / parameters.droop_pu, 1.0)
        limits = (-math.inf, math.inf) if parameters is None else gate_limits(parameters)
        return Governor(inv_droop, 0.0, 0.0, 0.0, *limits, 0.0, 0.0, is_unit)
    return Governor(
        inv_droop=1.0 / parameters.droop_pu,
        inv_gate_time=1.0 / parameters.gate_time_s,
        lead_reheat_ratio=parameters.lead_time_s / parameters.reheat_time_s,
        inv_reheat_time=1.0 / parameters.reheat_time_s,
        gate_min=parameters.gate_min_pu,
        gate_max=parameters.gate_max_pu,
        turbine_damping=parameters.turbine_damping_pu,
        dead_band=parameters.dead_band_pu,
        is_unit=0.0,
    )


def beyond_dead_band(deviation: float, dead_band: float) -> float:
    """Return how far a deviation lies beyond a dead band, without a step at its edge."""
    # Its slope without a dead band is 1 everywhere, at a deviation of exactly zero too.
    edge = select(deviation < 0.0, -dead_band, dead_band)
    return select(abs(deviation) < dead_band, 0.0, deviation - edge)


def governor_rates(
    s: GovernorState, speed: float, reference: float, inv_droop: float, c: Governor
) -> tuple[GovernorState, float]:
    """Return the rates [p.u./s] and the torque [p.u.]; speed ω [p.u.], reference of the gate [p.u.], 1/R in use."""
    demand = reference - inv_droop * beyond_dead_band(speed - 1.0, c.dead_band)
    held = clip(s.gate, c.gate_min, c.gate_max)
    rates = GovernorState(
        gate=limited_rate(c.inv_gate_time * (demand - s.gate), s.gate, c.gate_min, c.gate_max),
        reheat=c.inv_reheat_time * (held - s.reheat),
    )
    return rates, s.reheat + c.lead_reheat_ratio * (held - s.reheat) - c.turbine_damping * (speed - 1.0)


def governor_limited(s: GovernorState, c: Governor) -> GovernorState:
    """Return the states, held within their limits."""
    return GovernorState(clip(s.gate, c.gate_min, c.gate_max), s.reheat)


class HydroState(NamedTuple):
    """States."""

    speed_error: float  # e [p.u.]
    gate_order: float  # c [p.u.]
    hydro_gate: float  # g [p.u.]
    flow: float  # q [p.u.]


hydro_constants = Constants(
    HydroGovernorParameters, besides=lambda p: {"inv_temporary_droop": 1.0 / p.temporary_droop_pu}
)


def hydro_rates(s: HydroState, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[HydroState, float]:
    """Return the rates [p.u./s] and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use.

    Without a droop the governor is lost: it and its gate stand still.
    """
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    deviation = beyond_dead_band(speed - 1.0, c.dead_band_pu)
    permanent = (reference - s.gate_order) / max(inv_droop, 1e-6)
    error_rate = c.inv_filter_time * (permanent - deviation - s.speed_error)
    wanted = c.inv_temporary_droop * (c.inv_reset_time * s.speed_error + error_rate)
    order_rate = clip(wanted, -c.gate_rate_limit_pu_s, c.gate_rate_limit_pu_s)
    ratio = s.flow / max(s.hydro_gate, _LEAST_GATE)
    head = ratio * ratio
    rates = HydroState(
        speed_error=acts * error_rate,
        gate_order=acts * limited_rate(order_rate, s.gate_order, c.gate_min_pu, c.gate_max_pu),
        hydro_gate=acts * c.inv_gate_time * (s.gate_order - s.hydro_gate),
        flow=c.inv_water_time * (1.0 - head),
    )
    torque = c.turbine_gain * head * (s.flow - c.no_load_flow_pu) - c.turbine_damping_pu * s.hydro_gate * (speed - 1.0)
    return rates, torque


def hydro_limited(s: HydroState, c: Any) -> HydroState:
    """Return the states, held within their limits."""
    return HydroState(s.speed_error, clip(s.gate_order, c.gate_min_pu, c.gate_max_pu), s.hydro_gate, s.flow)


def hydro_start(torque: float, c: Any) -> HydroState:
    """Return the equilibrium at a torque [p.u.]; its gate is g_ref."""
    gate = torque / c.turbine_gain + c.no_load_flow_pu
    return HydroState(0.0, gate, gate, gate)
