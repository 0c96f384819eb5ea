# /// script
# requires-python = ">=3.11"
# dependencies = ["stable-baselines3==2.9.2", "torch==2.13.0"]
# ///
import sys
import time

import torch
from stable_baselines3 import PPO

from wtg_gym import export_onnx
from wtg_gym.sb3 import DeterministicPolicy, make_sb3_vec_env

torch.set_num_threads(1)
seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
envs = make_sb3_vec_env(64, seed=seed, n_threads=1, strategy="coordinated-tuned")
noise = {"log_std_init": -2.5}  # more costs more than there is to learn
ppo = PPO("MlpPolicy", envs, seed=seed, n_steps=90, batch_size=2880, policy_kwargs=noise)
end = time.process_time() + seconds
ppo.learn(10**9, callback=lambda *_: time.process_time() < end)
print(ppo.num_timesteps, "steps")
name = "my agent of Stable-Baselines3"
export_onnx(DeterministicPolicy(ppo), "stable_baselines3", name=name, strategy="coordinated-tuned", training_seed=seed)
