"""`python docs/images/render.py V0.png V1.png`: the last frame of an episode without action in each version."""

import sys
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image

from wtg_gym.scenarios import get_suite


def draw(path: str, env_id: str, how: dict[str, Any], **settings: Any) -> None:
    env = gym.make(f"wtg_gym:{env_id}", render_mode="rgb_array", **settings)
    env.reset(**how)
    action = np.zeros_like(env.action_space.sample())
    over = False
    while not over:
        *_, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    Image.fromarray(env.render()).save(path, optimize=True)
    env.close()


faults = get_suite("faults-v1").scenario(10037)
draw(sys.argv[1], "GFMWTG-14bus-v0", {"seed": 5}, suite="weak-grid", duration_s=30.0)
draw(sys.argv[2], "GFMWTG-14bus-v1", {"options": {"scenario": faults}}, suite="faults")
