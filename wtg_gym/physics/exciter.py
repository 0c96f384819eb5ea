"""The exciter SEXS: a lead-lag block and a first-order exciter with a non-windup limit.

    T_B ẋ = ΔV - x,    T_E Ė_fd = K (x + (T_A/T_B)(ΔV - x)) - E_fd,    ΔV = V_ref - V

Source: the standard model SEXS, as PSS/E and ANDES define it.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.machine_parameters import AnyExciter, ExciterParameters
from wtg_gym.systems.elementary import clip, limited_rate, select


class Exciter(NamedTuple):
    """Constants."""

    gain: float  # K [p.u./p.u.]; 0 without an exciter
    lead_lag_ratio: float  # T_A / T_B
    inv_lag_time: float  # 1 / T_B [1/s]
    inv_exciter_time: float  # 1 / T_E [1/s]
    field_min: float  # [p.u.]
    field_max: float


class ExciterState(NamedTuple):
    """States."""

    lead_lag: float  # x [p.u.]
    field_voltage: float  # E_fd [p.u.]


def exciter_constants(parameters: AnyExciter | None) -> Exciter:
    """Return the constants of an exciter; without one the field voltage stays, unless another model sets it."""
    if not isinstance(parameters, ExciterParameters):
        return Exciter(0.0, 0.0, 0.0, 0.0, -float("inf"), float("inf"))
    return Exciter(
        gain=parameters.gain,
        lead_lag_ratio=parameters.lead_lag_ratio,
        inv_lag_time=1.0 / parameters.lag_time_s,
        inv_exciter_time=1.0 / parameters.exciter_time_s,
        field_min=parameters.field_min_pu,
        field_max=parameters.field_max_pu,
    )


def exciter_rates(s: ExciterState, voltage_error: float, c: Exciter) -> ExciterState:
    """Return the rates [p.u./s] at a voltage error V_ref - V [p.u.]."""
    error = voltage_error - s.lead_lag
    lead = s.lead_lag + c.lead_lag_ratio * error
    field_rate = c.inv_exciter_time * (c.gain * lead - s.field_voltage)
    return ExciterState(
        lead_lag=c.inv_lag_time * error,
        field_voltage=limited_rate(field_rate, s.field_voltage, c.field_min, c.field_max),
    )


def exciter_limited(s: ExciterState, c: Exciter) -> ExciterState:
    """Return the states, held within their limits."""
    return ExciterState(s.lead_lag, clip(s.field_voltage, c.field_min, c.field_max))


def exciter_start(field_voltage: float, c: Exciter) -> tuple[ExciterState, float]:
    """Return the equilibrium that gives a field voltage [p.u.], and the voltage error that it needs [p.u.]."""
    error = select(c.gain > 0.0, field_voltage / c.gain, 0.0)
    return ExciterState(error, field_voltage), error
