"""The vector environment that learners of Stable-Baselines3 train in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding

from agents.staggering import stagger
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation.statistics import COST_OFFSET
from wtg_gym.physics.layout import LaneRow
from wtg_gym.physics.scenario import Scenario
from wtg_gym.sb3 import SB3VecEnv

Floats = npt.NDArray[np.float64]
Observations = npt.NDArray[np.float32]

#: Episodes of the reference played at once: as many as the kernels step together.
_GROUP = 16


class StaggeredVecEnv(SB3VecEnv):
    """:class:`SB3VecEnv` that :func:`agents.staggering.stagger` spreads at every reset; takes the same arguments.

    The first episode that a lane reports is what is left of it. `reset_infos` is empty until a lane's next episode.
    """

    def reset(self) -> Observations:
        """Start an episode in every lane and spread the lanes; returns the observations (num_envs, n_observation)."""
        super().reset()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return stagger(self.vector_env)


class GainVecEnv(StaggeredVecEnv):
    """:class:`StaggeredVecEnv` whose reward is the gain over the reference controller in the same scenario, in per cent.

    The reward of a step is 100 (c_ref - c) / (J_ref + J0): c is the step's cost, c_ref what the zero action pays in
    the same step of the same scenario, J_ref what it pays in the whole of it, and J0 the score's own offset.

    - Most of the cost is the doing of loads and wind, and the same for both: it drops out of the difference, and what
      the actions did stands out of the noise (common random numbers).
    - Scenarios count alike, as in the score, whose gradient this is; in the sum of the costs a few wild ones decide.

    Nothing that a learner does changes c_ref, so that the best policy stays the best; but a failure also forfeits what
    would have been gained later.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        lanes = self.vector_env.lanes
        self._reference = TaskLanes(lanes.settings, _GROUP, n_threads=1)
        self._n_steps = round(lanes.settings.episode_duration_s() / lanes.settings.control_dt)
        #: What the reference pays in each step of the lanes' episodes, and the gain that counts one per cent.
        self._costs = np.zeros((num_envs, self._n_steps))
        self._unit = np.ones(num_envs)
        self._position = np.zeros(num_envs, dtype=np.int64)
        #: Every lane's generator once more, to know its scenarios beforehand, and the next one of each if it is known.
        self._generators: list[np.random.Generator] = []
        self._next: dict[int, tuple[Scenario, Floats]] = {}

    def reset(self) -> Observations:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        self._seeds = [int(np.random.randint(2**31)) if seed is None else seed for seed in self._seeds]
        self._generators = [seeding.np_random(seed)[0] for seed in self._seeds]
        self._next = {}
        observations = super().reset()
        lanes = self.vector_env.lanes
        # Spreading has drawn more than once for most lanes.
        scenarios = [self._draw_until(lane, seed) for lane, seed in enumerate(lanes.scenario_seeds.tolist())]
        for lane, costs in enumerate(self._play(scenarios)):
            self._begin(lane, costs)
        substeps = lanes.simulator.lane_values(LaneRow.STEP)
        self._position = np.rint(substeps / lanes.simulator.plant.n_substeps).astype(np.int64)
        return observations

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Hold the actions for one control interval in every lane; as in the class above, but for the rewards."""
        observations, rewards, dones, infos = super().step_wait()
        gains = (self._costs[np.arange(self.num_envs), self._position] + rewards) / self._unit
        self._position += 1
        ended = np.flatnonzero(dones).tolist()
        if not self._next.keys() >= set(ended):
            self._look_ahead(ended)
        for lane in ended:
            scenario, costs = self._next.pop(lane)
            assert scenario.seed == self.vector_env.lanes.scenario_seeds[lane]
            self._begin(lane, costs)
        return observations, gains.astype(np.float32), dones, infos

    def _begin(self, lane: int, costs: Floats) -> None:
        """Take the costs of the reference (n_steps,) for the episode that a lane begins."""
        self._costs[lane] = costs
        self._unit[lane] = (costs.sum() + COST_OFFSET) / 100.0
        self._position[lane] = 0

    def _draw(self, lanes: Sequence[int]) -> list[Scenario]:
        return self.vector_env.lanes.draw([self._generators[lane] for lane in lanes])

    def _draw_until(self, lane: int, seed: int) -> Scenario:
        while True:
            (scenario,) = self._draw([lane])
            if scenario.seed == seed:
                return scenario

    def _look_ahead(self, ended: Sequence[int]) -> None:
        """Play the next scenarios of lanes that ended, and of those that will end first in what is left of a group."""
        unknown = [lane for lane in range(self.num_envs) if lane not in self._next]
        # Those that ended go first, then the latest ones.
        unknown.sort(key=lambda lane: (lane not in ended, -self._position[lane]))
        n_missing = sum(lane not in self._next for lane in ended)
        group = unknown[: -(-n_missing // _GROUP) * _GROUP]
        scenarios = self._draw(group)
        self._next.update(zip(group, zip(scenarios, self._play(scenarios), strict=True), strict=True))

    def _play(self, scenarios: Sequence[Scenario]) -> list[Floats]:
        """Return what the reference pays in every step of scenarios, (n_steps,) each."""
        lanes = self._reference
        zero = np.zeros((_GROUP, lanes.n_action))
        played: list[Floats] = []
        for first in range(0, len(scenarios), _GROUP):
            group = scenarios[first : first + _GROUP]
            lanes.start(list(range(len(group))), group)
            costs = np.zeros((self._n_steps, _GROUP))
            for step in range(self._n_steps):
                lanes.step(zero)
                costs[step] = -lanes.rewards
            played += list(costs.T[: len(group)])
        return played

    def close(self) -> None:
        """Release the worker threads."""
        self._reference.simulator.close()
        super().close()


__all__ = ["GainVecEnv", "StaggeredVecEnv"]
