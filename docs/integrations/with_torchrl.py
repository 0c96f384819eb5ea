# /// script
# requires-python = ">=3.11"
# dependencies = ["torchrl==0.14.1", "torch==2.13.0"]
# ///
import sys
import time

import gymnasium as gym
import torch
from gymnasium.vector import AutoresetMode, VectorWrapper
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper, RewardScaling, TransformedEnv
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from wtg_gym import export_onnx

seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
torch.set_num_threads(1)
torch.manual_seed(seed)


class Batch(VectorWrapper):
    """The native batch; TorchRL takes numbers alone in the infos, and asks for the mode."""

    autoreset_mode = AutoresetMode.SAME_STEP

    def step(self, actions):
        *rest, infos = super().step(actions)
        return *rest, {name: infos[name] for name in infos if name in ("final_obs", "_final_obs")}


task = {"strategy": "coordinated-tuned", "autoreset_mode": Batch.autoreset_mode}
native = Batch(gym.make_vec("wtg_gym:GFMWTG-14bus-v1", num_envs=64, n_threads=1, **task))
native.reset(seed=seed)
env = TransformedEnv(GymWrapper(native), RewardScaling(loc=0.0, scale=0.1))  # to returns of about one
n_observation, n_action = (space.shape[0] for space in (native.single_observation_space, native.single_action_space))


def network(n_out: int) -> nn.Sequential:
    last = nn.Linear(64, n_out)
    nn.init.orthogonal_(last.weight, 0.01)  # zero action is a good controller to begin with, and noise costs
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(n_observation, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), last)


mean = network(n_action)
noise = AddStateIndependentNormalScale(n_action, scale_mapping="exp")
nn.init.constant_(noise.state_independent_scale, -4.0)
actor = ProbabilisticActor(
    TensorDictModule(nn.Sequential(mean, noise), in_keys=["observation"], out_keys=["loc", "scale"]),
    in_keys=["loc", "scale"],
    distribution_class=IndependentNormal,
    return_log_prob=True,
)
critic = ValueOperator(network(1), in_keys=["observation"])
advantage = GAE(gamma=0.998, lmbda=0.95, value_network=critic)
loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_bonus=False, critic_coeff=0.5, normalize_advantage=True)
optimizer = torch.optim.Adam(loss.parameters(), lr=2e-4)
collector = Collector(env, actor, frames_per_batch=4096, total_frames=-1, trust_policy=True)
n_steps, end = 0, time.process_time() + seconds
for batch in collector:
    for _ in range(5):
        with torch.no_grad():
            advantage(batch)
        rows = batch.reshape(-1)
        for chosen in torch.randperm(len(rows)).chunk(4):
            losses = loss(rows[chosen])
            optimizer.zero_grad()
            (losses["loss_objective"] + losses["loss_critic"]).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimizer.step()
    n_steps += len(rows)
    if time.process_time() > end:
        break
print(n_steps, "steps")
export_onnx(mean, "torchrl", name="my agent of TorchRL", strategy="coordinated-tuned", training_seed=seed)
collector.shutdown()
