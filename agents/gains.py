"""The reward that policies are trained with: the gain over the reference controller in the same scenario."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation.score import COST_OFFSET

Floats = npt.NDArray[np.float64]


class Gains:
    """What lanes gain over the reference, in per cent: 100 (c_ref - c) / (J_ref + J0) in each step.

    c is the step's cost, c_ref what the zero action pays in the same step of the same scenario, J_ref what it pays in
    the whole of it, and J0 the score's own offset.

    - Most of the cost is the doing of loads and wind, and the same for both: it drops out of the difference, and what
      the actions did stands out of the noise (common random numbers).
    - Scenarios count alike, as in the score; in a sum of costs a few wild ones decide.

    This is deliberately another objective than the cost. To first order its sum over an episode is what the score gains
    at the reference: each scenario weighs 1 / (J_ref + J0). And who fails pays extra: besides the cost of the failure,
    what c_ref would still have brought is forfeited. The policy that is best by it need not be the one with the least
    mean cost.

    Args:
        lanes: the episodes. What the reference pays in one of them is played once, when it begins.
    """

    def __init__(self, lanes: TaskLanes) -> None:
        self._lanes = lanes
        self._reference = TaskLanes(lanes.settings, 1)
        self.n_steps = round(lanes.settings.episode_duration_s() / lanes.settings.control_dt)
        self._costs = np.zeros((lanes.n_lanes, self.n_steps))
        #: The cost that counts one per cent.
        self._units = np.ones(lanes.n_lanes)

    def follow(self, lanes: Iterable[int]) -> None:
        """Let the reference play the scenarios that lanes play now."""
        zero = np.zeros((1, self._lanes.n_action))
        for lane in lanes:
            self._reference.start([0], self._lanes.scenarios([int(self._lanes.scenario_seeds[lane])]))
            self._costs[lane] = 0.0
            for step in range(self.n_steps):
                self._reference.step(zero)
                self._costs[lane, step] = -self._reference.rewards[0]
                if self._reference.outputs.terminated[0]:
                    break
            self._units[lane] = (self._costs[lane].sum() + COST_OFFSET) / 100.0

    def reference_costs(self) -> Floats:
        """Return what the reference pays in the step that each lane takes next, (n_lanes,)."""
        simulator = self._lanes.simulator
        steps = np.rint(simulator.lane_values("step") / simulator.plant.n_substeps).astype(np.int64)
        # An episode that is over takes no more.
        costs: Floats = self._costs[np.arange(self._lanes.n_lanes), np.minimum(steps, self.n_steps - 1)]
        return costs

    def of(self, reference_costs: Floats, rewards: Floats) -> Floats:
        """Return the gains of a step [%], (n_lanes,).

        Args:
            reference_costs: what :meth:`reference_costs` said before the step.
            rewards: of the step.
        """
        gains: Floats = (reference_costs + rewards) / self._units
        return gains

    def close(self) -> None:
        """Release the worker threads."""
        self._reference.simulator.close()


__all__ = ["Gains"]
