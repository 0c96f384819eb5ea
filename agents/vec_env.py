"""The vector environment that learners of Stable-Baselines3 train in."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from agents.gains import Gains, stagger
from wtg_gym.sb3 import SB3VecEnv

Observations = npt.NDArray[np.float32]


class GainVecEnv(SB3VecEnv):
    """:class:`SB3VecEnv` with the rewards of :class:`agents.gains.Gains` and lanes that every reset spreads.

    Scenarios are drawn: spreading starts the lanes anew, so that reset options are lost. The first episode that a lane
    reports is what spreading has left of it, and `reset_infos` is empty until its next one.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        self._gains = Gains(self.vector_env.lanes)

    def reset(self) -> Observations:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        super().reset()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observations = stagger(self.vector_env)
        self._gains.follow(range(self.num_envs))
        return observations

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Hold the actions for one control interval in every lane; returns observations, gains, dones and infos."""
        before = self._gains.reference_costs()
        observations, rewards, dones, infos = super().step_wait()
        gains = self._gains.of(before, rewards.astype(np.float64))
        self._gains.follow(np.flatnonzero(dones).tolist())
        return observations, gains.astype(np.float32), dones, infos

    def close(self) -> None:
        """Release the worker threads."""
        self._gains.close()
        super().close()
