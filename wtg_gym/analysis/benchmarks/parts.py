"""All parts of the benchmark in one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from wtg_gym.analysis.benchmarks.environments import (
    environment_cases,
    gradient_cases,
    installed,
    physics_cases,
    rendering_cases,
    yardstick,
)
from wtg_gym.analysis.benchmarks.growth import Curve, growth_cases, growth_curves
from wtg_gym.analysis.benchmarks.peers import missing_packages, peer_cases
from wtg_gym.analysis.benchmarks.roofline import Roofline, roofline, roofline_cases
from wtg_gym.analysis.benchmarks.timing import OnProgress, Rate, Stepper, measure, prepare
from wtg_gym.analysis.benchmarks.training import training_cases
from wtg_gym.extras import install_advice

#: The parts in words.
PARTS = {
    "environments": "environment steps per second, of ours and of Gymnasium's own",
    "physics": "environment steps per second of ours, on the paper's physics and on what extends it",
    "gradients": "environment steps per second of ours, with the gradient of the cost with respect to every action",
    "rendering": "steps per second with a frame drawn at each, of ours and of Gymnasium's own",
    "training": "steps per second of PPO learning, on our adapter and on Stable-Baselines3's vector environments",
    "peers": "other projects' environments, those that are installed",
    "growth": "cost of a step against the numbers of WTG groups, machines, lanes and threads",
    "roofline": "counted floating-point operations against the machine's measured peak and bandwidth",
}


@dataclass(frozen=True)
class Results:
    """Results of a run; parts that were not asked for are empty or None."""

    rates: list[Rate]  # of environments, rendering, training and peers; the yardstick comes first
    growth: list[Curve]  # a curve per kind of size
    roofline: Roofline | None  # arithmetic

    def ratio(self, rate: Rate) -> float:
        """Return a rate as a multiple of the yardstick's in this run."""
        return rate.per_s / self.rates[0].per_s

    def of_part(self, part: str) -> list[Rate]:
        """Return the rates of a part."""
        return [rate for rate in self.rates if rate.case.part == part]


class Benchmark:
    """Parts of the benchmark, all of whose cases are measured in turns."""

    def __init__(self, parts: Sequence[str], *, full: bool) -> None:
        #: A line for each package that is missing.
        self.missing: list[str] = []
        cases = [yardstick()]
        if "environments" in parts:
            cases += environment_cases()
        if "physics" in parts:
            cases += physics_cases()
        if "gradients" in parts:
            cases += gradient_cases()
        if "rendering" in parts and installed("matplotlib", "pygame"):
            cases += rendering_cases()
        elif "rendering" in parts:
            self.missing.append(f"frames are left out; {install_advice('render')}")
        has_sb3 = installed("stable_baselines3")
        if "training" in parts and has_sb3:
            cases += training_cases()
        if {"environments", "training"} & set(parts) and not has_sb3:
            self.missing.append(f"Stable-Baselines3 is left out; {install_advice('train')}")
        if "peers" in parts:
            cases += peer_cases()
            self.missing += [f"{package} is left out: pip install {package}" for package in missing_packages()]
        self._n_rates = len(cases)
        self._sizes = growth_cases(full=full) if "growth" in parts else {}
        cases += [own.case() for curve in self._sizes.values() for _, own in curve]
        self._has_roofline = "roofline" in parts
        if self._has_roofline:
            ceilings, ours = roofline_cases()
            cases += [*ceilings, *(own.case() for own in ours)]
        self._cases = cases
        self._steppers: list[Stepper] = []

    def prepare(self, on_progress: OnProgress) -> None:
        """Make and compile everything, once, before :meth:`measure`."""
        self._steppers = prepare(self._cases, on_progress)

    def measure(self, seconds: float, repeats: int, on_progress: OnProgress) -> Results:
        """Return the results of `repeats` runs of `seconds` [s] per case; the median counts."""
        rates = measure(self._cases, self._steppers, seconds, repeats, on_progress)
        by_name = {rate.case.name: rate for rate in rates}
        return Results(
            rates=rates[: self._n_rates],
            growth=growth_curves(self._sizes, by_name),
            roofline=roofline(by_name) if self._has_roofline else None,
        )
