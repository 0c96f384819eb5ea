"""Explicit Runge-Kutta methods, and DOP853, on the simulator's own right-hand side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.dynamics import derivatives
from wtg_gym.physics.integration import apply_network_changes, enter_interval
from wtg_gym.physics.lane_data import LaneData
from wtg_gym.physics.layout import LANE, Floats, Lanes, Layout, rows_of
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.plant_constants import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.ranges import whole_steps

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
        self.limits = _state_bounds(self.plant, layout)
        self.n_intervals = whole_steps("duration_s", scenario.duration_s, CONTROL_DT, "control step")

    def advance_explicit(self, method: Method) -> None:
        """Advance by one control interval with a fixed step."""
        tableau = np.array(method.a), np.array(method.b), np.array(method.c)
        _advance_interval(self.block, self.plant, self.data, tableau, self.rows, self.limits, self.simulator.lanes)

    def advance_exactly(self, tightening: float) -> None:
        """Advance by one control interval with DOP853, at a share of its tolerances."""
        _begin_interval(self.block, self.plant, self.data, self.simulator.lanes)

        def rates(at: float, state: Floats) -> Floats:
            return _evaluate(self.block, self.plant, at / CONTROL_DT, state, self.rows, self.simulator.lanes)

        tolerance = {"rtol": tightening * RTOL, "atol": tightening * ATOL}
        done = solve_ivp(rates, (0.0, CONTROL_DT), self.block[self.states], method="DOP853", **tolerance)
        self.block[self.states] = np.clip(done.y[:, -1], *self.limits)
        self.block[self.simulator.layout.lane("step")] += self.plant.n_substeps

    def sample(self) -> Floats:
        """Return frequency, rotor speed and power of every group at the interval's end, (n_wtg, 3) [p.u.]."""
        _evaluate(self.block, self.plant, 1.0, self.block[self.states].copy(), self.rows, self.simulator.lanes)
        names = ("speed", "rotor_speed", "power")
        return np.stack([self.simulator.wtg_values(name)[0] for name in names], axis=1)


def _state_bounds(plant: Plant, layout: Layout) -> tuple[Floats, Floats]:
    """Return the non-windup limits of every state, (n,) each."""
    low, high = np.full(layout.n_rows, -np.inf), np.full(layout.n_rows, np.inf)
    machines, turbine = plant.constants["machines"][0], plant.constants["turbine"][0]
    for name, limit in (("field_voltage", "exciter.field"), ("gate", "governor.gate")):
        rows = layout.machine(name)
        low[rows], high[rows] = machines[f"{limit}_min"], machines[f"{limit}_max"]
    for name in ("pitch_integral", "pitch"):
        low[layout.wtg(name)], high[layout.wtg(name)] = 0.0, turbine["pitch.angle_max"]
    return low[layout.state_rows], high[layout.state_rows]


@compiled
def _evaluate(
    block: Floats, plant: Plant, fraction: float, state: Floats, rows: tuple[Rows, Rows], lanes: Lanes
) -> Floats:
    """Return the time derivatives of a state at a place in the control interval, 0 … 1."""
    states, rates = rows
    for r in range(states.size):
        block[states[r]] = state[r]
    derivatives(block, plant.constants[0], fraction, lanes)
    result = np.empty(rates.size)
    for r in range(rates.size):
        result[r] = block[rates[r]]
    return result


@compiled
def _begin_interval(block: Floats, plant: Plant, data: LaneData, lanes: Lanes) -> None:
    """Put wind, noise and network of a one-lane block into force at the beginning of a control interval."""
    noise_y = np.empty(1)
    enter_interval(block, 0, plant.constants[0], data, noise_y, lanes)
    apply_network_changes(block, 0, plant, data, noise_y, lanes)


@compiled
def _advance_interval(
    block: Floats,
    plant: Plant,
    data: LaneData,
    tableau: tuple[Floats, Floats, Floats],
    rows: tuple[Rows, Rows],
    limits: tuple[Floats, Floats],
    lanes: Lanes,
) -> None:
    """Advance a one-lane block by one control interval; the network may change at its start only."""
    (a, b, c), (states, rates), (low, high) = tableau, rows, limits
    constants = plant.constants[0]
    own = rows_of(constants).lane + LANE.step
    _begin_interval(block, plant, data, lanes)
    h, part = constants["simulation_dt"], 1.0 / constants["n_substeps"]
    n, n_stages = states.size, b.size
    base, slopes = np.empty(n), np.empty((n_stages, n))
    for step in range(constants["n_substeps"]):
        for r in range(n):
            base[r] = block[states[r]]
        for stage in range(n_stages):
            for r in range(n):
                ahead = 0.0
                for earlier in range(stage):
                    ahead += a[stage, earlier] * slopes[earlier, r]
                block[states[r]] = base[r] + h * ahead
            derivatives(block, constants, (step + c[stage]) * part, lanes)
            for r in range(n):
                slopes[stage, r] = block[rates[r]]
        for r in range(n):
            total = 0.0
            for stage in range(n_stages):
                total += b[stage] * slopes[stage, r]
            block[states[r]] = min(max(base[r] + h * total, low[r]), high[r])
        block[own] += 1.0
