"""The lanes of RLlib's environment runners, and the scales that their learner sees; nothing here needs Ray."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from gymnasium.vector.utils import batch_space

from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.gains import GainEnvs

#: Observations and rewards are clipped to this many scales, as VecNormalize does.
CLIP = 10.0
_MEASURED_LANES = 128
# An entry that hardly moves at first may move later: it is not blown up any further.
_SMALLEST_STD = 0.1


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scales that observations and rewards are divided by."""

    #: mean, std: of every entry of the observation, (n_observation,).
    mean: list[float]
    std: list[float]
    reward: float = 1.0  # standard deviation of the discounted returns

    def seen(self, observations: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return observations as the learner sees them."""
        scaled = (observations - np.array(self.mean)) / np.array(self.std)
        clipped: npt.NDArray[np.float64] = np.clip(scaled, -CLIP, CLIP)
        return clipped.astype(np.float32)


def measure_scales(arguments: Mapping[str, Any], *, noise: float, gamma: float, seed: int) -> Scales:
    """Measure the scales over 128 lanes that the untrained policy plays: zero action and its exploration.

    Measured once and kept, they are the same in every runner and every learner without exchanging anything. `noise` is
    the standard deviation of the exploration [full action], `gamma` the discount per step.
    """
    envs = RunnerEnvs(_MEASURED_LANES, **arguments)
    rng = np.random.default_rng(seed)
    returns, seen, all_returns = np.zeros(_MEASURED_LANES), [], []
    with contextlib.closing(envs):
        observations, _ = envs.reset(seed=seed)
        for _ in range(envs.gains.n_steps):
            seen.append(observations)
            actions = rng.normal(0.0, noise, envs.action_space.shape).astype(np.float32)
            observations, rewards, terminated, truncated, _ = envs.step(actions)
            returns = gamma * returns + rewards
            all_returns.append(returns)
            returns = np.where(terminated | truncated, 0.0, returns)
    rows = np.concatenate(seen).astype(np.float64)
    return Scales(
        mean=rows.mean(axis=0).tolist(),
        std=np.maximum(rows.std(axis=0), _SMALLEST_STD).tolist(),
        reward=float(np.std(all_returns)),
    )


class RunnerEnvs(GainEnvs):
    """The lanes of one runner, with what RLlib does not do itself: observations and gains are scaled, clipped to ± 10.

    Every seed of a reset gives a set of seeds of its own: RLlib gives runner w the seed s + w, with which lane i + 1 of
    a runner would play the scenarios of lane i of the next one. `info` is empty, because RLlib takes it apart for every
    lane and step, which takes longer than all the rest.
    """

    def __init__(self, num_envs: int = 1, *, scales: Scales | None = None, **arguments: Any) -> None:
        super().__init__(GFMWTGVectorEnv(num_envs, **arguments))
        width = self.env.lanes.n_observation
        self._scales = scales or Scales(mean=[0.0] * width, std=[1.0] * width)
        if scales is not None:
            bound = np.full(width, CLIP, dtype=np.float32)
            self.single_observation_space = Box(-bound, bound)
            self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start all lanes and spread them over an episode."""
        if seed is not None:
            seed = np.random.SeedSequence(seed).generate_state(self.num_envs, np.uint64).tolist()
        observations, infos = super().reset(seed=seed)
        return self._scales.seen(observations), infos

    def step(self, actions: npt.NDArray[Any]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step as the native one does, with scaled observations and gains, and no info."""
        observations, gains, terminated, truncated, _ = super().step(actions)
        rewards = np.clip(gains / self._scales.reward, -CLIP, CLIP)
        return self._scales.seen(observations), rewards, terminated, truncated, {}
