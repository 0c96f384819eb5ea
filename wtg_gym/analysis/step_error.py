"""What a fixed step costs and what it is worth: explicit methods against a tight integration of the same equations.

Each scenario is integrated with scipy's DOP853 at rtol 1e-10, restarted wherever wind, noise or network change, and
then with every method and step. The equations are the simulator's own kernels in all of them.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
from wtg_gym.physics.scenario import LoadRamp, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.synchronous_machine import MachineConstant, SyncState
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, TrackingLaw
from wtg_gym.physics.wind_turbine import TurbineConstant, WtgState
from wtg_gym.scenarios import get_suite

#: Steps of the study [s]; each divides the control interval.
STEPS = (0.0025, 0.005, 0.01, 0.02, 0.025, 0.04)
#: Control interval of the study: 0.1 s is not a whole number of steps of 40 ms [s].
CONTROL_DT = 0.2
RTOL, ATOL = 1e-10, 1e-12
#: Scenarios over which the reference is held against a tighter one.
_N_REFERENCE = 10


@dataclass(frozen=True)
class Method:
    """An explicit Runge-Kutta method by its Butcher tableau: `a` (s, s), `b` (s,), `c` (s,)."""

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]

    @property
    def n_stages(self) -> int:
        """Evaluations of the right-hand side per step."""
        return len(self.b)


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


@dataclass(frozen=True)
class Accuracy:
    """Errors and cost of one method at one step.

    Args:
        method: name.
        order: its order.
        step_s: [s].
        evaluations_per_s: right-hand sides per simulated second.
        microseconds_per_s: measured time per simulated second, one environment [µs].
        frequency_hz, rotor_speed_pu, power_pu: largest error of any WTG over a scenario, (n_scenarios,) [Hz, p.u.];
            infinite where the method did not stay finite.
    """

    method: str
    order: int
    step_s: float
    evaluations_per_s: float
    microseconds_per_s: float
    frequency_hz: Floats
    rotor_speed_pu: Floats
    power_pu: Floats


@dataclass(frozen=True)
class AccuracyStudy:
    """The curve: one :class:`Accuracy` per method and step, over the `seeds` of a suite.

    `reference_error_hz` is what the frequency of DOP853 changes by when rtol falls a hundredfold, at most over the
    first scenarios [Hz]. `smooth_order` is each method's order of convergence on a case whose right-hand side is
    smooth, from 10 to 5 ms.
    """

    suite: str
    seeds: tuple[int, ...]
    rows: tuple[Accuracy, ...]
    smooth_order: Mapping[str, float]
    reference_error_hz: float
    default_step_s: float

    def row(self, method: str, step_s: float) -> Accuracy:
        """Return the row of a method and a step [s]."""
        return next(row for row in self.rows if row.method == method and abs(row.step_s - step_s) < 1e-12)

    def observed_order(self, method: str) -> float:
        """Return the order seen in the median frequency error between 5 and 20 ms."""
        coarse, fine = (float(np.median(self.row(method, step).frequency_hz)) for step in (0.02, 0.005))
        return float(np.log2(coarse / fine) / 2.0)


def study_accuracy(
    n_scenarios: int = 100,
    *,
    suite: str = "standard",
    methods: Sequence[Method] = METHODS,
    steps: Sequence[float] = STEPS,
    law: TrackingLaw | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> AccuracyStudy:
    """Integrate random scenarios with every method and step, and compare with DOP853.

    Args:
        n_scenarios: how many validation scenarios of the suite, 1 or more.
        suite: name of the suite.
        methods, steps: what to try; steps divide 0.2 s [s].
        law: the strategy; the reference by default.
        on_progress: called with (scenarios done, scenarios in all).

    Raises:
        ValueError: an argument is out of range.
    """
    source = get_suite(suite)
    if not 1 <= n_scenarios <= len(source.validation):
        raise ValueError(
            f"the number of scenarios must be 1 … {len(source.validation)} (the validation seeds of {suite}), "
            f"got {n_scenarios}"
        )
    law = law or STRATEGIES[REFERENCE_STRATEGY]
    seeds = tuple(source.validation[:n_scenarios])
    errors: dict[tuple[str, float], list[Floats]] = {(m.name, h): [] for m in methods for h in steps}
    reference_error = 0.0
    for done, seed in enumerate(seeds):
        if on_progress is not None:
            on_progress(done, n_scenarios)
        scenario = on_the_grid(source.scenario(seed))
        exact = _samples(scenario, law)
        if done < _N_REFERENCE:
            tighter = _samples(scenario, law, tightening=0.01)
            reference_error = max(reference_error, float(np.abs(tighter - exact)[:, :, 0].max()))
        for method in methods:
            for step in steps:
                gap = np.abs(_samples(scenario, law, method, step) - exact)
                largest = np.where(np.isfinite(gap), gap, np.inf).max(axis=(0, 1))
                errors[method.name, step].append(largest)
    nominal = PlantSettings().case.frequency_hz
    rows = []
    scenario = on_the_grid(source.scenario(seeds[0]))
    for method in methods:
        for step in steps:
            table = np.array(errors[method.name, step])
            rows.append(
                Accuracy(
                    method.name,
                    method.order,
                    step,
                    method.n_stages / step,
                    _cost(scenario, law, method, step),
                    nominal * table[:, 0],
                    table[:, 1],
                    table[:, 2],
                )
            )
    orders = {method.name: smooth_order(method, law) for method in methods}
    return AccuracyStudy(suite, seeds, tuple(rows), orders, nominal * reference_error, PlantSettings().simulation_dt)


def smooth_order(method: Method, law: TrackingLaw, coarse_s: float = 0.01) -> float:
    """Return the order of convergence of a method after the paper's first load step, from a step to half of it.

    The frequency stays on one side of the corner of g(ω) then, and no limit binds: the right-hand side is smooth.
    """
    paper = get_suite("paper").scenario(0)
    scenario = dataclasses.replace(paper, events=paper.events[:1], duration_s=10.0)
    exact = _samples(scenario, law)[:, :, 0]
    errors = [np.abs(_samples(scenario, law, method, h)[:, :, 0] - exact).max() for h in (coarse_s, 0.5 * coarse_s)]
    return float(np.log2(errors[0] / errors[1]))


def on_the_grid(scenario: Scenario) -> Scenario:
    """Return a scenario with its events moved up to whole control intervals of the study, so that every step fits."""
    events = []
    for event in scenario.events:
        moved: dict[str, Any] = {"time_s": CONTROL_DT * np.ceil(event.time_s / CONTROL_DT - 1e-9)}
        if isinstance(event, LoadRamp):
            moved["duration_s"] = CONTROL_DT * max(1.0, np.ceil(event.duration_s / CONTROL_DT - 1e-9))
        events.append(dataclasses.replace(event, **moved))
    duration_s = CONTROL_DT * np.floor(scenario.duration_s / CONTROL_DT + 1e-9)
    return dataclasses.replace(scenario, events=tuple(events), duration_s=duration_s)


class _Integration:
    """One lane and its scenario, advanced interval by interval."""

    def __init__(self, scenario: Scenario, law: TrackingLaw, step_s: float) -> None:
        settings = PlantSettings(control_dt=CONTROL_DT, simulation_dt=step_s)
        self.simulator = Simulator(settings, duration_s=scenario.duration_s)
        self.simulator.start(0, scenario, (law,) * len(settings.groups))
        self.block, self.plant, self.data = self.simulator.blocks[0], self.simulator.plant, self.simulator.data
        layout = self.simulator.layout
        self.states, self.rates = layout.state_rows, layout.rate_rows
        self.low, self.high = _state_bounds(self.plant, self.states.size)
        self.step_s = step_s
        self.n_intervals = whole_steps("duration_s", scenario.duration_s, CONTROL_DT, "control step")

    def advance_explicit(self, method: Method) -> None:
        """Advance by one control interval with a fixed step."""
        tableau = np.array(method.a), np.array(method.b), np.array(method.c)
        _advance_interval(self.block, self.plant, self.data, *tableau, self.states, self.rates, self.low, self.high)

    def advance_exactly(self, tightening: float) -> None:
        """Advance by one control interval with DOP853, at a share of its tolerances.

        The network may change at the interval's start alone.
        """
        _begin_interval(self.block, self.plant, self.data)

        def rates(at: float, state: Floats) -> Floats:
            return _evaluate(self.block, self.plant, at / CONTROL_DT, state, self.states, self.rates)

        tolerance = {"rtol": tightening * RTOL, "atol": tightening * ATOL}
        done = solve_ivp(rates, (0.0, CONTROL_DT), self.block[self.states], method="DOP853", **tolerance)
        self.block[self.states] = np.clip(done.y[:, -1], self.low, self.high)
        self.block[self.simulator.layout.lane + LaneRow.STEP] += self.plant.n_substeps

    def sample(self) -> Floats:
        """Return frequency, rotor speed and power of every group at the interval's end, (n_wtg, 3) [p.u.]."""
        _evaluate(self.block, self.plant, 1.0, self.block[self.states].copy(), self.states, self.rates)
        rows = (WtgState.SPEED, WtgState.ROTOR_SPEED, WtgRow.POWER)
        return np.stack([self.simulator.wtg_values(row)[0] for row in rows], axis=1)


def _samples(
    scenario: Scenario,
    law: TrackingLaw,
    method: Method | None = None,
    step_s: float = 0.025,
    *,
    tightening: float = 1.0,
) -> Floats:
    """Return what a method finds at the ends of all intervals, (n, n_wtg, 3); None is DOP853."""
    run = _Integration(scenario, law, step_s)
    found = []
    for _ in range(run.n_intervals):
        if method is None:
            run.advance_exactly(tightening)
        else:
            run.advance_explicit(method)
        found.append(run.sample())
    return np.array(found)


def _cost(scenario: Scenario, law: TrackingLaw, method: Method, step_s: float, repeats: int = 5) -> float:
    """Return the least time per simulated second over some repeats [µs]."""
    best = np.inf
    for _ in range(repeats):
        run = _Integration(scenario, law, step_s)
        begin = time.perf_counter()
        for _ in range(run.n_intervals):
            run.advance_explicit(method)
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / scenario.duration_s


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
def _evaluate(
    block: Floats,
    plant: Plant,
    fraction: float,
    state: Floats,
    states: npt.NDArray[np.int64],
    rates: npt.NDArray[np.int64],
) -> Floats:
    """Return the time derivatives of a state at a place in the control interval, 0 … 1."""
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
    a: Floats,
    b: Floats,
    c: Floats,
    states: npt.NDArray[np.int64],
    rates: npt.NDArray[np.int64],
    low: Floats,
    high: Floats,
) -> None:
    """Advance a one-lane block by one control interval, at whose start alone the network may change."""
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


__all__ = ["METHODS", "STEPS", "Accuracy", "AccuracyStudy", "Method", "study_accuracy"]
