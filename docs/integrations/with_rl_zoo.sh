# /// script
# requires-python = ">=3.11"
# dependencies = ["rl_zoo3==2.9.2", "stable-baselines3==2.9.2", "sb3-contrib==2.9.2", "pandas<3", "requests>=2", "torch==2.13.0"]
# ///
python -m rl_zoo3.train --algo ppo --gym-packages wtg_gym --env GFMWTG-14bus-v1 --n-timesteps 1024 \
    --hyperparams n_envs:2 n_steps:64 batch_size:64 --eval-freq -1 --log-folder logs
