"""How one stage of the classical Runge-Kutta method moves the states of a unit."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

from wtg_gym.systems.elementary import fma, select
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import System

_OF_STAGE = ("active", "ahead", "first", "last")


def moving(rates: System, *limits: Callable[..., Any] | None, constants: Sequence[str] = ()) -> System:
    """Return the system that moves the states whose rates another system finds, by a stage of the method.

    It is told how far the stage goes (`ahead` [s], a sixth of the step for the last) and whether it is the first or the
    last one.

    Args:
        rates: writes "x_rates" of states "x" first, then other parts.
        limits: for each of these states the function of it and of some constants that holds it within its limits, which
            it does at the end of a step; None where there are none.
        constants: names of those that each limit depends on.
    """
    states = tuple(name.removesuffix("_rates") for name in rates.writes if name.endswith("_rates"))
    own = tuple(f"{state}_{what}" for state in states for what in ("base", "sum"))
    given_to_rates, equation = rates.arguments_named, rates.equation
    arguments = tuple(dict.fromkeys((*given_to_rates, *states, *own, *constants, *_OF_STAGE)))

    def stage(*values: Any) -> tuple[Any, ...]:
        given = dict(zip(arguments, values, strict=True))
        found = equation(*(given[name] for name in given_to_rates))
        found = found if type(found) is tuple else (found,)
        active, ahead, first, last = (given[name] for name in _OF_STAGE)
        moved: list[Any] = []
        for i, state in enumerate(states):
            base, total = given[f"{state}_base"], given[f"{state}_sum"]
            free, base, total = _moved(given[state], base, total, found[i], ahead, first, last)
            limit = limits[i] if limits else None
            within = free if limit is None else limit(free, given[constants[i]])
            moved += (_kept(free, within, base, last, active), base, total)
        return (*moved, *found[len(states) :])

    writes = [name for state in states for name in (state, f"{state}_base", f"{state}_sum")]
    origin = functools.partial(moving, constants=constants), (rates, *limits)
    written = (*writes, *rates.writes[len(states) :])
    return System(rates.kind, stage, written, rates.when, arguments=arguments, origin=origin)


def _moved(
    state: Any, base: Any, total: Any, rates: Any, ahead: float, first: float, last: float
) -> tuple[Any, Any, Any]:
    """Return states that a stage has moved, their base and the sum of their rates."""
    base = each(lambda now, before: select(first > 0.5, now, before), state, base)
    # The last stage goes along the sum of all rates, k1 + 2 k2 + 2 k3 + k4; after it nobody reads that sum.
    along = each(lambda rate, so_far: select(last > 0.5, so_far + rate, rate), rates, total)
    moved = each(lambda way, start: fma(ahead, way, start), along, base)
    more = each(lambda rate, so_far: select(first > 0.5, rate, fma(2.0, rate, so_far)), rates, total)
    return moved, base, each(lambda new, so_far: select(last > 0.5, so_far, new), more, total)


def _kept(moved: Any, within: Any, base: Any, last: float, active: float) -> Any:
    """Return states after a stage; an ended lane keeps its base exactly, to which not even a rounding is added."""
    held = each(lambda free, limited: select(last > 0.5, limited, free), moved, within)
    return each(lambda new, old: select(active > 0.5, new, old), held, base)
