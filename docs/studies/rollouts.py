"""Many candidates played through many scenarios at once, and the forms of candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from wtg_gym.envs.lanes import PreparedEpisodes, TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation.score import COST_OFFSET, pinned_cost
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.scenarios.benchmark import V0

#: Observations (n_scenarios, n_candidates, n_wtg, n) of a step to actions (n_scenarios, n_candidates, n_wtg, n_action).
Candidates = Callable[[int, Floats], Floats]

_FAILURE = COST_TERMS.index("failure")


class Rollouts:
    """Plays candidates through scenarios, all at once."""

    def __init__(
        self,
        suite: str,
        split: str,
        seeds: Sequence[int],
        n_candidates: int,
        n_threads: int | None = None,
        **settings: Any,
    ) -> None:
        self._arguments = suite, split, list(seeds)
        self._settings = settings
        self._n_threads = n_threads
        self.lanes = TaskLanes(EnvSettings(suite=suite, split=split, **settings), len(seeds) * n_candidates, n_threads)
        self.n_scenarios, self.n_candidates = len(seeds), n_candidates
        self.n_wtg = self.lanes.n_wtg
        self.n_action = self.lanes.n_action // self.n_wtg
        self._n_own = self.n_wtg * (self.lanes.n_local + self.n_action)
        self._scenarios = self.lanes.scenarios(seeds)
        self._episodes = self.lanes.prepare(self._scenarios)
        # Each candidate's lanes, in the order of the scenarios.
        self._order = np.arange(self.lanes.n_lanes).reshape(len(seeds), n_candidates).T.tolist()
        self.n_steps = int(self._episodes.n_intervals.max())

    def with_candidates(self, n_candidates: int) -> Rollouts:
        """Return rollouts of the same scenarios with another number of candidates in each."""
        return Rollouts(*self._arguments, n_candidates, self._n_threads, **self._settings)

    def play(
        self, candidates: Candidates, laws: Sequence[TrackingLaw | tuple[TrackingLaw, ...]] | None = None
    ) -> Floats:
        """Return the sums of the cost's terms over an episode, (n_scenarios, n_candidates, n_terms).

        Args:
            candidates: their actions.
            laws: under each candidate the law of all groups, or one for each; None: those of the settings.
        """
        lanes, shape = self.lanes, (self.n_scenarios, self.n_candidates)
        for candidate, order in enumerate(self._order):
            lanes.commit(order, [self._episodes if laws is None else self._under(laws[candidate])])
        for step in range(self.n_steps):
            own = lanes.observations[:, : self._n_own].reshape(*shape, self.n_wtg, -1).astype(np.float64)
            actions = np.clip(candidates(step, own), -1.0, 1.0)
            lanes.step(np.ascontiguousarray(actions.reshape(lanes.n_lanes, -1)))
        sums = lanes.cost_sums()
        return sums.reshape(*shape, -1)

    def _under(self, law: TrackingLaw | tuple[TrackingLaw, ...]) -> PreparedEpisodes:
        self.lanes.laws = law if isinstance(law, tuple) else (law,) * self.n_wtg
        return self.lanes.prepare(self._scenarios)

    def no_action(self, _step: int, own: Floats) -> Floats:
        """Return the zero action: a candidate that leaves everything to the law."""
        return np.zeros((*own.shape[:-1], self.n_action))

    def reference(self) -> Floats:
        """Return what :meth:`play` gives for the zero action, (n_scenarios, n_terms)."""
        with closing(self.with_candidates(1)) as alone:
            return alone.play(alone.no_action)[:, 0]

    def pinned(self, terms: Floats) -> Floats:
        """Return the costs that the leaderboard counts, (...): a failed episode's is the largest there is.

        Args:
            terms: what :meth:`play` gave, (..., n_terms).
        """
        cap = self.lanes.settings.cost_weights().cap
        worst = pinned_cost(0.0, failed=True, duration_s=self.lanes.duration_s, cap=cap)
        costs: Floats = np.where(terms[..., _FAILURE] > 0.0, worst, terms.sum(axis=-1))
        return costs

    def objective(self, terms: Floats) -> Floats:
        """Return the objective of a search over many scenarios, (...), from the result of :meth:`play`.

        In version v0 it is the cost; from v1 on what the score counts, ln(J + J0): a few failures outweigh all else in
        a mean of costs.
        """
        if self.lanes.suite.benchmark is V0:
            costs: Floats = terms.sum(axis=-1)
            return costs
        return np.log(self.pinned(terms) + COST_OFFSET)

    def close(self) -> None:
        """Stop the threads."""
        self.lanes.simulator.close()


def linear_feedback(gains: Floats) -> Candidates:
    """Return the feedback a = G o + b of a group's own observation.

    Args:
        gains: (..., n_action, n_local + 1) per candidate, the last column is b; leading axes as for scenarios and
            candidates, or fewer.
    """

    def act(_step: int, own: Floats) -> Floats:
        actions: Floats = np.einsum("...ij,...wj->...wi", gains[..., :-1], own[..., : gains.shape[-1] - 1])
        return actions + gains[..., None, :, -1]

    return act


#: What a feedback with history sees besides: slow copies of entries of a group's observation (frequency, tip-speed
#: ratio, rotor speed), and their time constants [s].
HISTORY_COLUMNS, HISTORY_TIMES_S = (0, 0, 2, 2, 3), (2.0, 10.0, 3.0, 10.0, 10.0)


def history_gains(control_dt: float) -> Floats:
    """Return the gains of the filters behind the slow copies, (n_history,)."""
    gains: Floats = -np.expm1(-control_dt / np.array(HISTORY_TIMES_S))
    return gains


def history_feedback(gains: Floats, control_dt: float) -> Candidates:
    """Return the feedback a = G (o, slow copies) + b of a group's own observation.

    Args:
        gains: (..., n_action, n_local + n_history + 1) per candidate, as for :func:`linear_feedback`.
        control_dt: control interval [s].
    """
    filters, n_local = history_gains(control_dt), gains.shape[-1] - len(HISTORY_COLUMNS) - 1
    linear = linear_feedback(gains)
    slow: Floats = np.zeros(0)

    def act(step: int, own: Floats) -> Floats:
        nonlocal slow
        seen = own[..., HISTORY_COLUMNS]
        slow = seen if step == 0 else slow + filters * (seen - slow)
        return linear(step, np.concatenate([own[..., :n_local], slow], axis=-1))

    return act


def positions(n_knots: int, n_steps: int) -> list[float]:
    """Return where steps lie between the knots of a course: 0 at the first knot, n_knots - 1 at the last."""
    found: list[float] = np.linspace(0.0, n_knots - 1.0, n_steps).tolist()
    return found


def between(knots: Floats, position: float) -> Floats:
    """Return actions at one of :func:`positions`, linear between knots (..., n_knots, n_wtg, n_action)."""
    left = min(int(position), knots.shape[-3] - 2)
    before, after = knots[..., left, :, :], knots[..., left + 1, :, :]
    actions: Floats = before + (position - left) * (after - before)
    return actions


def course(knots: Floats, n_steps: int) -> Candidates:
    """Return actions that are linear in time between knots, (n_scenarios, n_candidates, n_knots, n_wtg, n_action)."""
    steps = positions(knots.shape[2], n_steps)
    return lambda step, _own: between(knots, steps[step])


def both(one: Candidates, other: Candidates) -> Candidates:
    """Return the sum of two candidates' actions."""
    return lambda step, own: one(step, own) + other(step, own)


def difference_percent(cost: float, reference: float) -> str:
    """Return a cost's difference from the reference's, as text for a table."""
    return f"{100.0 * (cost / reference - 1.0):+.1f}"
