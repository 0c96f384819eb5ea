"""Parameters of a grid from a record of its frequency: least squares by Gauss-Newton, with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.special import stdtrit

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients.jacobian import Responses
from wtg_gym.gradients.plant_parameters import known_parameters, require_known_parameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import require_range

Floats = npt.NDArray[np.float64]
#: Unknowns are sought between these multiples of the values that a plant has.
FACTOR_RANGE = (0.05, 20.0)
INERTIA = "inertia"


@dataclass(frozen=True)
class Unknown:
    """A quantity to be found: parameters that move in proportion.

    `name`; the names of its `parameters`; its `value` in the plant that the search starts from, and its `unit`.
    """

    name: str
    parameters: tuple[str, ...]
    value: float
    unit: str


def unknown_of(plant: PlantSettings, name: str) -> Unknown:
    """Return a parameter as an unknown; "inertia" is the kinetic energy of all synchronous machines.

    Raises:
        ValueError: the name is unknown.
    """
    known = known_parameters(plant)
    if name == INERTIA:
        machines = plant.case.machines
        energy = sum(0.5 * machine.two_h_s * machine.rating_mva for machine in machines)
        names = dict.fromkeys(f"machines.{machine.bus}.two_h_s" for machine in machines)
        return Unknown(INERTIA, tuple(names), energy, "MW s")
    require_known_parameters(plant, [name])
    if known[name] == 0.0:
        raise ValueError(f"{name} is 0 in this plant: it is sought in multiples of its value there")
    unit = "s" if name.endswith("_s") else "p.u." if name.endswith("_pu") else ""
    return Unknown(name, (name,), known[name], unit)


@dataclass(frozen=True)
class Estimate:
    """What a record says about the unknowns.

    `values` (n_unknowns,) with `low` and `high` ends of their confidence intervals; the standard deviation `noise` of
    the residuals; `correlation` of the estimates (n_unknowns, n_unknowns); `n_runs` that the search took.
    """

    values: Floats
    low: Floats
    high: Floats
    noise: float
    correlation: Floats
    n_runs: int


class Estimator:
    """Fits runs of a plant to records of one of its outputs.

    Args:
        settings: of the environment, whose plant has the values to start from.
        scenario: what happens in the record.
        unknowns: what to find.
        steps: control steps at whose ends the record has values, 0 for the first, increasing.
        output: which of `Tape.output_names` it is a record of.
        n_threads: threads to run with; None for one per processor.

    Raises:
        ValueError: an unknown or the output is not known, or two unknowns share a parameter.
    """

    def __init__(
        self,
        settings: EnvSettings,
        scenario: Scenario,
        unknowns: Sequence[Unknown],
        steps: Iterable[int],
        output: str = "frequency_pu",
        n_threads: int | None = None,
    ) -> None:
        names = [name for unknown in unknowns for name in unknown.parameters]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two unknowns move {', '.join(twice)}")
        if scenario.governor_droop is not None and any(name.endswith("governor.droop_pu") for name in names):
            raise ValueError(f"scenario {scenario.name!r} sets the droop of the governors: the plant's has no effect")
        self.unknowns, self.scenario, self.steps = tuple(unknowns), scenario, np.array(list(steps), dtype=np.int64)
        if self.steps.size <= len(unknowns) or np.any(np.diff(self.steps, prepend=-1) <= 0):
            raise ValueError(f"a record needs more values than the {len(unknowns)} unknowns, at increasing times")
        self._responses = Responses(settings, names, n_threads)
        tape = self._responses.tape
        if output not in tape.output_names:
            raise ValueError(f"unknown output {output!r}; known: {', '.join(tape.output_names)}")
        self._output = tape.output_names.index(output)
        self._given = tape.parameter_values()
        self._started: tuple[bytes, tuple[Floats, Floats]] = b"", (np.empty(0), np.empty(0))
        self._of_unknown = np.array([[name in unknown.parameters for unknown in unknowns] for name in names], float)

    def run(self, factors: Floats) -> tuple[Floats, Floats]:
        """Return the output at the record's times (n_values,) for unknowns at multiples of their values, and its
        derivatives with respect to these (n_values, n_unknowns)."""
        shared = dict(zip(self._given, self._of_unknown @ factors, strict=True))
        self._responses.tape.set_parameters({name: value * shared[name] for name, value in self._given.items()})
        found = self._responses(self.scenario, int(self.steps[-1]) + 1)
        slopes = found.parameters[self.steps, self._output] * np.array(list(self._given.values()))
        return found.outputs[self.steps, self._output], slopes @ self._of_unknown

    def fit(self, record: Floats, start: Floats | None = None, confidence: float = 0.95) -> Estimate:
        """Find the values under which runs are closest to a record.

        Intervals are those of least squares with white noise of unknown size: t quantiles of a Gaussian error.

        Args:
            record: values of the output at the steps (n_values,).
            start: multiples of the unknowns' values to start from; None for 1.
            confidence: probability that an interval holds the true value.

        Raises:
            ValueError: the record is not of this length, or says nothing about an unknown, or there is no run to start
                from.
        """
        record = np.asarray(record, dtype=np.float64)
        if record.shape != self.steps.shape or not np.isfinite(record).all():
            raise ValueError(f"the record must be {self.steps.size} finite numbers, got shape {record.shape}")
        confidence = require_range("confidence", confidence, 0.5, 0.9999, "")
        first = np.ones(len(self.unknowns)) if start is None else np.asarray(start, dtype=np.float64)
        # Searches over several records start from one run.
        if self._started[0] != first.tobytes():
            self._started = first.tobytes(), self.run(first)
        runs: dict[bytes, tuple[Floats, Floats]] = dict([self._started])

        def run(factors: Floats) -> tuple[Floats, Floats]:
            if factors.tobytes() not in runs:
                runs[factors.tobytes()] = self.run(factors)
            return runs[factors.tobytes()]

        def residuals_at(factors: Floats) -> Floats:
            try:
                return (run(factors)[0] - record) / scale
            except ValueError:
                # No such plant, or none that the integration's step suits: the search takes a shorter way.
                return np.full(record.size, np.inf)

        scale = float(np.ptp(record)) or 1.0
        found = least_squares(
            residuals_at,
            first,
            jac=lambda factors: run(factors)[1] / scale,
            bounds=FACTOR_RANGE,
            # The least values are those of a square: their place is known to the root of its rounding.
            xtol=1e-7,
            ftol=1e-9,
            gtol=1e-12,
        )
        residuals, slopes = run(found.x)[0] - record, run(found.x)[1]
        information = slopes.T @ slopes
        # A column of zeros, or two that are the same, cannot be told from noise.
        if np.linalg.cond(slopes / (np.linalg.norm(slopes, axis=0) + 1e-300)) > 1e6:
            raise ValueError("the record does not tell the unknowns apart: leave one out, or record a larger event")
        freedom = record.size - found.x.size
        variance = float(residuals @ residuals) / freedom
        covariance = variance * np.linalg.inv(information)
        errors = np.sqrt(np.diag(covariance))
        values = np.array([unknown.value for unknown in self.unknowns])
        reach = stdtrit(freedom, 0.5 + 0.5 * confidence) * errors
        return Estimate(
            values=values * found.x,
            low=values * (found.x - reach),
            high=values * (found.x + reach),
            noise=float(np.sqrt(variance)),
            correlation=covariance / np.outer(errors, errors),
            n_runs=len(runs),
        )


def estimates(
    estimator: Estimator,
    record: Floats,
    noise: float,
    n_draws: int,
    seed: int = 0,
    start: Floats | None = None,
    on_progress: Callable[[int], None] = lambda _: None,
) -> list[Estimate]:
    """Return the estimates from a record with Gaussian noise drawn anew each time.

    Args:
        estimator: of the plant.
        record: without noise (n_values,).
        noise: standard deviation, in the unit of the output.
        n_draws: how often noise is drawn.
        seed: of the draws.
        start: multiples of the unknowns' values that the first search starts from, the others from what that found.
        on_progress: called with the number of draws done.
    """
    rng = np.random.default_rng(seed)
    values = np.array([unknown.value for unknown in estimator.unknowns])
    found: list[Estimate] = []
    for draw in range(n_draws):
        found.append(estimator.fit(record + noise * rng.standard_normal(record.size), start))
        start = found[0].values / values
        on_progress(draw + 1)
    return found


def covered(found: Sequence[Estimate], values: Floats) -> Floats:
    """Return the share of estimates whose interval holds the true value, per unknown."""
    within = np.array([(estimate.low <= values) & (values <= estimate.high) for estimate in found])
    return np.asarray(within.mean(axis=0))
