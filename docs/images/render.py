"""`python docs/images/render.py FILE.png`: the last frame of an episode without action."""

import sys

import gymnasium as gym
import numpy as np
from PIL import Image

env = gym.make("wtg_gym:GFMWTG-14bus-v0", suite="weak-grid", duration_s=30.0, render_mode="rgb_array")
env.reset(seed=5)
over = False
while not over:
    *_, terminated, truncated, _ = env.step(np.zeros(4, dtype=np.float32))
    over = terminated or truncated
Image.fromarray(env.render()).save(sys.argv[1], optimize=True)
env.close()
