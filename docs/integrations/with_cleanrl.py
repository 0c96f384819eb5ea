# /// script
# requires-python = ">=3.11"
# dependencies = ["torch==2.13.0"]
# ///
import gymnasium as gym
import torch
from torch import nn

import wtg_gym

envs = gym.make_vec("GFMWTG-14bus-v1", num_envs=64, strategy="coordinated-tuned")  # in CleanRL's files: envs = …
actor = nn.Sequential(nn.Linear(envs.single_observation_space.shape[0], 64), nn.Tanh(), nn.Linear(64, 8))
observations, _ = envs.reset(seed=0)
for _ in range(16):  # and the loop of ppo_continuous_action.py, with its update
    with torch.no_grad():
        actions = torch.distributions.Normal(actor(torch.as_tensor(observations)), 0.05).sample()
    observations, rewards, terminations, truncations, infos = envs.step(actions.numpy())
wtg_gym.export_onnx(actor, "cleanrl", name="my CleanRL agent", strategy="coordinated-tuned")
