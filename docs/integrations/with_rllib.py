# /// script
# requires-python = ">=3.11"
# dependencies = ["ray[rllib]==2.60.0", "gymnasium==1.2.2", "torch==2.13.0"]
# ///
import sys
import time

import gymnasium as gym
import ray
import torch
from gymnasium.wrappers import NormalizeReward
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core.models.base import ACTOR, ENCODER_OUT
from ray.rllib.core.rl_module import RLModuleSpec
from ray.tune import register_env
from torch import nn

from wtg_gym import export_onnx


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


seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
torch.set_num_threads(1)
task = {"id": "wtg_gym:GFMWTG-14bus-v1", "strategy": "coordinated-tuned"}
register_env("wtg", lambda config: NormalizeReward(gym.make(**task), gamma=0.998))
ray.init(num_cpus=2, include_dashboard=False)
network = {"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh", "vf_share_layers": False, "free_log_std": True}
config = (
    PPOConfig()
    .environment("wtg")
    .env_runners(num_env_runners=0, num_envs_per_env_runner=16)
    .rl_module(rl_module_spec=RLModuleSpec(module_class=Module, model_config=network))
    .training(train_batch_size_per_learner=4096, minibatch_size=1024, num_epochs=5, lr=2e-4, gamma=0.998, lambda_=0.95)
    .training(use_kl_loss=False, vf_loss_coeff=0.5, vf_clip_param=float("inf"), grad_clip=0.5, clip_param=0.2)
    .debugging(seed=seed)
)
algorithm = config.build_algo()
end = time.process_time() + seconds
while time.process_time() < end:
    result = algorithm.train()
print(result["num_env_steps_sampled_lifetime"], "steps")
actor = Mean(algorithm.get_module())
export_onnx(actor, "rllib", name="my agent of RLlib", strategy="coordinated-tuned", training_seed=seed)
algorithm.stop()
