"""The vector environment that learners of Stable-Baselines3 train in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from agents.gains import Gains
from agents.staggering import stagger
from wtg_gym.sb3 import SB3VecEnv

Observations = npt.NDArray[np.float32]


class StaggeredVecEnv(SB3VecEnv):
    """:class:`SB3VecEnv` that :func:`agents.staggering.stagger` spreads at every reset; takes the same arguments.

    The first episode that a lane reports is what is left of it. `reset_infos` is empty until a lane's next episode.
    """

    def reset(self) -> Observations:
        """Start an episode in every lane and spread the lanes; returns the observations (num_envs, n_observation)."""
        super().reset()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return stagger(self.vector_env)

    def set_options(self, options: Sequence[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Refuse any: spreading the lanes starts them anew, with scenarios that are drawn.

        Raises:
            ValueError: there are options.
        """
        if options and any(options):
            raise ValueError(
                f"a {type(self).__name__} draws its scenarios and takes no reset options, got {options!r:.80}"
            )
        super().set_options(options)


class GainVecEnv(StaggeredVecEnv):
    """:class:`StaggeredVecEnv` whose rewards are :class:`agents.gains.Gains`; scenarios are drawn, never given.

    Raises:
        ValueError: a scenario is given.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        if arguments.get("scenario") is not None:
            raise ValueError("scenario must be left out: the gain is over the reference in a scenario that is drawn")
        super().__init__(num_envs, **arguments)
        self._gains = Gains(self.vector_env.lanes)

    def reset(self) -> Observations:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        observations = super().reset()
        self._gains.follow(range(self.num_envs))
        return observations

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Hold the actions for one control interval in every lane; as in the class above, but for the rewards."""
        before = self._gains.reference_costs()
        observations, rewards, dones, infos = super().step_wait()
        gains = self._gains.of(before, rewards.astype(np.float64))
        self._gains.follow(np.flatnonzero(dones).tolist())
        return observations, gains.astype(np.float32), dones, infos

    def close(self) -> None:
        """Release the worker threads."""
        self._gains.close()
        super().close()


__all__ = ["GainVecEnv", "StaggeredVecEnv"]
