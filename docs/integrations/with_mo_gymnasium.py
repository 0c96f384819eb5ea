# /// script
# requires-python = ">=3.11"
# dependencies = ["mo-gymnasium==1.3.2"]
# ///
import gymnasium as gym
import mo_gymnasium as mo
import numpy as np

from wtg_gym.wrappers import VectorReward

env = VectorReward(gym.make("wtg_gym:GFMWTG-14bus-v1"), terms=("frequency", "rocof", "duty"))
weights = np.array([1.0, 1.0, 0.2])
env = mo.wrappers.LinearReward(env, weight=weights)
env.reset(seed=0)
*_, reward, _, _, info = env.step(np.zeros(8, dtype=np.float32))
print(reward, info["vector_reward"])
