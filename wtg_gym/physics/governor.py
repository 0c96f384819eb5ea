"""The governor and steam turbine TGOV1: droop, a gate with non-windup limits, a reheater.

    T_1 ġ = g_ref - Δω/R - g,    T_3 ẋ = g - x,    T_m = x + (T_2/T_3)(g - x) - D_t (ω - 1)

Δω is the speed's deviation ω - 1 beyond the dead band. Source: the standard model TGOV1; the
output is taken as torque, as in ANDES, and the reference counts in gate units.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.elementary import clip, limited_rate, select
from wtg_gym.physics.machine_parameters import GovernorParameters, HydroGovernorParameters


class Governor(NamedTuple):
    """Constants, on the base of the machine."""

    inv_droop: float  # 1/R of the case [p.u./p.u.], 0 without a governor; a scenario may replace it, see MachineInput
    inv_gate_time: float  # 1 / T_1 [1/s]
    lead_reheat_ratio: float  # T_2 / T_3
    inv_reheat_time: float  # 1 / T_3 [1/s]
    gate_min: float  # [p.u.]
    gate_max: float
    turbine_damping: float  # D_t [p.u./p.u.]
    dead_band: float  # [p.u.]
    is_hydro: float  # 1 where the torque is that of a hydro governor instead


class GovernorState(NamedTuple):
    """States."""

    gate: float  # g [p.u.]
    reheat: float  # x [p.u.]


def governor_constants(parameters: GovernorParameters | HydroGovernorParameters | None) -> Governor:
    """Return the constants of a governor; without one, or with one of another type, the torque is constant."""
    if not isinstance(parameters, GovernorParameters):
        inv_droop = 0.0 if parameters is None else 1.0 / parameters.droop_pu
        return Governor(inv_droop, 0.0, 0.0, 0.0, -float("inf"), float("inf"), 0.0, 0.0, float(parameters is not None))
    return Governor(
        inv_droop=1.0 / parameters.droop_pu,
        inv_gate_time=1.0 / parameters.gate_time_s,
        lead_reheat_ratio=parameters.lead_time_s / parameters.reheat_time_s,
        inv_reheat_time=1.0 / parameters.reheat_time_s,
        gate_min=parameters.gate_min_pu,
        gate_max=parameters.gate_max_pu,
        turbine_damping=parameters.turbine_damping_pu,
        dead_band=parameters.dead_band_pu,
        is_hydro=0.0,
    )


@inlined
def beyond_dead_band(deviation: float, dead_band: float) -> float:
    """Return how far a deviation lies beyond a dead band, without a step at its edge."""
    # Its slope without a dead band is 1 everywhere, at a deviation of exactly zero too.
    edge = select(deviation < 0.0, -dead_band, dead_band)
    return select(abs(deviation) < dead_band, 0.0, deviation - edge)


@inlined
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


@inlined
def governor_limited(s: GovernorState, c: Governor) -> GovernorState:
    """Return the states, held within their limits."""
    return GovernorState(clip(s.gate, c.gate_min, c.gate_max), s.reheat)
