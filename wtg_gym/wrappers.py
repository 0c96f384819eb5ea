"""Wrappers for other kinds of learning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from wtg_gym.envs import GFMWTGEnv
from wtg_gym.envs.task_records import COST_TERMS

Floats = npt.NDArray[np.float64]


class VectorReward(gym.Wrapper[Any, Any, Any, Any]):
    """Rewards of several objectives, as MO-Gymnasium has them: minus each term of the cost, (n_terms,) float64.

    Their sum over all terms is the environment's own reward. Weights of the terms are the benchmark's.

    Args:
        env: an environment of this package.
        terms: names of the cost's terms in the order of the rewards; by default all, see
            :data:`wtg_gym.envs.task_records.COST_TERMS`.

    Raises:
        ValueError: a term is unknown or named twice, there is none, or the environment is none of this package.
    """

    def __init__(self, env: gym.Env[Any, Any], terms: Sequence[str] = COST_TERMS) -> None:
        super().__init__(env)
        if not isinstance(self.unwrapped, GFMWTGEnv):
            raise ValueError(f"env must be a GFMWTGEnv, which tells the terms of its cost, got {self.unwrapped}")
        names = terms if isinstance(terms, (list, tuple)) else ()
        if not names or any(names.count(name) != (name in COST_TERMS) for name in names):
            raise ValueError(f"terms must be a list of some of {', '.join(COST_TERMS)}, each once, got {terms!r}")
        self.terms = tuple(names)
        high = np.zeros(len(self.terms), dtype=np.float64)
        #: Of the rewards; MO-Gymnasium looks for it in the innermost environment.
        self.reward_space = gym.spaces.Box(np.full_like(high, -np.inf), high, dtype=np.float64)
        self.unwrapped.reward_space = self.reward_space  # type: ignore[attr-defined]

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Hold the action for one control interval; the reward is a vector, all else as it is."""
        observation, _, terminated, truncated, info = self.env.step(action)
        rewards: Floats = -np.array([info[f"cost_{term}"] for term in self.terms], dtype=np.float64)
        return observation, rewards, terminated, truncated, info
