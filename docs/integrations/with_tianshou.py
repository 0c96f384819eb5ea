# /// script
# requires-python = ">=3.11"
# dependencies = ["tianshou==2.0.1", "torch==2.13.0"]
# ///
import sys
import time

import gymnasium as gym
import torch
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch import nn
from torch.distributions import Independent, Normal

from wtg_gym import export_onnx

seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
torch.set_num_threads(1)
torch.manual_seed(seed)


def make() -> gym.Env:
    return gym.make("wtg_gym:GFMWTG-14bus-v1", strategy="coordinated-tuned")


env, envs = make(), DummyVectorEnv([make] * 16)
envs.seed(seed)
nets = [Net(state_shape=env.observation_space.shape, hidden_sizes=[64, 64], activation=nn.Tanh) for _ in range(2)]
actor = ContinuousActorProbabilistic(preprocess_net=nets[0], action_shape=env.action_space.shape, unbounded=True)
nn.init.zeros_(actor.mu.model[-1].weight)  # zero action is a good controller to begin with, and noise costs
nn.init.zeros_(actor.mu.model[-1].bias)
nn.init.constant_(actor.sigma_param, -4.0)
ppo = PPO(
    policy=ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda given: Independent(Normal(*given), 1),
        action_space=env.action_space,
        action_scaling=False,
        action_bound_method=None,
    ),
    critic=ContinuousCritic(preprocess_net=nets[1]),
    optim=AdamOptimizerFactory(lr=2e-4),
    gamma=0.998,
    ent_coef=0.0,
    vf_coef=0.5,
    max_grad_norm=0.5,
    return_scaling=True,
)
trainer = ppo.create_trainer(
    OnPolicyTrainerParams(
        training_collector=Collector(ppo, envs, VectorReplayBuffer(4096, 16)),
        epoch_num_steps=4096,
        collection_step_num_env_steps=4096,
        batch_size=1024,
        update_step_num_repetitions=5,
        show_progress=False,
        verbose=False,
    )
)
trainer.reset()
n_steps, end = 0, time.process_time() + seconds
while time.process_time() < end:
    trainer.execute_epoch()
    n_steps += 4096
print(n_steps, "steps")


class Mean(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation):
        (mean, _), _ = self.actor(observation)
        return mean


export_onnx(Mean(), "tianshou", name="my agent of Tianshou", strategy="coordinated-tuned", training_seed=seed)
