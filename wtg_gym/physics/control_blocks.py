"""Blocks that controls are made of, and their constants.

Each block takes its state, its input and its constants, and returns the rate of the state and its output. Where the
inverse of a time constant is 0 the block is none: its state stands still, and its output is its input.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from wtg_gym.systems.elementary import clip, limited_rate, select


def inverse(time_s: float) -> float:
    """Return 1/T of a time constant [1/s], 0 for none."""
    return 1.0 / time_s if time_s > 0.0 else 0.0


class Constants:
    """What makes the constants of a control: a record of its machine's number and of all parameters by their names.

    With each time constant `x_time_s` comes its inverse `inv_x_time` [1/s], 0 for none.

    Args:
        parameters: classes of parameters; what the last has and another one lacks is 0.
        besides: further constants, from the parameters.
    """

    def __init__(self, *parameters: type[Any], besides: Callable[[Any], Mapping[str, Any]] = lambda _: {}) -> None:
        self.parameters, self._besides = parameters, besides
        named: Callable[..., Any] = NamedTuple  # with fields that are not known before
        usual = self._values(0, parameters[-1]())
        self.record = named(parameters[-1].MODEL, [(name, type(value)) for name, value in usual.items()])

    def __call__(self, machine: int, given: Any) -> Any:
        """Return the constants of the control of a machine, given by its index."""
        return self.record(**self._values(machine, given))

    def _values(self, machine: int, given: Any) -> dict[str, Any]:
        own = dict.fromkeys(vars(self.parameters[-1]()), 0.0) | vars(given)
        inverses = {f"inv_{name.removesuffix('_s')}": inverse(own[name]) for name in own if "_time" in name}
        return {"machine": machine, **own, **inverses, **self._besides(given)}


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
