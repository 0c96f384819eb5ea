"""What the scripts beside this share: many candidates played through many scenarios at once.

A candidate is a function of the step and the groups' observations that returns their actions, and if you like a law
under them. To tune a law of your own, see policies.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

import numpy as np

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.score import pinned_cost
from wtg_gym.gains import ScoreUnits
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.tasks import V0
from wtg_gym.tasks.cost import COST_TERMS

#: (step, observations (n_scenarios, n_candidates, n_wtg, n)) → actions (n_scenarios, n_candidates, n_wtg, n_action).
Candidates = Callable[[int, Floats], Floats]
#: One law for all groups, or one for each.
Law = TrackingLaw | tuple[TrackingLaw, ...]


class Rollouts:
    """Plays candidates through scenarios, all at once; further arguments are settings of the environment."""

    def __init__(self, suite: str, split: str, seeds: Sequence[int], n_candidates: int, **settings) -> None:
        self._arguments, self._settings = (suite, split, list(seeds)), settings
        self._units: ScoreUnits | None = None
        self.lanes = TaskLanes(EnvSettings(suite=suite, split=split, **settings), len(seeds) * n_candidates)
        self.shape = len(seeds), n_candidates
        self.n_wtg, self.n_local = self.lanes.n_wtg, self.lanes.n_local
        self.n_action = self.lanes.n_action // self.n_wtg
        self._scenarios = self.lanes.scenarios(seeds)
        self._episodes = self.lanes.prepare(self._scenarios)
        # Each candidate's lanes, in the order of the scenarios.
        self._order = np.arange(self.lanes.n_lanes).reshape(self.shape).T.tolist()
        self.n_steps = int(self._episodes.n_intervals.max())

    def with_candidates(self, n_candidates: int) -> Rollouts:
        """Return rollouts of the same scenarios with another number of candidates in each."""
        return Rollouts(*self._arguments, n_candidates, **self._settings)

    def play(self, candidates: Candidates | None = None, laws: Sequence[Law] | None = None) -> Floats:
        """Return the sums of the cost's terms over an episode, (n_scenarios, n_candidates, n_terms).

        Args:
            candidates: their actions; None: the zero action, which leaves everything to the law.
            laws: the law under each candidate; None: that of the settings.
        """
        lanes, n_own = self.lanes, self.n_wtg * (self.n_local + self.n_action)
        for candidate, order in enumerate(self._order):
            if laws is not None:
                law = laws[candidate]
                lanes.laws = law if isinstance(law, tuple) else (law,) * self.n_wtg
            lanes.start(order, self._episodes if laws is None else self._scenarios)
        for step in range(self.n_steps):
            actions = np.zeros((lanes.n_lanes, lanes.n_action))
            if candidates is not None:
                own = lanes.observations[:, :n_own].reshape(*self.shape, self.n_wtg, -1).astype(np.float64)
                actions = np.clip(candidates(step, own), -1.0, 1.0).reshape(lanes.n_lanes, -1)
            lanes.step(np.ascontiguousarray(actions))
        return lanes.cost_sums().reshape(*self.shape, -1)

    def reference(self) -> Floats:
        """Return what :meth:`play` gives for the zero action, (n_scenarios, n_terms)."""
        with closing(self.with_candidates(1)) as alone:
            return alone.play()[:, 0]

    def pinned(self, terms: Floats) -> Floats:
        """Return the costs that the leaderboard counts: in v0 a failed episode's is the largest there is."""
        costs: Floats = terms.sum(axis=-1)
        if self.lanes.suite.task.charges_worst:
            return costs
        cap = self.lanes.settings.cost_weights().cap
        worst = pinned_cost(0.0, failed=True, duration_s=self.lanes.duration_s, cap=cap)
        return np.where(terms[..., COST_TERMS.index("failure")] > 0.0, worst, costs)

    def log_costs(self, terms: Floats) -> Floats:
        """Return ln(J + J0) of pinned costs, (n_scenarios, n_candidates), each in units of its stratum's Λ.

        Their mean over as many scenarios of each stratum decides the score.
        """
        self._units = self._units or ScoreUnits(self.lanes.settings)
        offsets, scales = self._units.of(self._arguments[2])
        return np.log(self.pinned(terms) + offsets[:, None]) / scales[:, None]

    def objective(self, terms: Floats) -> Floats:
        """Return the objective of a search, (n_scenarios, n_candidates): in v0 the cost, from v1 on :meth:`log_costs`.

        With v1's rotors a few failures outweigh all else in a mean of costs.
        """
        return terms.sum(axis=-1) if self.lanes.suite.task is V0 else self.log_costs(terms)

    def close(self) -> None:
        self.lanes.simulator.close()


def time_left(lanes: TaskLanes) -> Floats:
    """Return how long before its time each lane has failed [s], (n_lanes,); 0 where it has not.

    In v1 a failure costs the same whenever it comes. That a later one is better shows a search the way out.
    """
    steps = lanes.task_values("end_step") - lanes.simulator.lane_values("step")
    return np.where(lanes.statuses() != Status.RUNNING, steps * lanes.settings.simulation_dt, 0.0)


def linear_feedback(gains: Floats) -> Candidates:
    """Return the feedback a = G o + b of a group's own observation; gains (..., n_action, n_local + 1), b at the end.

    The leading axes are scenarios and candidates, or fewer.
    """

    def act(_step: int, own: Floats) -> Floats:
        actions = np.einsum("...ij,...wj->...wi", gains[..., :-1], own[..., : gains.shape[-1] - 1])
        return actions + gains[..., None, :, -1]

    return act


def positions(n_knots: int, n_steps: int) -> list[float]:
    """Return where steps lie between the knots of a course: 0 at the first knot, n_knots - 1 at the last."""
    return np.linspace(0.0, n_knots - 1.0, n_steps).tolist()


def between(knots: Floats, position: float) -> Floats:
    """Return actions at one of :func:`positions`, linear between knots (..., n_knots, n_wtg, n_action)."""
    left = min(int(position), knots.shape[-3] - 2)
    before, after = knots[..., left, :, :], knots[..., left + 1, :, :]
    return before + (position - left) * (after - before)


def course(knots: Floats, n_steps: int) -> Candidates:
    """Return actions that are linear in time between knots, (n_scenarios, n_candidates, n_knots, n_wtg, n_action)."""
    steps = positions(knots.shape[2], n_steps)
    return lambda step, _own: between(knots, steps[step])
