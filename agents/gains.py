"""The lanes that policies are trained in: their reward, and the points of their episodes at which they start."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorWrapper

from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation.score import COST_OFFSET

Floats = npt.NDArray[np.float64]


class Gains:
    """Gains of lanes over the reference, in per cent: 100 (c_ref - c) / (J_ref + J0) in each step.

    The reference is the law that scores 100: in v0 the zero action, in v1 that law tuned to its grid. c is the step's
    cost, c_ref the reference's in the same step of the same scenario, J_ref its sum over the episode, and J0 the
    score's offset.

    - Loads and wind cause most of the cost, alike for both: the difference leaves what the actions changed (common
      random numbers).
    - Scenarios count alike, as in the score; in a sum of costs a few wild ones decide.

    This is deliberately another objective than the cost. To first order its sum over an episode is what the score gains
    at the reference: each scenario weighs 1 / (J_ref + J0). A failure costs extra: besides its own cost it forfeits
    what c_ref would still have brought. The policy that is best by it need not have the least mean pinned cost.

    Args:
        lanes: the episodes. The reference plays the scenario of each once, when it begins.
    """

    def __init__(self, lanes: TaskLanes) -> None:
        self._lanes = lanes
        benchmark = lanes.settings.benchmark()
        self._reference = TaskLanes(replace(lanes.settings, strategy=benchmark.hundred), 1)
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
        """Return the reference's costs in the step that each lane takes next, (n_lanes,)."""
        simulator = self._lanes.simulator
        steps = np.rint(simulator.lane_values("step") / simulator.plant.n_substeps).astype(np.int64)
        # An episode that is over takes no more.
        costs: Floats = self._costs[np.arange(self._lanes.n_lanes), np.minimum(steps, self.n_steps - 1)]
        return costs

    def of(self, reference_costs: Floats, rewards: Floats) -> Floats:
        """Return the gains of a step [%], (n_lanes,), from :meth:`reference_costs` before it and its rewards."""
        gains: Floats = (reference_costs + rewards) / self._units
        return gains

    def close(self) -> None:
        """Release the worker threads."""
        self._reference.simulator.close()


def stagger(env: GFMWTGVectorEnv) -> npt.NDArray[np.float32]:
    """Spread lanes that have just been reset evenly over an episode, under the zero action.

    Lanes that start together stay together as long as episodes are equally long: a rollout would show the same few
    seconds of all of them, and the learner would swing from one part of an episode to the next.

    Returns:
        the observations (num_envs, n_observation) to go on from.
    """
    n_steps = round(env.settings.episode_duration_s() / env.settings.control_dt)
    starts = np.arange(env.num_envs) * n_steps // env.num_envs
    actions = np.zeros(env.action_space.shape or (), dtype=np.float32)
    for step in range(n_steps):
        mask = starts == step
        if mask.any():
            env.reset(options={"reset_mask": mask})
        observations, _, terminated, truncated, _ = env.step(actions)
    over = terminated | truncated
    if env.autoreset_mode == AutoresetMode.NEXT_STEP and over.any():
        # What a reset returns may not be over already.
        observations, _ = env.reset(options={"reset_mask": over})
    return observations


class GainEnvs(VectorWrapper):
    """The native vector environment with :class:`Gains` as rewards, and lanes that every reset spreads.

    Spreading starts the lanes anew, so that reset options are lost, and the first info is empty.
    """

    env: GFMWTGVectorEnv

    def __init__(self, env: GFMWTGVectorEnv) -> None:
        super().__init__(env)
        self.gains = Gains(env.lanes)
        self._within_step = env.autoreset_mode == AutoresetMode.SAME_STEP
        self._ended = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        self.env.reset(seed=seed)
        observations = stagger(self.env)
        self._ended[:] = False
        self.gains.follow(range(self.num_envs))
        return observations, {}

    def step(self, actions: npt.NDArray[Any]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step as the native one does, with other rewards."""
        beginning, references = self._ended, self.gains.reference_costs()
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if self._within_step:
            # Stable-Baselines3 has them in single precision.
            rewards = rewards.astype(np.float32).astype(np.float64)
        # A lane that only begins its next episode gains nothing.
        gains = np.where(beginning, 0.0, self.gains.of(references, rewards))
        over = terminated | truncated
        self.gains.follow(np.flatnonzero(over if self._within_step else beginning).tolist())
        self._ended = over & (not self._within_step)
        return observations, gains, terminated, truncated, infos

    def close(self, **kwargs: Any) -> None:
        """Release the worker threads."""
        self.gains.close()
        super().close(**kwargs)
