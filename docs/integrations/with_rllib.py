# /// script
# requires-python = ">=3.11"
# dependencies = ["ray[rllib]==2.60.0", "gymnasium==1.2.2", "torch==2.13.0"]
# ///
import ray
from ray.rllib.algorithms.ppo import PPOConfig

import wtg_gym  # noqa: F401

ray.init(num_cpus=2, include_dashboard=False)
config = (
    PPOConfig()
    .environment("GFMWTG-14bus-v1", env_config={"strategy": "coordinated-tuned"})
    .env_runners(num_env_runners=0, num_envs_per_env_runner=4)
    .training(train_batch_size_per_learner=512, minibatch_size=128, num_epochs=1)
)
algorithm = config.build_algo()
print(algorithm.train()["num_env_steps_sampled_lifetime"], "steps")
algorithm.stop()
