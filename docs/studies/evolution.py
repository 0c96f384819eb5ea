"""Searches by CMA-ES (N. Hansen, "The CMA evolution strategy: a tutorial", 2016): one feedback for all scenarios, or
the best actions of each scenario, known beforehand.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

import cma
import numpy as np
from rollouts import HISTORY_COLUMNS, Rollouts, both, course, history_feedback, linear_feedback

from agents.command import add_strategy_option, add_threads_option, suite_name
from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import get_suite

#: Called with the generations done and the (mean) cost of the best so far.
OnGeneration = Callable[[int, float], None]

#: Candidates per generation and knots per action.
POPULATION = 24
N_KNOTS = 16


@dataclass(frozen=True, kw_only=True)
class Search:
    """Scenarios and effort of a search; a ValueError if a value is unknown or out of range."""

    #: suite, split: of the scenarios.
    suite: str
    split: str
    n_scenarios: int | None  # how many of them, the first ones; None for all
    action_mode: str  # what the actions modulate
    generations: int  # of the search, or of every scenario's search
    seed: int  # of the search
    strategy: str = REFERENCE_STRATEGY  # law that they modulate

    def __post_init__(self) -> None:
        largest = min(len(get_suite(self.suite).seeds(self.split)), 10_000)
        for name, value, low, high in (
            ("scenarios", self.n_scenarios, 1, largest),
            ("generations", self.generations, 1, 100_000),
            ("seed", self.seed, 0, 2**32 - 1),
        ):
            if value is not None and not low <= value <= high:
                raise ValueError(f"--{name} = {value} is outside the allowed range {low} … {high}")

    @property
    def scenario_seeds(self) -> list[int]:
        """Seeds of the scenarios."""
        return list(get_suite(self.suite).seeds(self.split)[: self.n_scenarios])

    def rollouts(self, scenario_seeds: Sequence[int], n_threads: int | None = None) -> Rollouts:
        """Return rollouts of scenarios with a population in each."""
        modes = {"action_mode": self.action_mode, "strategy": self.strategy}
        return Rollouts(self.suite, self.split, scenario_seeds, POPULATION, n_threads, **modes)


def add_search_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that the commands with a search share."""
    parser.add_argument("--suite", type=suite_name, metavar="NAME", default="standard", help="(default: standard)")
    parser.add_argument("--action-mode", choices=tuple(ACTION_MODES), default="k+tau", help="(default: k+tau)")
    add_strategy_option(parser)
    parser.add_argument("--generations", type=int, default=150, metavar="N", help="of a search (default: 150)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the search (default: 0)")
    add_threads_option(parser)


def search_of(given: argparse.Namespace, split: str) -> Search:
    """Return the search that the options of :func:`add_search_options` and `--scenarios` ask for."""
    return Search(
        suite=given.suite,
        split=split,
        n_scenarios=given.scenarios,
        action_mode=given.action_mode,
        generations=given.generations,
        seed=given.seed,
        strategy=given.strategy or REFERENCE_STRATEGY,
    )


class _Strategy:
    """A search by CMA-ES that draws from a generator of its own.

    By itself cma draws from numpy's one generator for everybody: searches would depend on those beside them.
    """

    def __init__(self, start: Floats, spread: float, *seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        options = {"popsize": POPULATION, "randn": self._normal, "seed": np.nan, "verbose": -9, "CMA_diagonal": 40}
        self._search = cma.CMAEvolutionStrategy(start.ravel(), spread, options)

    def _normal(self, *shape: int) -> Floats:
        return self._rng.standard_normal(shape)

    def ask(self) -> Floats:
        """Return the next candidates, (POPULATION, n)."""
        # When cma goes over from a diagonal to a full covariance, its new sampler forgets the option.
        self._search.sm.randn = self._normal
        return np.array(self._search.ask())

    def tell(self, candidates: Floats, costs: Floats) -> None:
        """Learn from the candidates' costs (POPULATION,)."""
        self._search.tell(list(candidates), costs.tolist())

    @property
    def mean(self) -> Floats:
        """Mean of the distribution that candidates are drawn from, (n,)."""
        return np.array(self._search.result.xfavorite, dtype=np.float64)


def tune_linear(
    rollouts: Rollouts, generations: int, on_generation: OnGeneration, seed: int = 0, *, history: bool = False
) -> Floats:
    """Return the gains of a linear feedback, the same for all groups, that makes :meth:`Rollouts.objective` small.

    They are (n_action, n_local + 1), with history (n_action, n_local + n_history + 1): slow copies of the observation
    are fed back too. Rollouts must have POPULATION candidates in each scenario.
    """
    shape = (rollouts.n_action, rollouts.lanes.n_local + (len(HISTORY_COLUMNS) if history else 0) + 1)
    dt = rollouts.lanes.settings.control_dt
    search = _Strategy(np.zeros(shape), 0.15, seed)
    least = np.inf
    for generation in range(generations):
        asked = search.ask()
        gains = asked.reshape(-1, *shape)
        act = history_feedback(gains, dt) if history else linear_feedback(gains)
        costs = rollouts.objective(rollouts.play(act)).mean(axis=0)
        search.tell(asked, costs)
        least = min(least, float(costs.min()))
        on_generation(generation + 1, least)
    # The mean of the search's distribution generalises better than its luckiest sample.
    return search.mean.reshape(shape)


def search_with_foresight(
    rollouts: Rollouts,
    scenario_seeds: Sequence[int],
    gains: Floats | None,
    generations: int,
    on_generation: OnGeneration,
    seed: int = 0,
) -> Floats:
    """Return the smallest pinned cost found for every scenario, (n_scenarios,), of POPULATION candidates each.

    Args:
        scenario_seeds: their seeds: every scenario's search draws from a generator of its own.
        gains: of a linear feedback that the actions are added to and whose gains are searched as well,
            (n_action, n_local + 1); None: a course of actions alone.
    """
    knots = (N_KNOTS, rollouts.n_wtg, rollouts.n_action)
    n_course = int(np.prod(knots))
    start = np.zeros(n_course) if gains is None else np.concatenate([np.zeros(n_course), gains.ravel()])
    searches = [_Strategy(start, 0.3, seed, scenario, int(gains is not None)) for scenario in scenario_seeds]

    def played(on: Rollouts, asked: Floats) -> Floats:
        """The terms of the candidates asked (n_scenarios, n_candidates, n)."""
        act = course(asked[..., :n_course].reshape(*asked.shape[:2], *knots), on.n_steps)
        if gains is not None:
            act = both(act, linear_feedback(asked[..., n_course:].reshape(*asked.shape[:2], *gains.shape)))
        return on.play(act)

    best: Floats = np.full(rollouts.n_scenarios, np.inf)
    for generation in range(generations):
        asked = np.array([search.ask() for search in searches])
        terms = played(rollouts, asked)
        # A failure that comes later costs less, which shows the search the way out; what counts is the pinned cost.
        for search, candidates, cost in zip(searches, asked, terms.sum(axis=-1), strict=True):
            search.tell(candidates, cost)
        best = np.minimum(best, rollouts.pinned(terms).min(axis=1))
        on_generation(generation + 1, float(best.mean()))
    # The mean of a search's distribution is often better than any of its samples.
    means = np.array([[search.mean] for search in searches])
    with closing(rollouts.with_candidates(1)) as alone:
        return np.minimum(best, alone.pinned(played(alone, means))[:, 0])
