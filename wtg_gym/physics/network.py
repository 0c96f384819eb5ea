"""Admittances and power flow, dense and sparse."""

import heapq
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.grid import Branch
from wtg_gym.systems.compiled import compiled, internal
from wtg_gym.systems.programs import Complex, Floats, Whole

#: Largest power mismatch accepted as a power-flow solution [p.u.].
POWER_FLOW_TOLERANCE = 1e-12
#: Impedance of a branch below which rounding keeps the power flow from its tolerance [p.u.].
LEAST_IMPEDANCE = 1e-6


def branch_admittances(branches: tuple[Branch, ...]) -> Complex:
    """Return (y_ff, y_ft, y_tf, y_tt) of every branch, shape (n_branch, 4) [p.u.]."""
    rows = np.zeros((len(branches), 4), dtype=np.complex128)
    for row, branch in zip(rows, branches, strict=True):
        series = 1.0 / complex(branch.resistance, branch.reactance)
        diagonal = series + 0.5j * branch.charging
        tap = branch.tap * complex(math.cos(branch.phase_rad), math.sin(branch.phase_rad))
        row[:] = diagonal / abs(tap) ** 2, -series / tap.conjugate(), -series / tap, diagonal
    return rows


@internal
def _size(value: complex) -> float:
    """Return |Re| + |Im|: as good as the modulus to choose a pivot by, without its root."""
    return abs(value.real) + abs(value.imag)


@internal
def eliminate(a: npt.NDArray, filled: Whole) -> bool:  # type: ignore[type-arg]
    """Solve A x = b for several right-hand sides by Gaussian elimination with partial pivoting.

    `a` (n, n + m) is [A | b], and [… | x] on return. Returns False where A is singular. Ours rather than LAPACK's: the
    same bits whatever library, thread count or processor numpy was built for. `filled` is room for n + m numbers.
    """
    n, n_columns = a.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if _size(a[i, k]) > _size(a[pivot, k]):
                pivot = i
        if not _size(a[pivot, k]) > 1e-14:
            return False
        if pivot != k:
            for j in range(k, n_columns):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
        a[k, k] = 1.0 / a[k, k]
        n_filled = 0
        for j in range(k + 1, n_columns):
            if a[k, j] != 0.0:
                filled[n_filled] = j
                n_filled += 1
        for i in range(k + 1, n):
            if a[i, k] != 0.0:
                factor = a[i, k] * a[k, k]
                for j in filled[:n_filled]:
                    a[i, j] -= factor * a[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            if a[k, i] != 0.0:
                for j in range(n, n_columns):
                    a[k, j] -= a[k, i] * a[i, j]
        for j in range(n, n_columns):
            a[k, j] *= a[k, k]
    return True


def assemble_admittance(ends: Whole, branch_y: Complex, bus_y: Complex) -> Complex:
    """Return the bus admittance matrix (n_bus, n_bus) [p.u.] of closed branches plus `bus_y` (n_bus,) on the diagonal.

    Branches are given by the bus indices of their ends (n_branch, 2) and admittances ff, ft, tf, tt (n_branch, 4)
    [p.u.].
    """
    y = np.diag(bus_y)
    for (start, end), entries in zip(ends, branch_y, strict=True):
        y[[start, start, end, end], [start, end, start, end]] += entries
    return y


class PowerFlow(NamedTuple):
    """Columns of a bus in a power flow."""

    power: int  # P + jQ into the network; Q counts only where no voltage is held [p.u.]
    polar: int  # magnitude [p.u.] and angle [rad]: start and result
    holds_voltage: int  # above 0.5 where it does; at the slack bus
    flow: int  # result: P + jQ from the bus into the branches [p.u.]
    voltage: int  # result [p.u.]


@compiled
def solve_power_flow(y: Complex, slack: int, buses: Floats, at: PowerFlow) -> int:
    """Solve the power flow by Newton's method in polar form.

    The bus admittance matrix (n_bus, n_bus) is without loads [p.u.]. `at` are the columns in `buses` (n_bus, n); a
    complex number takes two. It returns the iterations used, or -1 if the mismatch stays above POWER_FLOW_TOLERANCE.
    """
    n, n_unknown = y.shape[0], 0
    # Places of each bus's active and reactive mismatch, which are those of its angle and magnitude; -1 for a given one.
    p, q = np.full(n, -1), np.full(n, -1)
    for k in range(n):
        if k != slack:
            p[k], n_unknown = n_unknown, n_unknown + 1
    for k in range(n):
        if not buses[k, at.holds_voltage] > 0.5:
            q[k], n_unknown = n_unknown, n_unknown + 1
    # Sensitivities of the mismatches to the unknowns, and the mismatches.
    a, filled = np.empty((n_unknown, n_unknown + 1)), np.empty(n_unknown + 1, dtype=np.int64)
    turn = np.empty((n, n), dtype=np.complex128)
    for iteration in range(30):
        worst = _write_jacobian(a, turn, y, p, q, buses, at)
        if worst < POWER_FLOW_TOLERANCE:
            note_flow(y, buses, at)
            return iteration
        if not math.isfinite(worst) or not eliminate(a, filled):
            return -1
        for k in range(n):
            if p[k] >= 0:
                buses[k, at.polar + 1] += a[p[k], n_unknown]
            if q[k] >= 0:
                buses[k, at.polar] += a[q[k], n_unknown]
    return -1


@internal
def _add(a: Floats, row: int, column: int, value: float) -> None:
    if row >= 0 and column >= 0:
        a[row, column] += value


@internal
def _write_jacobian(a: Floats, turn: Complex, y: Complex, p: Whole, q: Whole, buses: Floats, at: PowerFlow) -> float:
    """Write sensitivities and mismatches of a power flow to `a`; return the largest mismatch [p.u.]."""
    worst, last = 0.0, a.shape[0]
    a[:] = 0.0
    for i in range(y.shape[0]):
        sum_re, sum_im, size = 0.0, 0.0, buses[i, at.polar]
        for j in range(y.shape[0]):
            # Sine and cosine of a pair of buses serve both ways round.
            if j > i and (y[i, j] != 0.0 or y[j, i] != 0.0):
                d = buses[i, at.polar + 1] - buses[j, at.polar + 1]
                turn[i, j] = complex(math.cos(d), math.sin(d))
                turn[j, i] = turn[i, j].conjugate()
            if y[i, j] != 0.0:
                turned, other = turn[i, j] if j != i else 1.0 + 0j, buses[j, at.polar]
                s = size * other * y[i, j].conjugate() * turned
                sum_re, sum_im = sum_re + s.real, sum_im + s.imag
                if j != i:
                    _add(a, p[i], p[j], s.imag)
                    _add(a, q[i], p[j], -s.real)
                    _add(a, p[i], q[j], s.real / other)
                    _add(a, q[i], q[j], s.imag / other)
        diagonal = size**2 * y[i, i].conjugate()
        _add(a, p[i], p[i], diagonal.imag - sum_im)
        _add(a, p[i], q[i], (sum_re + diagonal.real) / size)
        _add(a, q[i], p[i], sum_re - diagonal.real)
        _add(a, q[i], q[i], (sum_im + diagonal.imag) / size)
        for row, missing in ((p[i], buses[i, at.power] - sum_re), (q[i], buses[i, at.power + 1] - sum_im)):
            if row >= 0:
                a[row, last], worst = missing, max(worst, abs(missing))
    return worst


@internal
def note_flow(y: Complex, buses: Floats, at: PowerFlow) -> None:
    """Write voltages and flows of a solved power flow."""
    n = y.shape[0]
    for k in range(n):
        angle, size = buses[k, at.polar + 1], buses[k, at.polar]
        voltage = size * complex(math.cos(angle), math.sin(angle))
        buses[k, at.voltage], buses[k, at.voltage + 1] = voltage.real, voltage.imag
    for k in range(n):
        injected = 0j
        for m in range(n):
            injected += y[k, m] * complex(buses[m, at.voltage], buses[m, at.voltage + 1])
        flow = complex(buses[k, at.voltage], buses[k, at.voltage + 1]) * injected.conjugate()
        buses[k, at.flow], buses[k, at.flow + 1] = flow.real, flow.imag


#: Buses from which on the sparse elimination is quicker than the dense one.
SPARSE_FROM = 20
#: Largest mismatch accepted, over the sum of the powers that meet at the bus.
_TOLERANCE = 1e-14
#: Newton steps at most.
_STEPS = 30


class Pattern(NamedTuple):
    """Where numbers stand in the elimination; buses are counted in its order."""

    order: Whole  # bus index of each (n_bus,)
    first: Whole  # first entry of each, (n_bus + 1,)
    later: Whole  # the later bus of each entry (n_entries,)
    first_target: Whole  # of each entry (n_entries + 1,)
    target: Whole  # entry that a pair of entries changes, below zero -1 - bus for one on the diagonal (n_targets,)
    entry_of: Whole  # by branch of the pattern: entry (n_pairs,)
    pairs: Whole  # the buses' indices of each pair with an admittance (n_pairs, 2), the earlier one first


def pattern_of(y: Complex) -> Pattern:
    """Return the pattern of a bus admittance matrix (n_bus, n_bus)."""
    n = len(y)
    beside = [set(np.flatnonzero((y[k] != 0.0) | (y[:, k] != 0.0)).tolist()) - {k} for k in range(n)]
    pairs = [(a, b) for a in range(n) for b in beside[a] if a < b]
    queue = [(len(row), k) for k, row in enumerate(beside)]
    heapq.heapify(queue)
    place, order, rows = np.full(n, -1), list[int](), list[list[int]]()
    while queue:
        degree, bus = heapq.heappop(queue)
        if place[bus] >= 0 or degree != len(beside[bus]):
            continue
        place[bus] = len(order)
        order.append(bus)
        others = sorted(beside[bus])
        rows.append(others)
        for other in others:
            beside[other] |= set(others)
            beside[other] -= {other, bus}
            heapq.heappush(queue, (len(beside[other]), other))
    later = [sorted(int(place[other]) for other in row) for row in rows]
    first = np.cumsum([0, *map(len, later)])
    at = {(k, j): int(first[k]) + i for k, row in enumerate(later) for i, j in enumerate(row)}
    targets = [[-1 - j if j == m else at[min(j, m), max(j, m)] for m in row] for row in later for j in row]
    sorted_pairs = [sorted((int(place[a]), int(place[b]))) for a, b in pairs]
    return Pattern(
        order=np.array(order, dtype=np.int64),
        first=np.array(first, dtype=np.int64),
        later=np.array([j for row in later for j in row], dtype=np.int64),
        first_target=np.array([0, *itertools.accumulate(map(len, targets))], dtype=np.int64),
        target=np.array([*itertools.chain(*targets)], dtype=np.int64),
        entry_of=np.array([at[a, b] for a, b in sorted_pairs], dtype=np.int64),
        pairs=np.array([(order[a], order[b]) for a, b in sorted_pairs], dtype=np.int64).reshape(-1, 2),
    )


@internal
def _less_product(block: Floats, a: Floats, b: Floats) -> None:
    """Subtract the product of two blocks from a third."""
    block[0, 0] -= a[0, 0] * b[0, 0] + a[0, 1] * b[1, 0]
    block[0, 1] -= a[0, 0] * b[0, 1] + a[0, 1] * b[1, 1]
    block[1, 0] -= a[1, 0] * b[0, 0] + a[1, 1] * b[1, 0]
    block[1, 1] -= a[1, 0] * b[0, 1] + a[1, 1] * b[1, 1]


@internal
def _set(block: Floats, a: float, b: float, c: float, d: float) -> None:
    block[0, 0], block[0, 1], block[1, 0], block[1, 1] = a, b, c, d


@internal
def solve_blocks(diagonal: Floats, above: Floats, below: Floats, x: Floats, pattern: Pattern) -> bool:
    """Solve a block matrix with symmetric pattern by elimination, in place; False where a diagonal block is singular.

    Blocks on the diagonal (n_bus, 2, 2) are in the pattern's order, and their inverses on return; those above and below
    it (n_entries, 2, 2) are of its entries. `x` is the right-hand side, then the solution (n_bus, 2).
    """
    for k in range(len(diagonal)):
        d = diagonal[k]
        det = d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]
        if not abs(det) > 1e-30:
            return False
        _set(d, d[1, 1] / det, -d[0, 1] / det, -d[1, 0] / det, d[0, 0] / det)
        begin, end = pattern.first[k], pattern.first[k + 1]
        for e in range(begin, end):
            j, low = pattern.later[e], below[e]
            for r in range(2):
                first, second = low[r, 0], low[r, 1]
                low[r, 0] = first * d[0, 0] + second * d[1, 0]
                low[r, 1] = first * d[0, 1] + second * d[1, 1]
            x[j, 0] -= low[0, 0] * x[k, 0] + low[0, 1] * x[k, 1]
            x[j, 1] -= low[1, 0] * x[k, 0] + low[1, 1] * x[k, 1]
            for i in range(end - begin):
                target = pattern.target[pattern.first_target[e] + i]
                off_diagonal = above if j < pattern.later[begin + i] else below
                _less_product(diagonal[-1 - target] if target < 0 else off_diagonal[target], low, above[begin + i])
    for k in range(len(diagonal) - 1, -1, -1):
        for e in range(pattern.first[k], pattern.first[k + 1]):
            j = pattern.later[e]
            x[k, 0] -= above[e, 0, 0] * x[j, 0] + above[e, 0, 1] * x[j, 1]
            x[k, 1] -= above[e, 1, 0] * x[j, 0] + above[e, 1, 1] * x[j, 1]
        first, second = x[k, 0], x[k, 1]
        x[k, 0] = diagonal[k, 0, 0] * first + diagonal[k, 0, 1] * second
        x[k, 1] = diagonal[k, 1, 0] * first + diagonal[k, 1, 1] * second
    return True


@compiled
def solve_sparse_flow(y: Complex, slack: int, buses: Floats, at: PowerFlow, pattern: Pattern) -> int:
    """Solve the power flow of a large network; arguments and result are those of `solve_power_flow`.

    The tolerance grows with the powers that meet at a bus, whose sum rounding limits.
    """
    n = y.shape[0]
    diagonal, x, size = np.empty((n, 2, 2)), np.empty((n, 2)), np.empty(n)
    voltage, flow = np.empty((2, n), np.complex128)
    above, below = np.empty((len(pattern.later), 2, 2)), np.empty((len(pattern.later), 2, 2))
    for iteration in range(_STEPS):
        _write_flows((above, below, voltage, flow, size), y, buses, at, pattern)
        worst = _write_rows((diagonal, above, below, x), (flow, size), y, slack, buses, at, pattern)
        if worst < _TOLERANCE:
            note_flow(y, buses, at)
            return iteration
        if not math.isfinite(worst) or not solve_blocks(diagonal, above, below, x, pattern):
            return -1
        for place in range(n):
            k = pattern.order[place]
            buses[k, at.polar + 1] += x[place, 0]
            buses[k, at.polar] *= 1.0 + x[place, 1]
    return -1


@internal
def _write_flows(arrays: Any, y: Complex, buses: Floats, at: PowerFlow, pattern: Pattern) -> None:
    """Write the blocks off the diagonal, voltages, flows from each bus, and the sum of the powers that meet there."""
    above, below, voltage, flow, size = arrays
    above[:], below[:] = 0.0, 0.0
    for k in range(y.shape[0]):
        angle = buses[k, at.polar + 1]
        voltage[k] = buses[k, at.polar] * complex(math.cos(angle), math.sin(angle))
        square = buses[k, at.polar] * buses[k, at.polar]
        flow[k], size[k] = square * y[k, k].conjugate(), square * abs(y[k, k])
    for p in range(len(pattern.pairs)):
        a, b, e = pattern.pairs[p, 0], pattern.pairs[p, 1], pattern.entry_of[p]
        forth = voltage[a] * (y[a, b] * voltage[b]).conjugate()
        back = voltage[b] * (y[b, a] * voltage[a]).conjugate()
        flow[a], flow[b] = flow[a] + forth, flow[b] + back
        size[a], size[b] = size[a] + abs(forth), size[b] + abs(back)
        # Rows: P and Q of the bus; columns: angle and relative magnitude of the other.
        _set(above[e], forth.imag, forth.real, -forth.real, forth.imag)
        _set(below[e], back.imag, back.real, -back.real, back.imag)


@internal
def _write_rows(blocks: Any, flows: Any, y: Any, slack: int, buses: Any, at: PowerFlow, pattern: Pattern) -> float:
    """Write mismatches and diagonal blocks, without what is held; return the largest mismatch, relative to the sum."""
    (diagonal, above, below, x), (flow, size) = blocks, flows
    worst = 0.0
    for place in range(y.shape[0]):
        k = pattern.order[place]
        square = buses[k, at.polar] * buses[k, at.polar]
        p, q = flow[k].real, flow[k].imag
        g, b = square * y[k, k].real, -square * y[k, k].imag
        _set(diagonal[place], b - q, p + g, p - g, q + b)
        x[place, 0], x[place, 1] = buses[k, at.power] - p, buses[k, at.power + 1] - q
        if k == slack:
            diagonal[place, 0, 0], diagonal[place, 0, 1], x[place, 0] = 1.0, 0.0, 0.0
        else:
            worst = max(worst, abs(x[place, 0]) / max(size[k], 1.0))
        if buses[k, at.holds_voltage] > 0.5:
            diagonal[place, 1, 0], diagonal[place, 1, 1], x[place, 1] = 0.0, 1.0, 0.0
        else:
            worst = max(worst, abs(x[place, 1]) / max(size[k], 1.0))
        for e in range(pattern.first[place], pattern.first[place + 1]):
            other = pattern.order[pattern.later[e]]
            if k == slack:
                above[e, 0] = 0.0
            if buses[k, at.holds_voltage] > 0.5:
                above[e, 1] = 0.0
            if other == slack:
                below[e, 0] = 0.0
            if buses[other, at.holds_voltage] > 0.5:
                below[e, 1] = 0.0
    return worst
