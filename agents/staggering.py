"""Lanes that are each at another point of their episode.

Lanes that are all started together stay together for as long as episodes are equally long: a rollout then shows the
same few seconds of all of them, and the learner swings from one part of an episode to the next.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from wtg_gym.envs import GFMWTGVectorEnv

Observations = npt.NDArray[np.float32]


def stagger(env: GFMWTGVectorEnv) -> Observations:
    """Spread lanes that have just been reset evenly over an episode, under the reference controller.

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
        observations, *_ = env.step(actions)
    return observations


__all__ = ["stagger"]
