"""Blocks that controls are made of.

Each takes its state, its input and its constants, and returns the rate of the state and its output. Where the inverse
of a time constant is 0 the block is none: its state stands still, and its output is its input.
"""

from __future__ import annotations

from wtg_gym.systems.elementary import clip, limited_rate, select


def inverse(time_s: float) -> float:
    """Return 1/T of a time constant [1/s], 0 for none."""
    return 1.0 / time_s if time_s > 0.0 else 0.0


def lag(state: float, given: float, inv_time: float) -> tuple[float, float]:
    """Return rate and output of 1/(1 + s T)."""
    return inv_time * (given - state), select(inv_time > 0.0, state, given)


def lead_lag(state: float, given: float, lead_time: float, inv_lag_time: float) -> tuple[float, float]:
    """Return rate and output of (1 + s T_lead)/(1 + s T_lag)."""
    rate, output = lag(state, given, inv_lag_time)
    return rate, output + lead_time * rate


def limited_lag(state: float, given: float, inv_time: float, low: float, high: float) -> tuple[float, float]:
    """Return rate and output of 1/(1 + s T) with non-windup limits."""
    rate = limited_rate(inv_time * (given - state), state, low, high)
    return rate, clip(select(inv_time > 0.0, state, given), low, high)
