# /// script
# requires-python = ">=3.11"
# dependencies = ["mo-gymnasium==1.3.2"]
# ///
import gymnasium as gym
import mo_gymnasium as mo
import numpy as np


class VectorReward(gym.Wrapper):
    """Minus terms of the cost: all of them together are the environment's own reward."""

    def __init__(self, env, terms):
        super().__init__(env)
        self.terms, zero = terms, np.zeros(len(terms))
        # MO-Gymnasium looks for it in the innermost environment.
        self.unwrapped.reward_space = gym.spaces.Box(zero - np.inf, zero, dtype=np.float64)

    def step(self, action):
        """Hold the action for one control interval; the reward is a vector."""
        observation, _, *ends, info = self.env.step(action)
        return observation, -np.array([info[f"cost_{term}"] for term in self.terms]), *ends, info


env = VectorReward(gym.make("wtg_gym:GFMWTG-14bus-v1"), terms=("frequency", "rocof", "duty"))
weights = np.array([1.0, 1.0, 0.2])
env = mo.wrappers.LinearReward(env, weight=weights)
env.reset(seed=0)
*_, reward, _, _, info = env.step(np.zeros(8, dtype=np.float32))
print(reward, info["vector_reward"])
