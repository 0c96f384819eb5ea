"""Networks as data, admittances, power flow and transfer impedances.

Everything here is dense and small: the kernels solve a 14-bus system in microseconds and allocate only on resets and
network events.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.checked import Checked, parameter, required
from wtg_gym.physics.machine_parameters import GovernorParameters, HydroGovernorParameters, SynchronousMachineParameters
from wtg_gym.systems.compiled import compiled, inlined, internal

#: Largest power mismatch accepted as a power-flow solution [p.u.].
POWER_FLOW_TOLERANCE = 1e-12


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
class NetworkCase(Checked):
    """A network with its synchronous machines, as data.

    The voltage angle at `slack_bus` is zero, and its machines balance the power; there must be one at least.

    Raises:
        ValueError: a bus is missing, doubled or not connected, nothing balances the power, or a value is out of range.
    """

    name: str
    base_mva: float = required("MVA", "IEEE 14", "system base", 1e-3, 1e9)
    frequency_hz: float = required("Hz", "IEEE 14", "nominal frequency", 1.0, 1000.0)
    slack_bus: int
    buses: tuple[Bus, ...]
    branches: tuple[Branch, ...]
    machines: tuple[SynchronousMachineParameters, ...]

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
        for machine in self.machines:
            self.bus_index(machine.bus)
        if not any(machine.bus == self.slack_bus for machine in self.machines):
            raise ValueError(
                f"{self.name}: no synchronous machine at the slack bus {self.slack_bus} balances the power"
            )
        if not self.connected_without(()):
            raise ValueError(f"{self.name}: the network is not connected")
        if self.buses[self.bus_index(self.slack_bus)].voltage_pu is None:
            raise ValueError(f"{self.name}: the slack bus {self.slack_bus} must hold a voltage; its voltage_pu is None")

    @functools.cached_property
    def bus_numbers(self) -> tuple[int, ...]:
        """Return the bus numbers in order of the index."""
        return tuple(bus.number for bus in self.buses)

    @functools.cached_property
    def load_mw(self) -> float:
        """Load of all buses [MW]."""
        return sum(bus.load_mw for bus in self.buses)

    def bus_index(self, number: int) -> int:
        """Return the index of a bus number; a ValueError lists the buses there are."""
        if isinstance(number, bool) or number not in self.bus_numbers:
            raise ValueError(f"unknown bus {number!r}; {self.name} has buses {list(self.bus_numbers)}")
        return self.bus_numbers.index(number)

    def branch_index(self, from_bus: int, to_bus: int) -> int:
        """Return the index of the branch between two buses, either way round; a ValueError lists the branches."""
        self.bus_index(from_bus)
        self.bus_index(to_bus)
        index = self._branches_by_ends.get(frozenset((from_bus, to_bus)))
        if index is not None:
            return index
        known = ", ".join(f"{b.from_bus}-{b.to_bus}" for b in self.branches)
        raise ValueError(f"no branch {from_bus}-{to_bus} in {self.name}; branches: {known}")

    @functools.cached_property
    def _branches_by_ends(self) -> dict[frozenset[int], int]:
        # Of parallel branches the first one counts: it comes last here.
        return {frozenset((b.from_bus, b.to_bus)): i for i, b in reversed(list(enumerate(self.branches)))}

    def connected_without(self, branches: tuple[int, ...]) -> bool:
        """Return whether every bus stays connected when the branches of these indices are open."""
        links = [{b.from_bus, b.to_bus} for i, b in enumerate(self.branches) if i not in branches]
        reached, n_before = {self.buses[0].number}, 0
        while len(reached) > n_before:
            n_before = len(reached)
            for link in links:
                if not reached.isdisjoint(link):
                    reached |= link
        return len(reached) == len(self.buses)

    @functools.cached_property
    def bridges(self) -> frozenset[int]:
        """Return the indices of the branches any one of which splits the network when it opens."""
        return frozenset(index for index in range(len(self.branches)) if not self.connected_without((index,)))

    def with_governors(
        self,
        change: Callable[[GovernorParameters | HydroGovernorParameters], GovernorParameters | HydroGovernorParameters],
    ) -> NetworkCase:
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
def solve_in_place(a: npt.NDArray, b: npt.NDArray) -> bool:  # type: ignore[type-arg]
    """Solve a x = b for several right-hand sides by Gaussian elimination with partial pivoting, x in b.

    `a` (n, n) is destroyed, `b` (n, m) overwritten. Returns False where a is singular. Ours rather than LAPACK's: the
    same bits whatever library, thread count or processor numpy was built for.
    """
    n, m = b.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if _size(a[i, k]) > _size(a[pivot, k]):
                pivot = i
        if not _size(a[pivot, k]) > 1e-14:
            return False
        if pivot != k:
            for j in range(k, n):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            for j in range(m):
                b[k, j], b[pivot, j] = b[pivot, j], b[k, j]
        a[k, k] = 1.0 / a[k, k]
        for i in range(k + 1, n):
            if a[i, k] != 0.0:
                factor = a[i, k] * a[k, k]
                for j in range(k + 1, n):
                    a[i, j] -= factor * a[k, j]
                for j in range(m):
                    b[i, j] -= factor * b[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            if a[k, i] != 0.0:
                for j in range(m):
                    b[k, j] -= a[k, i] * b[i, j]
        for j in range(m):
            b[k, j] *= a[k, k]
    return True


@compiled
def assemble_admittance(
    branches: npt.NDArray[np.void], open_branch: npt.NDArray[np.bool_], bus_y: npt.NDArray[np.complex128]
) -> npt.NDArray[np.complex128]:
    """Return the bus admittance matrix (n_bus, n_bus) [p.u.] of the closed branches plus `bus_y` on the diagonal.

    `branches` (n_branch,) are of :class:`~wtg_gym.physics.kernel_data.BranchConstants`.
    """
    n = bus_y.shape[0]
    y = np.zeros((n, n), dtype=np.complex128)
    for k in range(n):
        y[k, k] = bus_y[k]
    for b in range(branches.shape[0]):
        if not open_branch[b]:
            branch = branches[b]
            i, j = branch["start"], branch["end"]
            y[i, i] += branch["y_ff"]
            y[i, j] += branch["y_ft"]
            y[j, i] += branch["y_tf"]
            y[j, j] += branch["y_tt"]
    return y


@internal
def _number_unknowns(slack: int, holds_voltage: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.int64], int]:
    """Return the places of each bus's angle and magnitude among the unknowns, (2, n_bus) or -1, and their number."""
    n = holds_voltage.shape[0]
    unknown = np.full((2, n), -1, dtype=np.int64)
    n_unknown = 0
    for k in range(n):
        if k != slack:
            unknown[0, k] = n_unknown
            n_unknown += 1
    for k in range(n):
        if not holds_voltage[k]:
            unknown[1, k] = n_unknown
            n_unknown += 1
    return unknown, n_unknown


@compiled
def solve_power_flow(
    y: npt.NDArray[np.complex128],
    slack: int,
    holds_voltage: npt.NDArray[np.bool_],
    power: npt.NDArray[np.complex128],
    magnitude: npt.NDArray[np.float64],
    angle: npt.NDArray[np.float64],
) -> int:
    """Solve the power flow by Newton's method in polar form.

    Args:
        y: bus admittance matrix without loads (n_bus, n_bus) [p.u.].
        slack: index of the slack bus.
        holds_voltage: whether a bus holds its voltage (n_bus); true for the slack bus.
        power: net injection P + jQ per bus (n_bus) [p.u.]; Q counts only where no voltage is held.
        magnitude, angle: start and result (n_bus) [p.u., rad].

    Returns:
        iterations used, or -1 if the mismatch stays above POWER_FLOW_TOLERANCE.
    """
    n = y.shape[0]
    unknown, n_unknown = _number_unknowns(slack, holds_voltage)
    jacobian = np.empty((n_unknown, n_unknown))
    mismatch = np.empty((n_unknown, 1))
    flow = np.empty(n, dtype=np.complex128)
    turn = np.ones((n, n), dtype=np.complex128)
    for iteration in range(30):
        worst = 0.0
        jacobian[:, :] = 0.0
        for i in range(n):
            flow[i] = 0.0
            for j in range(n):
                # Sine and cosine of a pair of buses serve both ways round.
                if j > i and (y[i, j] != 0.0 or y[j, i] != 0.0):
                    d = angle[i] - angle[j]
                    turn[i, j] = complex(math.cos(d), math.sin(d))
                    turn[j, i] = turn[i, j].conjugate()
                if y[i, j] != 0.0:
                    s = magnitude[i] * magnitude[j] * y[i, j].conjugate() * turn[i, j]
                    flow[i] += s
                    if j != i:
                        _add_jacobian(jacobian, unknown, i, j, s.imag, -s.real, s.real, s.imag, magnitude[j])
        for i in range(n):
            own = magnitude[i] ** 2 * y[i, i].conjugate()
            p, q = flow[i].real, flow[i].imag
            _add_jacobian(
                jacobian, unknown, i, i, -q + own.imag, p - own.real, p + own.real, q + own.imag, magnitude[i]
            )
            if unknown[0, i] >= 0:
                mismatch[unknown[0, i], 0] = power[i].real - p
                worst = max(worst, abs(power[i].real - p))
            if unknown[1, i] >= 0:
                mismatch[unknown[1, i], 0] = power[i].imag - q
                worst = max(worst, abs(power[i].imag - q))
        if worst < POWER_FLOW_TOLERANCE:
            return iteration
        if not math.isfinite(worst) or not solve_in_place(jacobian, mismatch):
            return -1
        for k in range(n):
            if unknown[0, k] >= 0:
                angle[k] += mismatch[unknown[0, k], 0]
            if unknown[1, k] >= 0:
                magnitude[k] += mismatch[unknown[1, k], 0]
    return -1


@internal
def _add_jacobian(
    jacobian: npt.NDArray[np.float64],
    unknown: npt.NDArray[np.int64],
    i: int,
    j: int,
    dp_da: float,
    dq_da: float,
    dp_dm: float,
    dq_dm: float,
    magnitude: float,
) -> None:
    """Put the sensitivities of bus i to angle [rad] and magnitude (times itself) of bus j into the Jacobian."""
    p_row, q_row = unknown[0, i], unknown[1, i]
    a_col, m_col = unknown[0, j], unknown[1, j]
    if p_row >= 0 and a_col >= 0:
        jacobian[p_row, a_col] += dp_da
    if q_row >= 0 and a_col >= 0:
        jacobian[q_row, a_col] += dq_da
    if p_row >= 0 and m_col >= 0:
        jacobian[p_row, m_col] += dp_dm / magnitude
    if q_row >= 0 and m_col >= 0:
        jacobian[q_row, m_col] += dq_dm / magnitude


@internal
def transfer_impedances(
    y: npt.NDArray[np.complex128], unit_bus: npt.NDArray[np.int64], extra_bus: int
) -> npt.NDArray[np.complex128]:
    """Return columns of the bus impedance matrix [p.u.]: of the units' buses, then `extra_bus`; (n_bus, n_unit + 1)."""
    n, n_unit = y.shape[0], unit_bus.shape[0]
    z = np.zeros((n, n_unit + 1), dtype=np.complex128)
    for i in range(n_unit):
        z[unit_bus[i], i] = 1.0
    z[extra_bus, n_unit] = 1.0
    solve_in_place(y, z)
    return z
