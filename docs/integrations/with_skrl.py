# /// script
# requires-python = ">=3.11"
# dependencies = ["skrl==2.1.1", "torch==2.13.0"]
# ///
import gymnasium as gym
import torch
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from torch import nn

import wtg_gym

env = wrap_env(gym.make_vec("GFMWTG-14bus-v1", num_envs=16, strategy="coordinated-tuned"))
spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}


def network(n_out: int) -> nn.Module:
    return nn.Sequential(nn.Linear(env.observation_space.shape[0], 64), nn.Tanh(), nn.Linear(64, n_out))


class Policy(GaussianMixin, Model):
    def __init__(self) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=True)
        self.net = network(self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -3.0))

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    def __init__(self) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = network(1)

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {}


policy = Policy()
memory = RandomMemory(memory_size=16, num_envs=env.num_envs, device=env.device)
agent = PPO(models={"policy": policy, "value": Value()}, memory=memory, **spaces)
SequentialTrainer(env=env, agents=agent, cfg={"timesteps": 64, "headless": True}).train()
wtg_gym.export_onnx(policy.net, "skrl", name="my skrl agent", strategy="coordinated-tuned")
