"""The paper's law tuned by gradients of whole episodes, for docs/gradients.md.

    python docs/studies/gradient_law.py

prints the laws and what they score. Adam lowers the mean of ln(J + J0) over random training scenarios, which decides
the score. What k_nominal does, which moves the equilibrium before an episode too, a difference of two runs tells. The
laws that come of it, one for all groups and one for each, are played on validation scenarios beside the paper's. The
law of version v1 was found without gradients, by policies.py.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np
from rollouts import Rollouts

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.score import cost_offsets, gains, mean_score, score_scales
from wtg_gym.files import markdown_table
from wtg_gym.gradients import Tape
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import LARGEST_COEFFICIENT, TIME_CONSTANT_RANGE, TrackingLaw, get_law
from wtg_gym.scenarios import get_suite

Laws = tuple[TrackingLaw, ...]

#: Least coefficient and time constant that are tried [p.u., s]: at 0 a group would give nothing, and faster damping
#: than the integration step follows is refused.
_LEAST_COEFFICIENT, _LEAST_TAU_S = 0.05, 0.1
#: How much further than k [p.u.] a step of the optimiser takes ln τ.
_SCALE = np.array([1.0, 1.0, 1.0, 5.0])
#: Distance of the two runs that tell what k_nominal does [p.u.].
_H = 1e-4


class Tuned(NamedTuple):
    """Laws of the groups, the mean of ln(J + J0) of each batch before its step, and how long it took [s]."""

    laws: Laws
    losses: tuple[float, ...]
    seconds: float


class LawLoss:
    """Mean of ln(J + J0) over scenarios as a function of the laws' parameters, and its gradient."""

    def __init__(self, suite: str, n_lanes: int) -> None:
        settings = EnvSettings(suite=suite)
        self.tape = Tape(settings, n_lanes)
        self._lanes = TaskLanes(settings, n_lanes)
        self.n_groups = self.tape.lanes.n_wtg
        self.n_steps = round(self.tape.lanes.duration_s / settings.control_dt)

    def laws(self, points: Floats) -> Laws:
        """Return the law of each group at a point (n_groups, 4) or (1, 4) for all: k_min, k_nominal, k_max, ln τ."""
        rows = np.broadcast_to(points, (self.n_groups, 4)).tolist()
        return tuple(
            TrackingLaw(name="tuned", k_min=low, k_nominal=nominal, k_max=high, damping_time_constant_s=math.exp(tau))
            for low, nominal, high, tau in rows
        )

    def __call__(self, points: Floats, seeds: Sequence[int]) -> tuple[float, Floats]:
        """Return the loss over the scenarios of seeds, one per lane, and its gradient in the form of the points."""
        lanes = self.tape.lanes
        lanes.laws = self.laws(points)
        scenarios = lanes.scenarios(seeds)
        found = self.tape.gradient(scenarios, np.zeros((self.n_steps, lanes.n_lanes, lanes.n_action)))
        costs = found.terms.sum(axis=1) + self._offsets(scenarios)
        of_groups = np.einsum("l,lgp->gp", 1.0 / costs, found.law) / lanes.n_lanes
        # d(1/τ) / d ln τ = -1/τ.
        of_groups[:, 3] *= -np.array([law.inverse_time_constant for law in lanes.laws])
        gradient = of_groups if points.shape[0] > 1 else of_groups.sum(axis=0, keepdims=True)
        for place in range(points.shape[0]):
            ends = []
            for sign in (1.0, -1.0):
                moved = points.copy()
                moved[place, 1] += sign * _H
                ends.append(self._loss(self.laws(moved), scenarios))
            gradient[place, 1] = (ends[0] - ends[1]) / (2.0 * _H)
        return float(np.log(costs).mean()), gradient

    def _offsets(self, scenarios: Sequence[Scenario]) -> Floats:
        """J0 of every scenario, (n_scenarios,)."""
        suite = self._lanes.suite
        return np.array([dict(suite.benchmark.cost_offsets)[suite.stratum(each.seed)] for each in scenarios])

    def _loss(self, laws: Laws, scenarios: Sequence[Scenario]) -> float:
        lanes, idle = self._lanes, np.zeros((self._lanes.n_lanes, self._lanes.n_action))
        lanes.laws = laws
        lanes.start(list(range(lanes.n_lanes)), scenarios)
        for _ in range(self.n_steps):
            lanes.step(idle)
        return float(np.log(lanes.cost_sums().sum(axis=1) + self._offsets(scenarios)).mean())


def held(points: Floats) -> Floats:
    """Return points within the ranges that laws have."""
    low = [_LEAST_COEFFICIENT] * 3 + [math.log(_LEAST_TAU_S)]
    return np.clip(points, low, [LARGEST_COEFFICIENT] * 3 + [math.log(TIME_CONSTANT_RANGE[1]) - 1e-9])


def tune(
    suite: str,
    *,
    per_group: bool,
    n_batches: int,
    n_scenarios: int,
    seed: int,
    learning_rate: float = 0.02,
) -> Tuned:
    """Lower the loss by Adam, whose learning rate falls along half a cosine, from the paper's law on."""
    began = time.monotonic()
    loss_of = LawLoss(suite, n_scenarios)
    paper, train = get_law("coordinated-piecewise"), get_suite(suite).train
    point = np.array([[paper.k_min, paper.k_nominal, paper.k_max, math.log(paper.damping_time_constant_s)]])
    points = np.repeat(point, loss_of.n_groups if per_group else 1, axis=0)
    mean, square, losses = np.zeros_like(points), np.zeros_like(points), []
    for batch in range(n_batches):
        rng = np.random.default_rng((seed, batch))
        loss, gradient = loss_of(points, rng.integers(train.start, train.stop, n_scenarios).tolist())
        losses.append(loss)
        gradient = gradient * _SCALE
        mean, square = 0.9 * mean + 0.1 * gradient, 0.98 * square + 0.02 * gradient**2
        rate = learning_rate * (0.5 + 0.5 * math.cos(math.pi * batch / n_batches))
        step = (mean / (1.0 - 0.9 ** (batch + 1))) / (np.sqrt(square / (1.0 - 0.98 ** (batch + 1))) + 1e-12)
        points = held(points - rate * _SCALE * step)
        print(f"batch {batch + 1} of {n_batches}: mean ln(J + J0) {loss:.4f}", file=sys.stderr)
    return Tuned(loss_of.laws(points), tuple(losses), time.monotonic() - began)


def scores(suite: str, laws: Sequence[Laws], n_scenarios: int) -> list[tuple[float, float]]:
    """Return score and mean pinned cost of laws on the first validation scenarios of a suite."""
    own = get_suite(suite)
    played = [get_law(own.benchmark.zero), get_law(own.benchmark.hundred), *laws]
    with closing(Rollouts(suite, "validation", own.validation[:n_scenarios], len(played))) as rollouts:
        zero, hundred, *costs = rollouts.pinned(rollouts.play(laws=played)).T
    names = np.array([own.stratum(seed) for seed in own.validation[:n_scenarios]])
    groups = {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}
    scales = score_scales(zero, hundred, own.benchmark, groups)
    offsets = cost_offsets(groups, own.benchmark)
    gained = (gains(each[np.newaxis], hundred, offsets) for each in costs)
    return [(mean_score(each, scales, groups), float(cost.mean())) for each, cost in zip(gained, costs, strict=True)]


def _each(laws: Laws, key: str) -> str:
    values = [f"{getattr(law, key):.3f}" for law in laws]
    return values[0] if len(set(values)) == 1 else " / ".join(values)


if __name__ == "__main__":
    suite = "standard"
    effort = {"n_batches": 100, "n_scenarios": 32, "seed": 0}
    one, each = (tune(suite, per_group=per_group, **effort) for per_group in (False, True))
    paper = (get_law("coordinated-piecewise"),) * len(one.laws)
    rows = []
    for (name, laws, seconds), (score, cost) in zip(
        (
            ("the paper's", paper, ""),
            ("one for all groups", one.laws, f"{one.seconds:.0f}"),
            ("one for each group", each.laws, f"{each.seconds:.0f}"),
        ),
        scores(suite, [paper, one.laws, each.laws], 100),
        strict=True,
    ):
        texts = [_each(laws, key) for key in ("k_min", "k_nominal", "k_max", "damping_time_constant_s")]
        rows.append((name, *texts, f"{score:.1f}", f"{cost:.2f}", seconds))
    header = ("law", "k_min", "k_nominal", "k_max", "τ [s]", "score", "mean pinned cost", "seconds")
    print(markdown_table(header, rows, right=range(1, 8)))
