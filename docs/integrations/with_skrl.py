# /// script
# requires-python = ">=3.11"
# dependencies = ["skrl==2.1.1", "torch==2.13.0"]
# ///
import sys
import time

import gymnasium as gym
import torch
from gymnasium.wrappers.vector import NormalizeReward
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import StepTrainer
from skrl.utils import set_seed
from torch import nn

from wtg_gym import export_onnx

seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
torch.set_num_threads(1)
set_seed(seed)
native = gym.make_vec("wtg_gym:GFMWTG-14bus-v1", num_envs=64, n_threads=1, strategy="coordinated-tuned")
envs = NormalizeReward(native, gamma=0.998)
envs.reset(seed=seed)
env = wrap_env(envs)
spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}


def network(n_out: int) -> nn.Module:
    layers = [nn.Linear(env.observation_space.shape[0], 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()]
    last = nn.Linear(64, n_out)
    nn.init.orthogonal_(last.weight, gain=0.01)  # zero action is a good controller to begin with
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers, last)


class Policy(GaussianMixin, Model):
    def __init__(self) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=True)
        self.net = network(self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -4.0))

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
settings = {"rollouts": 64, "learning_epochs": 5, "mini_batches": 4, "learning_rate": 2e-4, "discount_factor": 0.998}
settings |= {"time_limit_bootstrap": True, "value_loss_scale": 0.5, "value_clip": 0.0}
agent = PPO(
    models={"policy": policy, "value": Value()},
    memory=RandomMemory(memory_size=64, num_envs=env.num_envs, device=env.device),
    cfg={**settings, "experiment": {"write_interval": 0, "checkpoint_interval": 0}},
    **spaces,
)
n_steps, end = 0, time.process_time() + seconds
trainer = StepTrainer(env=env, agents=agent, cfg={"timesteps": 1, "headless": True, "disable_progressbar": True})
while time.process_time() < end:
    trainer.train()
    n_steps += env.num_envs
print(n_steps, "steps")
export_onnx(policy.net, "skrl", name="my agent of skrl", strategy="coordinated-tuned", training_seed=seed)
