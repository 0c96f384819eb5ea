"""Means over strata, training seeds and scenarios, adjusted by control variates, with intervals: version v1.

Control variates are laws whose mean gain over the distribution is known from tens of thousands of training scenarios.
Where the scenarios of an evaluation were easy for the laws, they were easy for an entry: its gains are regressed on
theirs, and the regression is read at their known means,

    adjusted mean = mean(g) - β · (mean(x) - μ)

(A. B. Owen, "Monte Carlo theory, methods and examples", 2013, section 8.9). It is the same as to give each scenario a
weight, which depends on the laws alone, so that the laws' weighted means are the known ones.

The variance of a mean over strata has three parts: scenarios, by the residuals of the mean over training seeds; known
means, by their own standard errors; training seeds, by the variance between their means less what the scenarios give to
that. The half-width of the interval is the root of the variance times the mean of the parts' quantiles of Student's t,
each weighted with its variance (W. G. Cochran, Biometrics 20, 1964, 191-195): three training seeds have two degrees of
freedom, and the interval covers 95 … 97 %.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from scipy import special

from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.statistics import CONFIDENCE, Floats, Groups, Indices, Interval, worst_tenth
from wtg_gym.files import sha256, to_json

#: Means of the control variates by the name of the suite; docs/studies/law_means.py writes them.
LAW_MEANS = Path(__file__).with_name("law_means.json")
#: Scenarios of a stratum from which on control variates are used: with fewer, β costs more than it brings.
LEAST_SCENARIOS = 30
#: Gains that differ by less are equal, and singular values below this share of the largest one are 0.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class KnownMeans:
    """Gains of p control variates over the distribution of a stratum: their means, and how well these are known."""

    n: int  # number of scenarios they are from
    mean: Sequence[float]  # (p,)
    covariance: Sequence[Sequence[float]]  # of the gains of a scenario (p, p)


@dataclass(frozen=True)
class ControlVariates:
    """Gains of p laws in the scenarios of an evaluation, (n_scenarios, p), and their known means in each stratum."""

    gains: Floats
    known: Mapping[str, KnownMeans]


def settings_hash(settings: Mapping[str, Any]) -> str:
    """Return the sha256 of the settings that all entries of results share: other settings have other means."""
    return sha256(to_json(dict(settings)).encode())


def known_means(suite: str, suite_hash: str, settings: Mapping[str, Any], laws: Sequence[str]) -> dict[str, KnownMeans]:
    """Return the known means of the laws in each stratum of a suite; empty where there are none."""
    stored = json.loads(LAW_MEANS.read_text(encoding="utf-8")).get(suite, {})
    expected = {"suite_hash": suite_hash, "settings": settings_hash(settings), "laws": list(laws)}
    if not laws or {key: stored.get(key) for key in expected} != expected:
        return {}
    return {stratum: KnownMeans(**values) for stratum, values in stored["strata"].items()}


class _Stratum:
    """The scenarios of a stratum, as indices (n,): the weight of each, and what their variates explain of a value."""

    def __init__(self, at: Indices, variates: ControlVariates | None, name: str) -> None:
        x = np.empty((at.size, 0)) if variates is None else variates.gains[at]
        known = KnownMeans(1, [], np.empty((0, 0)).tolist()) if variates is None else variates.known[name]
        centred = x - x.mean(axis=0)
        self.at, self._x = at, np.where(np.abs(centred).max(axis=0) > _NEGLIGIBLE, centred, 0.0)
        self._inverse = np.linalg.pinv(self._x, rcond=_NEGLIGIBLE) if x.size else np.empty((0, at.size))
        #: Weights of the scenarios, which add up to 1, (n,).
        self.weights = 1.0 / at.size - (x.mean(axis=0) - np.array(known.mean)) @ self._inverse
        self._of_means = np.reshape(known.covariance, (x.shape[1], x.shape[1])) / known.n
        #: Degrees of freedom of the residuals; the trace is the number of variates that are not collinear.
        self.n_free = at.size - 1 - round(float(np.trace(self._inverse @ self._x)))

    def variance(self, values: Floats) -> Floats:
        """Return the variance of the weighted means of values (..., n) by the luck of the scenarios, (...)."""
        if self.n_free < 1:
            return np.zeros(values.shape[:-1])
        centred = values - values.mean(axis=-1, keepdims=True)
        residuals = centred - centred @ self._inverse.T @ self._x.T
        variance: Floats = np.square(residuals).sum(axis=-1) / self.n_free * np.square(self.weights).sum()
        return variance

    def variance_of_known(self, values: Floats) -> float:
        """Return the variance of the weighted mean of values (n,) by the errors of the known means."""
        slopes = self._inverse @ values
        return float(slopes @ self._of_means @ slopes)


class Adjusted:
    """Scores, and differences between entries, with one scale Λ and with control variates; see the module.

    Methods are those of :class:`~wtg_gym.evaluation.statistics.Bootstrap`. Strata, the `groups` of scenarios, count
    alike; one of a single scenario adds nothing to the width of an interval.
    """

    def __init__(self, scale: float, groups: Groups, variates: ControlVariates | None = None) -> None:
        self._points = 100.0 / scale
        self._groups = groups
        self._plain = [_Stratum(at, None, name) for name, at in groups.items()]
        self._strata = [_Stratum(at, variates, name) for name, at in groups.items()]

    def points(self, gains: Floats) -> float:
        """Return the points above 100 that gains make."""
        return self._points * _mean([gains], self._strata)

    def score(self, gains: Floats) -> Interval:
        """Return the score with its interval."""
        return _interval([self._points * gains], self._strata, 100.0)

    def strata(self, gains: Floats) -> dict[str, Interval]:
        """Return the score of each stratum by its name; none where there are no strata."""
        named = zip(self._groups, self._strata, strict=True)
        return {name: _interval([self._points * gains], [stratum], 100.0) for name, stratum in named if name}

    def score_difference(self, gains: Floats, other: Floats) -> Interval:
        """Return the score of one entry minus that of another, paired by scenarios."""
        return _interval([self._points * gains, -self._points * other], self._strata)

    def share_difference(self, happened: Floats, other: Floats) -> Interval:
        """Return how much more often something happened than under another entry [percentage points], paired."""
        return _interval([100.0 * happened, -100.0 * other], self._plain)

    def worst_tenth_difference(self, costs: Floats, other: Floats) -> Interval:
        """Return how much more the :func:`worst_tenth` costs than another entry's [%], paired and linearised."""
        tail, base = (statistics.mean(worst_tenth(values)) for values in (costs, other))
        ratio, percent = tail / base, 100.0 / base
        value = 100.0 * (ratio - 1.0)
        sides = [percent * _excess(costs), -(percent * ratio) * _excess(other)]
        spread = _interval(sides, self._plain)
        return Interval(value, value + spread.low - spread.value, value + spread.high - spread.value)


def _excess(costs: Floats) -> Floats:
    """Return what each scenario adds to the mean of the worst tenth (n_runs, n_scenarios)."""
    worst = worst_tenth(costs)
    excess: Floats = np.maximum(costs - worst.min(axis=-1, keepdims=True), 0.0) * costs.shape[-1] / worst.shape[-1]
    return excess


def _mean(sides: Sequence[Floats], strata: Sequence[_Stratum]) -> float:
    """Return the sum over the sides of their means over runs, weighted scenarios and strata."""
    return fmean(
        math.fsum((stratum.weights * side[:, stratum.at]).ravel().tolist()) / len(side)
        for side in sides
        for stratum in strata
    ) * len(sides)


def _interval(sides: Sequence[Floats], strata: Sequence[_Stratum], offset: float = 0.0) -> Interval:
    """Return the :func:`_mean` of sides, whose training seeds are independent, plus an offset, with its interval."""
    value = offset + _mean(sides, strata)
    #: Variances, and the degrees of freedom that each of them is estimated with.
    parts: list[tuple[float, float]] = []
    for stratum in strata:
        mean = np.sum([side[:, stratum.at].mean(axis=0) for side in sides], axis=0) / len(strata)
        parts.append((float(stratum.variance(mean)), stratum.n_free))
        parts.append((stratum.variance_of_known(mean), math.inf))
    for side in sides:
        n_runs = len(side)
        if n_runs == 1:
            continue
        means = np.mean([side[:, stratum.at] @ stratum.weights for stratum in strata], axis=0)
        between = float(means.var(ddof=1)) / n_runs
        # Differences between runs of one scenario count in both variances, that of scenarios and that of runs.
        apart = side - side.mean(axis=0)
        shared = sum(stratum.variance(apart[:, stratum.at]).sum() for stratum in strata) / len(strata) ** 2
        parts.append((max(between - shared / (n_runs - 1) / n_runs, 0.0), n_runs - 1))
    variance = math.fsum(part for part, _ in parts)
    quantiles = math.fsum(part * special.stdtrit(n_free, 0.5 + 0.5 * CONFIDENCE) for part, n_free in parts if part)
    half = quantiles / math.sqrt(variance) if variance else 0.0
    return Interval(value, value - half, value + half)
