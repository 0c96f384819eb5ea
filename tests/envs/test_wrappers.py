"""Facts about the wrappers."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.wrappers import VectorReward


@pytest.mark.parametrize("version", ["v0", "v1"])
def test_vector_of_rewards_adds_up_to_the_reward(version: str) -> None:
    make = f"wtg_gym:GFMWTG-14bus-{version}"
    plain, many = gym.make(make), VectorReward(gym.make(make))
    few = VectorReward(gym.make(make), terms=("duty", "frequency"))
    for env in (plain, many, few):
        env.reset(seed=3)
    largest = np.zeros(len(COST_TERMS))
    for step in range(100):
        action = np.full(plain.action_space.shape, 0.5 * np.sin(step), dtype=np.float32)
        one, reward, *ends, _ = plain.step(action)
        other, rewards, *others, info = many.step(action)
        assert np.array_equal(one, other) and ends == others and rewards in many.reward_space
        assert abs(rewards.sum() - reward) <= 1e-12 * max(1.0, abs(reward))
        assert np.array_equal(few.step(action)[1], [-info["cost_duty"], -info["cost_frequency"]])
        largest = np.maximum(largest, -rewards)
    assert (largest > 0.0).sum() >= 3
    assert many.unwrapped.reward_space is many.reward_space and many.reward_space.shape == (len(COST_TERMS),)
