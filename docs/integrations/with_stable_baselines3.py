# /// script
# requires-python = ">=3.11"
# dependencies = ["stable-baselines3==2.9.2", "torch==2.13.0"]
# ///
import sys
import time

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from wtg_gym import export_onnx
from wtg_gym.sb3 import DeterministicPolicy, make_sb3_vec_env

torch.set_num_threads(1)
seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
lanes = make_sb3_vec_env(64, seed=seed, n_threads=1, strategy="coordinated-tuned")
envs = VecNormalize(lanes, norm_obs=False, gamma=0.998)
ppo = PPO(
    "MlpPolicy",
    envs,
    seed=seed,
    n_steps=64,
    batch_size=1024,
    n_epochs=5,
    learning_rate=2e-4,
    gamma=0.998,
    policy_kwargs={"log_std_init": -4.0},  # more noise than that costs more than there is to learn
)
end = time.process_time() + seconds
ppo.learn(10**9, callback=lambda *_: time.process_time() < end)
print(ppo.num_timesteps, "steps")
name = "my agent of Stable-Baselines3"
export_onnx(DeterministicPolicy(ppo), "stable_baselines3", name=name, strategy="coordinated-tuned", training_seed=seed)
