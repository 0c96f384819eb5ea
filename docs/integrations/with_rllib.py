# /// script
# requires-python = ">=3.11"
# dependencies = ["ray[rllib]==2.60.0", "gymnasium==1.2.2", "torch==2.13.0"]
# ///
import argparse
import time

import numpy as np
import ray
import torch
from gymnasium.wrappers.vector import NormalizeReward
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core.models.base import ACTOR, ENCODER_OUT
from ray.rllib.core.rl_module import RLModuleSpec
from ray.tune import register_env
from torch import nn

from wtg_gym import export_onnx
from wtg_gym.envs import GFMWTGVectorEnv


class Batch(NormalizeReward):
    """The native batch. RLlib takes infos apart, step by step, which takes longer than all the rest."""

    def __init__(self, num_envs=1, **arguments):
        super().__init__(GFMWTGVectorEnv(num_envs, **arguments), gamma=0.998)

    def reset(self, *, seed=None, options=None):
        # RLlib gives runner w the seed s + w: without this, it would play the scenarios of the next runner.
        seeds = None if seed is None else np.random.SeedSequence(seed).generate_state(self.num_envs, np.uint64).tolist()
        return super().reset(seed=seeds, options=options)

    def step(self, actions):
        *rest, _ = super().step(actions)
        return *rest, {}


class Module(DefaultPPOTorchRLModule):
    """Starts at zero action, which is a good controller, and explores little, because noise costs."""

    def setup(self):
        super().setup()
        nn.init.zeros_(self.pi.net.mlp[-1].weight)
        nn.init.zeros_(self.pi.net.mlp[-1].bias)
        nn.init.constant_(self.pi.log_std, -4.0)


class Mean(nn.Module):
    def __init__(self, module):
        super().__init__()
        self.encoder, self.net = module.encoder, module.pi.net

    def forward(self, observation):
        return self.net(self.encoder({"obs": observation})[ENCODER_OUT][ACTOR])


parser = argparse.ArgumentParser()
parser.add_argument("seconds", type=int, nargs="?", default=5, help="processor time, on a cluster wall time")
parser.add_argument("seed", type=int, nargs="?", default=0)
parser.add_argument("--address", help="Ray cluster to join, such as auto or HOST:6379 (default: this process)")
arguments = parser.parse_args()
torch.set_num_threads(1)
register_env("batch", lambda config: Batch(**config))
if arguments.address:
    ray.init(arguments.address)
    n_runners, clock = max(1, int(ray.cluster_resources()["CPU"]) - 1), time.monotonic
else:
    ray.init(num_cpus=2, include_dashboard=False)
    n_runners, clock = 0, time.process_time
batch_size = 4096 * max(1, n_runners)
network = {"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh", "vf_share_layers": False, "free_log_std": True}
config = (
    PPOConfig()
    .environment("batch", env_config={"n_threads": 1, "strategy": "coordinated-tuned"})
    .env_runners(num_env_runners=n_runners, num_envs_per_env_runner=64, gym_env_vectorize_mode="vector_entry_point")
    .rl_module(rl_module_spec=RLModuleSpec(module_class=Module, model_config=network))
    .training(train_batch_size_per_learner=batch_size, minibatch_size=batch_size // 4, num_epochs=5)
    .training(lr=2e-4, gamma=0.998, lambda_=0.95, grad_clip=0.5, clip_param=0.2)
    .training(use_kl_loss=False, vf_loss_coeff=0.5, vf_clip_param=float("inf"))
    .debugging(seed=arguments.seed)
)
algorithm = config.build_algo()
end = clock() + arguments.seconds
while clock() < end:
    result = algorithm.train()
print(int(result["num_env_steps_sampled_lifetime"]), "steps")
actor = Mean(algorithm.get_module())
export_onnx(actor, "rllib", name="my agent of RLlib", strategy="coordinated-tuned", training_seed=arguments.seed)
algorithm.stop()
