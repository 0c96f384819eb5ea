# /// script
# requires-python = ">=3.11"
# dependencies = ["tianshou==2.0.1", "torch==2.13.0"]
# ///
import gymnasium as gym
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


def make() -> gym.Env:
    return gym.make("wtg_gym:GFMWTG-14bus-v1", strategy="coordinated-tuned")


env, envs = make(), DummyVectorEnv([make] * 4)
actor, critic = (Net(state_shape=env.observation_space.shape, hidden_sizes=[64], activation=nn.Tanh) for _ in range(2))
policy = ProbabilisticActorPolicy(
    actor=ContinuousActorProbabilistic(preprocess_net=actor, action_shape=env.action_space.shape, unbounded=True),
    dist_fn=lambda parameters: Independent(Normal(*parameters), 1),
    action_space=env.action_space,
)
ppo = PPO(policy=policy, critic=ContinuousCritic(preprocess_net=critic), optim=AdamOptimizerFactory(lr=3e-4))
collector = Collector(ppo, envs, VectorReplayBuffer(1024, 4))
ppo.run_training(
    OnPolicyTrainerParams(
        training_collector=collector,
        max_epochs=1,
        epoch_num_steps=512,
        collection_step_num_env_steps=256,
        show_progress=False,
    )
)


class Mean(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.actor = policy.actor

    def forward(self, observation):
        (mean, _), _ = self.actor(observation)
        return mean


export_onnx(Mean(), "tianshou", name="my Tianshou agent", strategy="coordinated-tuned")
