"""Networks as data, admittances, power flow and transfer impedances.

Everything here is dense and small: compiled functions solve a 14-bus system in microseconds and allocate only on
resets and network events.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wtg_gym.physics.checked import Checked, design, parameter, required
from wtg_gym.physics.machine_parameters import AnyGovernor, SynchronousMachineParameters
from wtg_gym.systems.compiled import compiled, inlined, internal

#: Largest power mismatch accepted as a power-flow solution [p.u.].
POWER_FLOW_TOLERANCE = 1e-12
#: Impedance of a branch below which rounding keeps the power flow from its tolerance [p.u.].
LEAST_IMPEDANCE = 1e-6
#: Buses and machines or sources of a network at most: a batch of episodes of more would not fit into memory.
MOST_BUSES, MOST_UNITS = 500, 100


@dataclass(frozen=True, kw_only=True)
class Bus(Checked):
    """A bus: number, constant-impedance load and shunt, and the voltage its units hold."""

    number: int = required("-", "IEEE 14", "bus number")
    load_mw: float = parameter(0.0, "MW", "IEEE 14", "active load at the initial voltage", -1e9, 1e9)
    load_mvar: float = parameter(0.0, "Mvar", "IEEE 14", "reactive load at the initial voltage", -1e9, 1e9)
    shunt_mw: float = parameter(0.0, "MW", "IEEE 14", "active shunt at 1 p.u. of voltage", -1e9, 1e9)
    shunt_mvar: float = parameter(0.0, "Mvar", "IEEE 14", "capacitive shunt at 1 p.u. of voltage", -1e9, 1e9)
    voltage_pu: float | None = parameter(
        None, "p.u.", "IEEE 14", "voltage that the bus's units hold, None for none", 0.1, 10.0
    )
    x: float | None = design(None, "-", "where pictures show it, from the left; None: laid out", -1e6, 1e6)
    y: float | None = design(None, "-", "and from below", -1e6, 1e6)


@dataclass(frozen=True, kw_only=True)
class Branch(Checked):
    """A line or transformer as a π section; the tap is on the `from_bus` side. Values in p.u. of the system base."""

    from_bus: int = required("-", "IEEE 14", "bus at the tap's side")
    to_bus: int = required("-", "IEEE 14", "bus at the other end")
    resistance: float = required("p.u.", "IEEE 14", "series resistance", -1e6, 1e6)
    reactance: float = required("p.u.", "IEEE 14", "series reactance", -1e6, 1e6)
    charging: float = parameter(0.0, "p.u.", "IEEE 14", "charging susceptance of the whole line", -1e6, 1e6)
    tap: float = parameter(1.0, "-", "IEEE 14", "tap ratio", 0.01, 100.0)
    phase_rad: float = parameter(0.0, "rad", "IEEE 14", "phase shift", -2.0 * math.pi, 2.0 * math.pi)


@dataclass(frozen=True, kw_only=True)
class Source(Checked):
    """An imposed source: a voltage behind an impedance, whose frequency and angle events prescribe."""

    bus: int = required("-", "design", "bus number")
    resistance: float = design(0.0, "p.u.", "resistance behind which it stands, on the system base", 0.0, 1e3)
    reactance: float = design(1e-3, "p.u.", "reactance behind which it stands, on the system base", 1e-6, 1e3)


@dataclass(frozen=True, kw_only=True)
class NetworkCase(Checked):
    """A network with its synchronous machines, as data.

    The voltage angle at `slack_bus` is zero. Its machines or sources balance the power; without any, all WTG groups do.

    Raises:
        ValueError: a bus is missing, doubled or not connected, nothing balances the power, or a value is out of range.
    """

    MOST = types.MappingProxyType({"buses": MOST_BUSES, "machines": MOST_UNITS, "sources": MOST_UNITS})

    name: str
    base_mva: float = required("MVA", "IEEE 14", "system base", 1e-3, 1e9)
    frequency_hz: float = required("Hz", "IEEE 14", "nominal frequency", 1.0, 1000.0)
    slack_bus: int
    buses: tuple[Bus, ...]
    branches: tuple[Branch, ...]
    machines: tuple[SynchronousMachineParameters, ...]
    sources: tuple[Source, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = self.bus_numbers
        if len(set(numbers)) != len(numbers):
            raise ValueError(f"{self.name}: bus numbers must be unique, got {list(numbers)}")
        for branch in self.branches:
            self.bus_index(branch.from_bus)
            self.bus_index(branch.to_bus)
            if branch.from_bus == branch.to_bus:
                raise ValueError(f"{self.name}: a branch goes from bus {branch.from_bus} to itself")
            if branch.resistance == 0.0 and branch.reactance == 0.0:
                raise ValueError(f"{self.name}: branch {branch.from_bus}-{branch.to_bus} has no impedance")
        for bus in self.unit_buses:
            self.bus_index(bus)
        if self.machines and not self.balanced:
            raise ValueError(
                f"{self.name}: no synchronous machine or source at the slack bus {self.slack_bus} balances the power"
            )
        if len(self.parts_without(())) > 1:
            raise ValueError(f"{self.name}: the network is not connected")
        if self.buses[self.bus_index(self.slack_bus)].voltage_pu is None:
            raise ValueError(f"{self.name}: the slack bus {self.slack_bus} must hold a voltage; its voltage_pu is None")

    @functools.cached_property
    def bus_numbers(self) -> tuple[int, ...]:
        """Return the bus numbers in order of the index."""
        return tuple(bus.number for bus in self.buses)

    @property
    def unit_buses(self) -> tuple[int, ...]:
        """Bus of each machine, then of each source."""
        return (*(machine.bus for machine in self.machines), *(source.bus for source in self.sources))

    @property
    def balanced(self) -> bool:
        """Whether a machine or a source balances the power at the slack bus."""
        return self.slack_bus in self.unit_buses

    @functools.cached_property
    def load_mw(self) -> float:
        """Load of all buses [MW]."""
        return sum(bus.load_mw for bus in self.buses)

    def bus_index(self, number: int) -> int:
        """Return the index of a bus number; a ValueError lists the buses there are."""
        if isinstance(number, bool) or number not in self.bus_numbers:
            raise ValueError(f"unknown bus {number!r}; {self.name} has buses {list(self.bus_numbers)}")
        return self.bus_numbers.index(number)

    def branch_index(self, from_bus: int, to_bus: int, circuit: int | None = None) -> int:
        """Return the index of the branch between two buses, either way round; a ValueError lists the branches.

        Args:
            from_bus, to_bus: numbers of the buses.
            circuit: which of parallel branches, counted from 1; None: the first.
        """
        self.bus_index(from_bus)
        self.bus_index(to_bus)
        found = self._branches_by_ends.get(frozenset((from_bus, to_bus)), [])
        if 0 < (circuit or 1) <= len(found):
            return found[(circuit or 1) - 1]
        if found:
            raise ValueError(f"no circuit {circuit} between buses {from_bus} and {to_bus}; there are {len(found)}")
        known = ", ".join(f"{b.from_bus}-{b.to_bus}" for b in self.branches)
        raise ValueError(f"no branch {from_bus}-{to_bus} in {self.name}; branches: {known}")

    @functools.cached_property
    def _branches_by_ends(self) -> dict[frozenset[int], list[int]]:
        found: dict[frozenset[int], list[int]] = {}
        for index, branch in enumerate(self.branches):
            found.setdefault(frozenset((branch.from_bus, branch.to_bus)), []).append(index)
        return found

    def parts_without(self, branches: tuple[int, ...]) -> list[set[int]]:
        """Return the buses of each part that hangs together when the branches of these indices are open."""
        at = {number: place for place, number in enumerate(self.bus_numbers)}
        closed = [(at[b.from_bus], at[b.to_bus]) for index, b in enumerate(self.branches) if index not in branches]
        ends = np.array(closed, dtype=np.int64).reshape(-1, 2).T
        shape = (len(at), len(at))
        n, part_of = connected_components(coo_array((np.ones(ends.shape[1]), ends), shape=shape), directed=False)
        parts: list[set[int]] = [set() for _ in range(n)]
        for number, part in zip(self.bus_numbers, part_of.tolist(), strict=True):
            parts[part].add(number)
        return parts

    @functools.cached_property
    def bridges(self) -> frozenset[int]:
        """Return the indices of the branches any one of which splits the network when it opens.

        A depth-first search meets every branch once: what hangs below a bridge reaches nothing above it otherwise.
        Source: R. Tarjan, "A note on finding the bridges of a graph", 1974.
        """
        beside: dict[int, list[tuple[int, int]]] = {number: [] for number in self.bus_numbers}
        for index, branch in enumerate(self.branches):
            beside[branch.from_bus].append((branch.to_bus, index))
            beside[branch.to_bus].append((branch.from_bus, index))
        root = self.bus_numbers[0]
        # The order in which buses are met, and the earliest that what lies below them reaches.
        met, reaches, found = {root: 0}, {root: 0}, set[int]()
        path = [(root, -1, iter(beside[root]))]
        while path:
            bus, came_by, others = path[-1]
            for other, index in others:
                if index == came_by:
                    continue
                if other not in met:
                    met[other] = reaches[other] = len(met)
                    path.append((other, index, iter(beside[other])))
                    break
                reaches[bus] = min(reaches[bus], met[other])
            else:
                path.pop()
                if path:
                    above = path[-1][0]
                    reaches[above] = min(reaches[above], reaches[bus])
                    if reaches[bus] > met[above]:
                        found.add(came_by)
        return frozenset(found)

    def classical(self) -> NetworkCase:
        """Return the network with a constant voltage behind x'_d in place of every machine and its exciter."""
        machines = (
            dataclasses.replace(machine, classical=True, exciter=None, stabiliser=None) for machine in self.machines
        )
        return dataclasses.replace(self, machines=tuple(machines))

    def with_governors(self, change: Callable[[AnyGovernor], AnyGovernor]) -> NetworkCase:
        """Return the network with other governors: `change` turns the one of each machine that has one into its own."""
        machines = tuple(
            machine if machine.governor is None else dataclasses.replace(machine, governor=change(machine.governor))
            for machine in self.machines
        )
        return dataclasses.replace(self, machines=machines)


def branch_admittances(branches: tuple[Branch, ...]) -> npt.NDArray[np.complex128]:
    """Return (y_ff, y_ft, y_tf, y_tt) of every branch, shape (n_branch, 4) [p.u.]."""
    rows = np.zeros((len(branches), 4), dtype=np.complex128)
    for row, branch in zip(rows, branches, strict=True):
        series = 1.0 / complex(branch.resistance, branch.reactance)
        own = series + 0.5j * branch.charging
        tap = branch.tap * complex(math.cos(branch.phase_rad), math.sin(branch.phase_rad))
        row[:] = own / abs(tap) ** 2, -series / tap.conjugate(), -series / tap, own
    return rows


@inlined
def _size(value: complex) -> float:
    """Return |Re| + |Im|: as good as the modulus to choose a pivot by, without its root."""
    return abs(value.real) + abs(value.imag)


@compiled
def eliminate(a: npt.NDArray) -> bool:  # type: ignore[type-arg]
    """Solve A x = b for several right-hand sides by Gaussian elimination with partial pivoting.

    `a` (n, n + m) is [A | b], and [… | x] on return. Returns False where A is singular. Ours rather than LAPACK's: the
    same bits whatever library, thread count or processor numpy was built for.
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
        for i in range(k + 1, n):
            if a[i, k] != 0.0:
                factor = a[i, k] * a[k, k]
                for j in range(k + 1, n_columns):
                    a[i, j] -= factor * a[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            if a[k, i] != 0.0:
                for j in range(n, n_columns):
                    a[k, j] -= a[k, i] * a[i, j]
        for j in range(n, n_columns):
            a[k, j] *= a[k, k]
    return True


def assemble_admittance(
    ends: npt.NDArray[np.int64], branch_y: npt.NDArray[np.complex128], bus_y: npt.NDArray[np.complex128]
) -> npt.NDArray[np.complex128]:
    """Return the bus admittance matrix (n_bus, n_bus) [p.u.] of closed branches plus `bus_y` on the diagonal.

    Args:
        ends: bus indices of each branch (n_branch, 2).
        branch_y: its admittances ff, ft, tf, tt (n_branch, 4) [p.u.].
        bus_y: (n_bus,) [p.u.].
    """
    y = np.diag(bus_y)
    for (start, end), own in zip(ends, branch_y, strict=True):
        y[[start, start, end, end], [start, end, start, end]] += own
    return y


class PowerFlow(NamedTuple):
    """Columns of a bus in a power flow."""

    power: int  # P + jQ into the network; Q counts only where no voltage is held [p.u.]
    polar: int  # magnitude [p.u.] and angle [rad]: start and result
    holds_voltage: int  # above 0.5 where it does; at the slack bus
    flow: int  # result: P + jQ from the bus into the branches [p.u.]
    voltage: int  # result [p.u.]


@compiled
def solve_power_flow(y: npt.NDArray[np.complex128], slack: int, buses: npt.NDArray[np.float64], at: PowerFlow) -> int:
    """Solve the power flow by Newton's method in polar form.

    Args:
        y: bus admittance matrix without loads (n_bus, n_bus) [p.u.].
        slack: index of the slack bus.
        buses: numbers of each bus (n_bus, n); a complex number takes two columns.
        at: the columns.

    Returns:
        iterations used, or -1 if the mismatch stays above POWER_FLOW_TOLERANCE.
    """
    n = y.shape[0]
    n_unknown = n - 1
    for k in range(n):
        if not buses[k, at.holds_voltage] > 0.5:
            n_unknown += 1
    # Sensitivities of the mismatches to the unknowns, and the mismatches: angles first, then magnitudes.
    a = np.empty((n_unknown, n_unknown + 1))
    turn = np.empty((n, n), dtype=np.complex128)
    for iteration in range(30):
        worst = _write_jacobian(a, turn, y, slack, buses, at)
        if worst < POWER_FLOW_TOLERANCE:
            note_flow(y, buses, at)
            return iteration
        if not math.isfinite(worst) or not eliminate(a):
            return -1
        row = n - 1
        for k in range(n):
            if k != slack:
                buses[k, at.polar + 1] += a[k - 1 if k > slack else k, n_unknown]
            if not buses[k, at.holds_voltage] > 0.5:
                buses[k, at.polar] += a[row, n_unknown]
                row += 1
    return -1


@internal
def _write_jacobian(
    a: npt.NDArray[np.float64],
    turn: npt.NDArray[np.complex128],
    y: npt.NDArray[np.complex128],
    slack: int,
    buses: npt.NDArray[np.float64],
    at: PowerFlow,
) -> float:
    """Write sensitivities and mismatches of :func:`solve_power_flow` to `a`; return the largest mismatch [p.u.]."""
    n, n_unknown = y.shape[0], a.shape[0]
    worst, q_row = 0.0, n - 1
    a[:] = 0.0
    for i in range(n):
        p_row = i - 1 if i > slack else i
        sum_re, sum_im, own, size = 0.0, 0.0, 0j, buses[i, at.polar]
        holds, m_col = buses[i, at.holds_voltage] > 0.5, n - 1
        own_m = -1
        for j in range(n):
            # Sine and cosine of a pair of buses serve both ways round.
            if j > i and (y[i, j] != 0.0 or y[j, i] != 0.0):
                d = buses[i, at.polar + 1] - buses[j, at.polar + 1]
                turn[i, j] = complex(math.cos(d), math.sin(d))
                turn[j, i] = turn[i, j].conjugate()
            turned = turn[i, j] if j != i else 1.0 + 0j
            varies = not buses[j, at.holds_voltage] > 0.5
            if y[i, j] != 0.0:
                other = buses[j, at.polar]
                s = size * other * y[i, j].conjugate() * turned
                sum_re, sum_im = sum_re + s.real, sum_im + s.imag
                if j != i:
                    a_col = j - 1 if j > slack else j
                    if i != slack and j != slack:
                        a[p_row, a_col] += s.imag
                    if not holds and j != slack:
                        a[q_row, a_col] -= s.real
                    if i != slack and varies:
                        a[p_row, m_col] += s.real / other
                    if not holds and varies:
                        a[q_row, m_col] += s.imag / other
            if j == i:
                own, own_m = size**2 * y[i, i].conjugate(), m_col
            if varies:
                m_col += 1
        if i != slack:
            a[p_row, p_row] += own.imag - sum_im
            if not holds:
                a[p_row, own_m] += (sum_re + own.real) / size
            a[p_row, n_unknown] = buses[i, at.power] - sum_re
            worst = max(worst, abs(buses[i, at.power] - sum_re))
        if not holds:
            if i != slack:
                a[q_row, p_row] += sum_re - own.real
            a[q_row, own_m] += (sum_im + own.imag) / size
            a[q_row, n_unknown] = buses[i, at.power + 1] - sum_im
            worst = max(worst, abs(buses[i, at.power + 1] - sum_im))
            q_row += 1
    return worst


@inlined
def note_flow(y: npt.NDArray[np.complex128], buses: npt.NDArray[np.float64], at: PowerFlow) -> None:
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
