"""How one stage of the classical Runge-Kutta method moves the states of a unit."""

from __future__ import annotations

from typing import Any, NamedTuple

from wtg_gym.systems.elementary import fma, select
from wtg_gym.systems.records import each


class Moved(NamedTuple):
    """The states of a unit after a stage."""

    state: Any
    base: Any  # state at the step's start
    sum: Any  # of the rates so far: k1, k1 + 2 k2, k1 + 2 k2 + 2 k3


def moved_by_stage(state: Any, base: Any, total: Any, rates: Any, *, ahead: float, first: float, last: float) -> Moved:
    """Return states that a stage has moved; what limits them comes after (:func:`kept`).

    Args:
        state, base, total: records of the states now, at the step's start, and the sum of the rates so far.
        rates: of this stage.
        ahead: how far the stage moves the states from their base [s]; a sixth of the step for the last.
        first, last: 1 in that stage, else 0.
    """
    base = each(lambda now, before: select(first > 0.5, now, before), state, base)
    # The last stage goes along the sum of all rates, k1 + 2 k2 + 2 k3 + k4.
    along = each(lambda rate, so_far: select(last > 0.5, so_far + rate, rate), rates, total)
    moved = each(lambda way, from_: fma(ahead, way, from_), along, base)
    # After the last stage nobody reads the sum.
    more = each(lambda rate, so_far: select(first > 0.5, rate, fma(2.0, rate, so_far)), rates, total)
    total = each(lambda new, so_far: select(last > 0.5, so_far, new), more, total)
    return Moved(moved, base, total)


def kept(moved: Moved, limited: Any, *, last: float, active: float) -> Moved:
    """Return the states of a unit after a stage: the last stage holds them within their limits.

    A lane that has ended, and a unit that is disconnected, keep their base exactly: not even a rounding is added.
    """
    held = each(lambda free, within: select(last > 0.5, within, free), moved.state, limited)
    state = each(lambda new, base: select(active > 0.5, new, base), held, moved.base)
    return Moved(state, moved.base, moved.sum)
