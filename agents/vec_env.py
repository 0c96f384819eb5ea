"""The vector environment that learners of Stable-Baselines3 train in."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from agents.staggering import stagger
from wtg_gym.sb3 import SB3VecEnv


class StaggeredVecEnv(SB3VecEnv):
    """:class:`SB3VecEnv` that :func:`agents.staggering.stagger` spreads at every reset; takes the same arguments.

    The first episode that a lane reports is what is left of it. `reset_infos` is empty until a lane's next episode.
    """

    def reset(self) -> npt.NDArray[np.float32]:
        """Start an episode in every lane and spread the lanes; returns the observations (num_envs, n_observation)."""
        super().reset()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return stagger(self.vector_env)


__all__ = ["StaggeredVecEnv"]
