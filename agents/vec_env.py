"""The vector environment that learners of Stable-Baselines3 train in."""

from __future__ import annotations

from typing import Any

from agents.gains import GainEnvs
from wtg_gym.sb3 import SB3VecEnv


class GainVecEnv(SB3VecEnv):
    """:class:`SB3VecEnv` on :class:`agents.gains.GainEnvs`.

    The first episode that a lane reports is what spreading has left of it, and its `reset_infos` is empty until then.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        self.lanes = self.vector_env.lanes
        self.vector_env = GainEnvs(self.vector_env)  # type: ignore[assignment]
