"""The lanes of RLlib's environment runners; nothing here needs Ray."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from agents.gains import Gains, stagger
from wtg_gym.envs import GFMWTGVectorEnv

#: Largest gain of a step that is learned from [%].
_LARGEST_GAIN = 10.0


class RunnerEnvs(GFMWTGVectorEnv):
    """The lanes of one runner: the native vector environment, with the parts that RLlib does not do itself.

    Rewards are :class:`agents.gains.Gains`. Lanes start spread over an episode (:func:`agents.gains.stagger`). Every
    seed of a reset gives a set of seeds of its own: RLlib gives runner w the seed s + w, with which lane i + 1 of a
    runner would play the scenarios of lane i of the next one. `info` is empty, because RLlib takes it apart for every
    lane and step, which takes longer than all the rest.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        self.gains = Gains(self.lanes)
        self._ended = np.zeros(num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start all lanes and spread them over an episode; or, with options, as the native one does."""
        if seed is not None:
            seed = np.random.SeedSequence(seed).generate_state(self.num_envs, np.uint64).tolist()
        observations, _ = super().reset(seed=seed, options=options)
        if options:
            self._ended &= ~np.asarray(options.get("reset_mask", True))
            return observations, {}
        self._ended[:] = False
        observations = stagger(self)
        if self._ended.any():
            # RLlib takes what a reset returns as the beginning of an episode, which may not be over already.
            observations, _ = self.reset(options={"reset_mask": self._ended.copy()})
        self.gains.follow(range(self.num_envs))
        return observations, {}

    def step(
        self, actions: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Step as the native one does, with other rewards and no info."""
        beginning = self._ended
        references = self.gains.reference_costs()
        observations, rewards, terminated, truncated, _ = super().step(actions)
        # A lane that only begins its next episode gains nothing.
        gains = np.where(beginning, 0.0, self.gains.of(references, rewards))
        self.gains.follow(np.flatnonzero(beginning).tolist())
        self._ended = terminated | truncated
        return observations, np.clip(gains, -_LARGEST_GAIN, _LARGEST_GAIN), terminated, truncated, {}

    def close_extras(self, **kwargs: Any) -> None:
        """Release the worker threads."""
        self.gains.close()
        super().close_extras(**kwargs)
