"""How one stage of the Runge-Kutta method moves the states of a unit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.elementary import fma, select
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.records import elementwise, loader, size, storer

#: Values of `stage`: EVALUATE only stores the rates, the others are stages of the method.
EVALUATE, FIRST, MIDDLE, LAST = -1, 0, 1, 2


@inlined
def _base(state: float, base: float, first: bool) -> float:
    return select(first, state, base)


@inlined
def _sum(rate: float, total: float, first: bool) -> float:
    return select(first, rate, fma(2.0, rate, total))


@inlined
def _moved(base: float, rate: float, total: float, ahead: float, last: bool) -> float:
    # The last stage goes along the sum of all rates, k1 + 2 k2 + 2 k3 + k4.
    return fma(ahead, select(last, total + rate, rate), base)


@inlined
def _kept(moved: float, limited: float, base: float, last: bool, active: float) -> float:
    # An ended lane keeps its base exactly: nothing, not even a rounding, is added to it.
    return select(active > 0.5, select(last, limited, moved), base)


def advancer(record: type[Any], limited: Callable[..., Any]) -> Callable[..., None]:
    """Return the function that moves a unit's states by one stage.

    Args:
        record: of the states; rows for their base and their sum of rates follow theirs.
        limited: compiled; returns the states, held within their limits, given states and constants.
    """
    load: Callable[..., Any] = loader(record)
    store: Callable[..., None] = storer(record)
    n = size(record)
    base_of: Callable[..., Any] = elementwise(record, _base, "base", "state, base", "first")
    sum_of: Callable[..., Any] = elementwise(record, _sum, "sum", "rate, total", "first")
    moved_of: Callable[..., Any] = elementwise(record, _moved, "moved", "base, rate, total", "ahead, last")
    kept_of: Callable[..., Any] = elementwise(record, _kept, "kept", "moved, limited, base", "last, active")

    @inlined
    def advance(
        state: Any,
        rates: Any,
        constants: Any,
        block: Floats,
        at: int,
        rate_at: int,
        active: float,
        stage: np.int64,
        ahead: float,
        width: int,
    ) -> None:
        first, last = stage == FIRST, stage == LAST
        if stage == EVALUATE:
            store(rates, block, rate_at, width)
        else:
            base = base_of(state, load(block, at + n * width, width), first)
            total = load(block, at + 2 * n * width, width)
            moved = moved_of(base, rates, total, ahead, last)
            moved = kept_of(moved, limited(moved, constants), base, last, active)
            store(moved, block, at, width)
            if first:
                store(base, block, at + n * width, width)
            if not last:
                store(sum_of(rates, total, first), block, at + 2 * n * width, width)

    return advance
