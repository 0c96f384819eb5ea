# /// script
# requires-python = ">=3.11"
# dependencies = ["stable-baselines3==2.9.2", "sb3-contrib==2.9.2", "torch==2.13.0"]
# ///
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO

from wtg_gym import evaluate, export_onnx
from wtg_gym.sb3 import DeterministicPolicy, make_sb3_vec_env

envs = make_sb3_vec_env(64, seed=0, suite="standard-v1", strategy="coordinated-tuned")
for algorithm, network in ((PPO, "MlpPolicy"), (RecurrentPPO, "MlpLstmPolicy")):
    model = algorithm(network, envs, n_steps=16, batch_size=256, policy_kwargs={"log_std_init": -3.0})
    model.learn(total_timesteps=1024)
    name = f"my {algorithm.__name__}"
    folder = export_onnx(DeterministicPolicy(model), algorithm.__name__, name=name, strategy="coordinated-tuned")
    print(evaluate(folder, "standard-v1", seeds=range(10_000, 10_004)))
