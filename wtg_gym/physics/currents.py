"""The currents of all units from their voltages, and the limit on those of the WTG groups."""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.elementary import fma, select
from wtg_gym.physics.extended_converter import limiting_reactance
from wtg_gym.physics.layout import (
    EXTENSION,
    Floats,
    Lanes,
    Phasor,
    extension_at,
    load_phasor,
    read_extension,
    rows_of,
    store_phasor,
)

#: Gauss-Seidel sweeps over the groups whose current is limited, at most: a few, but some thirty for large groups at a
#: weak bus. They end once no voltage moves by more than 1e-12 p.u.; the squares are compared.
_SWEEPS = 100
SETTLED = 1e-12 * 1e-12


@inlined
def unit_currents(block: Floats, c: Any, lanes: Lanes) -> None:
    """Find the units' currents I = Y E with the reduced admittance of each lane's network."""
    width, rows = len(lanes), rows_of(c)
    n = c["unit_bus"].shape[0]
    for i in range(n):
        at, y = (rows.current + 2 * i) * width, (rows.admittance + 2 * i * n) * width
        for x in range(2 * width):
            block[at + x] = 0.0
        # Three at a time: sums in registers save half of the memory's traffic.
        for j in range(0, n - n % 3, 3):
            e_j, y_j = (rows.voltage + 2 * j) * width, y + 2 * j * width
            for x in range(width):
                current = load_phasor(block, at + x, width)
                current = _plus_product(current, block, y_j + x, e_j + x, width)
                current = _plus_product(current, block, y_j + 2 * width + x, e_j + 2 * width + x, width)
                current = _plus_product(current, block, y_j + 4 * width + x, e_j + 4 * width + x, width)
                store_phasor(current, block, at + x, width)
        for j in range(n - n % 3, n):
            e_j, y_j = (rows.voltage + 2 * j) * width, y + 2 * j * width
            for x in range(width):
                current = load_phasor(block, at + x, width)
                store_phasor(_plus_product(current, block, y_j + x, e_j + x, width), block, at + x, width)
    if c["extension"].shape[0] > 0:
        limit_currents(block, c, lanes)


@inlined
def limit_currents(block: Floats, c: Any, lanes: Lanes) -> None:
    """Turn the voltages of groups whose current is too large into those behind their limiting reactance.

    A lane without such a group, or one that has settled, keeps its bits, whatever its neighbours do.
    """
    width, rows = len(lanes), rows_of(c)
    n_sync = c["machines"].shape[0]
    limit = read_extension(c["extension"][0]).limits.current_max
    # An integer count vectorises over lanes; a maximum of floats does not.
    exceeded = np.int64(0)
    for j in range(c["share"].shape[0]):
        current_at, o = (rows.current + 2 * (n_sync + j)) * width, extension_at(c, j, width) + EXTENSION.output * width
        largest = (limit * c["share"][j]) * (limit * c["share"][j])
        for x in range(width):
            current = load_phasor(block, current_at + x, width)
            exceeded += np.int64(fma(current.re, current.re, current.im * current.im) > largest)
            block[o + x] = 0.0
    if exceeded == 0:
        return
    for j in range(c["share"].shape[0]):
        e, o = (rows.voltage + 2 * (n_sync + j)) * width, extension_at(c, j, width) + EXTENSION.source * width
        for x in range(width):
            store_phasor(load_phasor(block, e + x, width), block, o + x, width)
    for _ in range(_SWEEPS):
        moved = np.int64(0)
        for j in range(c["share"].shape[0]):
            moved += limit_group_current(block, c, j, limit * c["share"][j], lanes)
        if moved == 0:
            return


@inlined
def limit_group_current(block: Floats, c: Any, j: int, limit: float, lanes: Lanes) -> np.int64:
    """Find the limiting reactance of WTG group j with all other voltages fixed, and change all currents.

    Returns:
        in how many lanes its voltage has moved.
    """
    width, rows = len(lanes), rows_of(c)
    n = c["unit_bus"].shape[0]
    unit = c["machines"].shape[0] + j
    own, o = (rows.voltage + 2 * unit) * width, extension_at(c, j, width)
    moved = np.int64(0)
    for x in range(width):
        y = load_phasor(block, (rows.admittance + 2 * (unit * n + unit)) * width + x, width)
        source = load_phasor(block, o + EXTENSION.source * width + x, width)
        e = load_phasor(block, own + x, width)
        current = load_phasor(block, (rows.current + 2 * unit) * width + x, width)
        free = _plus(current, y, Phasor(source.re - e.re, source.im - e.im))
        reactance = limiting_reactance(free.re, free.im, y.re, y.im, limit)
        # E' = E - jX_v I, and I = I_0 / (1 + jX_v Y).
        d_re, d_im = 1.0 - reactance * y.im, reactance * y.re
        size = reactance / fma(d_re, d_re, d_im * d_im)
        drop_re = size * fma(free.re, d_re, free.im * d_im)
        drop_im = size * fma(free.im, d_re, -(free.re * d_im))
        change = Phasor(source.re + drop_im - e.re, source.im - drop_re - e.im)
        moves = fma(change.re, change.re, change.im * change.im) > SETTLED
        change = Phasor(select(moves, change.re, 0.0), select(moves, change.im, 0.0))
        moved += np.int64(moves)
        block[o + EXTENSION.output * width + x] = reactance
        store_phasor(change, block, o + EXTENSION.change * width + x, width)
        store_phasor(Phasor(e.re + change.re, e.im + change.im), block, own + x, width)
    for i in range(n):
        for x in range(width):
            y = load_phasor(block, (rows.admittance + 2 * (i * n + unit)) * width + x, width)
            change = load_phasor(block, o + EXTENSION.change * width + x, width)
            current = load_phasor(block, (rows.current + 2 * i) * width + x, width)
            store_phasor(_plus(current, y, change), block, (rows.current + 2 * i) * width + x, width)
    return moved


@inlined
def _plus_product(total: Phasor, block: Floats, admittance: int, voltage: int, width: int) -> Phasor:
    return _plus(total, load_phasor(block, admittance, width), load_phasor(block, voltage, width))


@inlined
def _plus(total: Phasor, y: Phasor, e: Phasor) -> Phasor:
    return Phasor(total.re + fma(y.re, e.re, -(y.im * e.im)), total.im + fma(y.re, e.im, y.im * e.re))
