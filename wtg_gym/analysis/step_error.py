"""The error and the cost of an integration step: explicit methods against an almost exact integration.

Each scenario is integrated with scipy's DOP853 at rtol 1e-10, restarted wherever wind, noise or network change, and
then with every method and step. The equations are the simulator's own kernels in all of them.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wtg_gym.analysis.explicit_methods import CONTROL_DT, METHODS, Integration, Method
from wtg_gym.files import markdown_table
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import LineTrip, LoadRamp, Scenario
from wtg_gym.scenarios import get_suite

#: Steps of the study [s]; each divides the control interval.
STEPS = (0.0025, 0.005, 0.01, 0.02, 0.025, 0.04)
ACCURACY_COLUMNS = ("method", "step [ms]", "time per s [µs]", "frequency [Hz]", "rotor speed [p.u.]", "power [p.u.]")
#: Least step of the table [s]; figure and file have all.
_LEAST_SHOWN_S = 0.01
#: Scenarios in which the reference is compared with a tighter one.
_N_REFERENCE = 10


@dataclass(frozen=True)
class Accuracy:
    """Errors and cost of one method at one step."""

    #: method, order: its name and order.
    method: str
    order: int
    step_s: float  # [s]
    evaluations_per_s: float  # right-hand sides per simulated second
    microseconds_per_s: float  # measured time per simulated second, one environment [µs]
    #: frequency_hz, rotor_speed_pu, power_pu: largest error of any WTG over a scenario, (n_scenarios,) [Hz, p.u.];
    #: infinite where the method did not stay finite.
    frequency_hz: Floats
    rotor_speed_pu: Floats
    power_pu: Floats


@dataclass(frozen=True)
class AccuracyStudy:
    """One :class:`Accuracy` per method and step, over the `seeds` of a suite.

    `smooth_order` is each method's order of convergence on a case whose right-hand side is smooth, from 10 to 5 ms.
    `reference_error_hz` is the largest change of the frequency of DOP853 when rtol falls a hundredfold [Hz].
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
    on_progress: Callable[[str, int, int], None] = lambda *_: None,
) -> AccuracyStudy:
    """Integrate random scenarios under the reference strategy with every method and step, and compare with DOP853.

    Args:
        n_scenarios: how many validation scenarios of the suite, 1 or more.
        suite: name of the suite.
        methods, steps: those to try; steps divide 0.2 s [s].
        on_progress: called with ("integrating", scenarios done, scenarios in all).

    Raises:
        ValueError: an argument is out of range.
    """
    source = get_suite(suite)
    if not 1 <= n_scenarios <= len(source.validation):
        raise ValueError(
            f"the number of scenarios must be 1 … {len(source.validation)} (the validation seeds of {suite}), "
            f"got {n_scenarios}"
        )
    seeds = tuple(source.validation[:n_scenarios])
    scenarios = [on_the_grid(source.scenario(seed)) for seed in seeds]
    errors: dict[tuple[str, float], list[Floats]] = {(m.name, h): [] for m in methods for h in steps}
    reference_error = 0.0
    for done, scenario in enumerate(scenarios):
        on_progress("integrating", done, n_scenarios)
        exact = _samples(scenario)
        if done < _N_REFERENCE:
            tighter = _samples(scenario, tightening=0.01)
            reference_error = max(reference_error, float(np.abs(tighter - exact)[:, :, 0].max()))
        for method in methods:
            for step in steps:
                gap = np.abs(_samples(scenario, method, step) - exact)
                errors[method.name, step].append(np.where(np.isfinite(gap), gap, np.inf).max(axis=(0, 1)))
    nominal = PlantSettings().case.frequency_hz
    rows = []
    for method in methods:
        for step in steps:
            frequency, rotor, power = np.array(errors[method.name, step]).T
            cost = _cost(scenarios[0], method, step)
            evaluations = len(method.b) / step
            rows.append(Accuracy(method.name, method.order, step, evaluations, cost, nominal * frequency, rotor, power))
    orders = {method.name: smooth_order(method) for method in methods}
    return AccuracyStudy(suite, seeds, tuple(rows), orders, nominal * reference_error, PlantSettings().simulation_dt)


def smooth_order(method: Method, coarse_s: float = 0.01) -> float:
    """Return the order of convergence of a method after the paper's first load step, from a step to half of it.

    The frequency stays on one side of the corner of g(ω) then, and no limit binds: the right-hand side is smooth.
    """
    paper = get_suite("paper").scenario(0)
    scenario = dataclasses.replace(paper, events=paper.events[:1], duration_s=10.0)
    exact = _samples(scenario)[:, :, 0]
    errors = [np.abs(_samples(scenario, method, h)[:, :, 0] - exact).max() for h in (coarse_s, 0.5 * coarse_s)]
    return float(np.log2(errors[0] / errors[1]))


def on_the_grid(scenario: Scenario) -> Scenario:
    """Return a scenario with its events moved up to whole control intervals of the study, so that every step fits."""
    events = []
    for event in scenario.events:
        moved: dict[str, Any] = {"time_s": CONTROL_DT * np.ceil(event.time_s / CONTROL_DT - 1e-9)}
        if isinstance(event, LoadRamp):
            moved["duration_s"] = CONTROL_DT * max(1.0, np.ceil(event.duration_s / CONTROL_DT - 1e-9))
        if isinstance(event, LineTrip) and event.recloses_after_s is not None:
            moved["recloses_after_s"] = CONTROL_DT * np.ceil(event.recloses_after_s / CONTROL_DT - 1e-9)
        events.append(dataclasses.replace(event, **moved))
    duration_s = CONTROL_DT * np.floor(scenario.duration_s / CONTROL_DT + 1e-9)
    return dataclasses.replace(scenario, events=tuple(events), duration_s=duration_s)


def _samples(
    scenario: Scenario, method: Method | None = None, step_s: float = 0.025, *, tightening: float = 1.0
) -> Floats:
    """Return the samples at the ends of all intervals, (n, n_wtg, 3), by a method; None for DOP853."""
    run = Integration(scenario, step_s)
    found = []
    for _ in range(run.n_intervals):
        if method is None:
            run.advance_exactly(tightening)
        else:
            run.advance_explicit(method)
        found.append(run.sample())
    return np.array(found)


def _cost(scenario: Scenario, method: Method, step_s: float, repeats: int = 5) -> float:
    """Return the least time per simulated second over some repeats [µs]."""
    best = np.inf
    for _ in range(repeats):
        run = Integration(scenario, step_s)
        begin = time.perf_counter()
        for _ in range(run.n_intervals):
            run.advance_explicit(method)
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / scenario.duration_s


def accuracy_table(study: AccuracyStudy) -> str:
    """Return error and cost of every method in Markdown, from 10 ms on; the default step in bold."""
    rows = []
    for row in study.rows:
        if row.step_s < _LEAST_SHOWN_S:
            continue
        chosen = row.method == "RK4" and math.isclose(row.step_s, study.default_step_s)
        rows.append(tuple(f"**{cell}**" if chosen else cell for cell in accuracy_cells(row)))
    return markdown_table(ACCURACY_COLUMNS, rows, right=(1, 2))


def accuracy_cells(row: Accuracy) -> tuple[str, ...]:
    """Return a method's cost and errors as text, in the order of :data:`ACCURACY_COLUMNS`."""
    errors = (row.frequency_hz, row.rotor_speed_pu, row.power_pu)
    return row.method, f"{1e3 * row.step_s:g}", f"{row.microseconds_per_s:.0f}", *map(_median_and_worst, errors)


def _median_and_worst(errors: Floats) -> str:
    return " / ".join(
        f"{value:.1e}" if math.isfinite(value) else "diverges" for value in (float(np.median(errors)), errors.max())
    )


def order_table(study: AccuracyStudy) -> str:
    """Return the order of convergence of every method in Markdown: its own, on a smooth case, on the random ones."""
    orders = {row.method: row.order for row in study.rows}
    rows = [
        (name, str(order), f"{study.smooth_order[name]:.2f}", f"{study.observed_order(name):.2f}")
        for name, order in orders.items()
    ]
    header = ("method", "order", "observed, smooth case", "observed, random scenarios (median)")
    return markdown_table(header, rows, right=(1, 2, 3))
