"""Explicit Runge-Kutta methods, and DOP853, on the simulator's own right-hand side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.dynamics import derivatives
from wtg_gym.physics.integration import apply_network_changes, enter_interval
from wtg_gym.physics.layout import (
    N_SYNC_STATES,
    N_WTG_STATES,
    Floats,
    LaneData,
    LaneRow,
    Plant,
    WtgRow,
    lane_row,
)
from wtg_gym.physics.plant import PlantSettings, whole_steps
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.synchronous_machine import MachineConstant, SyncState
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.wind_turbine import TurbineConstant, WtgState

Rows = npt.NDArray[np.int64]

#: Control interval: the usual 0.1 s is not a whole number of steps of 40 ms [s].
CONTROL_DT = 0.2
RTOL, ATOL = 1e-10, 1e-12
_LAW = STRATEGIES[REFERENCE_STRATEGY]


class Method(NamedTuple):
    """An explicit Runge-Kutta method by its order and Butcher tableau: `a` (s, s), `b` (s,), `c` (s,)."""

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]


#: Source: E. Hairer, S. P. Nørsett, G. Wanner: Solving Ordinary Differential Equations I, section II.1.
METHODS = (
    Method("Euler", 1, ((0.0,),), (1.0,), (0.0,)),
    Method("Heun", 2, ((0.0, 0.0), (1.0, 0.0)), (0.5, 0.5), (0.0, 1.0)),
    Method(
        "Kutta 3",
        3,
        ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-1.0, 2.0, 0.0)),
        (1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0),
        (0.0, 0.5, 1.0),
    ),
    Method(
        "RK4",
        4,
        ((0.0, 0.0, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0), (0.0, 0.5, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
        (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0),
        (0.0, 0.5, 0.5, 1.0),
    ),
)


class Integration:
    """One lane and its scenario, advanced interval by interval."""

    def __init__(self, scenario: Scenario, step_s: float) -> None:
        settings = PlantSettings(control_dt=CONTROL_DT, simulation_dt=step_s)
        self.simulator = Simulator(settings, duration_s=scenario.duration_s)
        self.simulator.start(0, scenario, (_LAW,) * len(settings.groups))
        self.block, self.plant, self.data = self.simulator.blocks[0], self.simulator.plant, self.simulator.data
        layout = self.simulator.layout
        self.states = layout.state_rows
        self.rows = layout.state_rows, layout.rate_rows
        self.limits = _state_bounds(self.plant, self.states.size)
        self.n_intervals = whole_steps("duration_s", scenario.duration_s, CONTROL_DT, "control step")

    def advance_explicit(self, method: Method) -> None:
        """Advance by one control interval with a fixed step."""
        tableau = np.array(method.a), np.array(method.b), np.array(method.c)
        _advance_interval(self.block, self.plant, self.data, tableau, self.rows, self.limits)

    def advance_exactly(self, tightening: float) -> None:
        """Advance by one control interval with DOP853, at a share of its tolerances."""
        _begin_interval(self.block, self.plant, self.data)

        def rates(at: float, state: Floats) -> Floats:
            return _evaluate(self.block, self.plant, at / CONTROL_DT, state, self.rows)

        tolerance = {"rtol": tightening * RTOL, "atol": tightening * ATOL}
        done = solve_ivp(rates, (0.0, CONTROL_DT), self.block[self.states], method="DOP853", **tolerance)
        self.block[self.states] = np.clip(done.y[:, -1], *self.limits)
        self.block[self.simulator.layout.lane + LaneRow.STEP] += self.plant.n_substeps

    def sample(self) -> Floats:
        """Return frequency, rotor speed and power of every group at the interval's end, (n_wtg, 3) [p.u.]."""
        _evaluate(self.block, self.plant, 1.0, self.block[self.states].copy(), self.rows)
        rows = (WtgState.SPEED, WtgState.ROTOR_SPEED, WtgRow.POWER)
        return np.stack([self.simulator.wtg_values(row)[0] for row in rows], axis=1)


def _state_bounds(plant: Plant, n: int) -> tuple[Floats, Floats]:
    """Return the non-windup limits of every state, (n,) each."""
    low, high = np.full(n, -np.inf), np.full(n, np.inf)
    for i, machine in enumerate(plant.machines):
        at = i * N_SYNC_STATES
        low[at + SyncState.FIELD_VOLTAGE] = machine[MachineConstant.FIELD_MIN]
        high[at + SyncState.FIELD_VOLTAGE] = machine[MachineConstant.FIELD_MAX]
        low[at + SyncState.GATE], high[at + SyncState.GATE] = (
            machine[MachineConstant.GATE_MIN],
            machine[MachineConstant.GATE_MAX],
        )
    for j in range(plant.share.size):
        for state in (WtgState.PITCH_INTEGRAL, WtgState.PITCH):
            at = len(plant.syncs) * N_SYNC_STATES + j * N_WTG_STATES + state
            low[at], high[at] = 0.0, plant.turbine[TurbineConstant.PITCH_MAX]
    return low, high


@compiled
def _evaluate(block: Floats, plant: Plant, fraction: float, state: Floats, rows: tuple[Rows, Rows]) -> Floats:
    """Return the time derivatives of a state at a place in the control interval, 0 … 1."""
    states, rates = rows
    for r in range(states.size):
        block[states[r]] = state[r]
    derivatives(block, plant, fraction, (0,))
    result = np.empty(rates.size)
    for r in range(rates.size):
        result[r] = block[rates[r]]
    return result


@compiled
def _begin_interval(block: Floats, plant: Plant, data: LaneData) -> None:
    """Put wind, noise and network of a one-lane block into force at the beginning of a control interval."""
    noise_y = np.empty(1)
    enter_interval(block, 0, plant, data, noise_y, (0,))
    apply_network_changes(block, 0, plant, data, noise_y, (0,))


@compiled
def _advance_interval(
    block: Floats,
    plant: Plant,
    data: LaneData,
    tableau: tuple[Floats, Floats, Floats],
    rows: tuple[Rows, Rows],
    limits: tuple[Floats, Floats],
) -> None:
    """Advance a one-lane block by one control interval; the network may change at its start only."""
    (a, b, c), (states, rates), (low, high) = tableau, rows, limits
    own = lane_row(plant) + LaneRow.STEP
    _begin_interval(block, plant, data)
    h, part = plant.simulation_dt, 1.0 / plant.n_substeps
    n, n_stages = states.size, b.size
    base, slopes = np.empty(n), np.empty((n_stages, n))
    for step in range(plant.n_substeps):
        for r in range(n):
            base[r] = block[states[r]]
        for stage in range(n_stages):
            for r in range(n):
                ahead = 0.0
                for earlier in range(stage):
                    ahead += a[stage, earlier] * slopes[earlier, r]
                block[states[r]] = base[r] + h * ahead
            derivatives(block, plant, (step + c[stage]) * part, (0,))
            for r in range(n):
                slopes[stage, r] = block[rates[r]]
        for r in range(n):
            total = 0.0
            for stage in range(n_stages):
                total += b[stage] * slopes[stage, r]
            block[states[r]] = min(max(base[r] + h * total, low[r]), high[r])
        block[own] += 1.0
