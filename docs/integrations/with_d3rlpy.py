# /// script
# requires-python = ">=3.11"
# dependencies = ["d3rlpy==2.8.0", "minari[hdf5]==0.5.4", "pillow==11.3.0", "torch==2.13.0"]
# ///
import d3rlpy
import gymnasium as gym
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer
from torch import nn

import wtg_gym

# docs/studies/minari_datasets.py makes larger ones.
env = gym.make("GFMWTG-14bus-v1", strategy="coordinated-tuned", duration_s=10.0)
episodes = []
for seed in range(4):
    observations, steps, over = [env.reset(seed=seed)[0]], [], False
    while not over:
        action = np.random.default_rng([seed, len(steps)]).normal(0.0, 0.1, 8).astype(np.float32).clip(-1.0, 1.0)
        observation, *step, _ = env.step(action)
        observations.append(observation)
        steps.append((action, *step))
        over = step[1] or step[2]
    names = ("actions", "rewards", "terminations", "truncations")
    columns = dict(zip(names, map(np.array, zip(*steps, strict=True)), strict=True))
    episodes.append(EpisodeBuffer(seed=seed, observations=np.array(observations), **columns))
dataset = minari.create_dataset_from_buffers("mine-v0", episodes, env=env)

data = d3rlpy.dataset.MDPDataset(
    observations=np.concatenate([episode.observations[:-1] for episode in dataset]),
    actions=np.concatenate([episode.actions for episode in dataset]),
    rewards=np.concatenate([episode.rewards for episode in dataset]),
    terminals=np.concatenate([episode.terminations for episode in dataset]),
    timeouts=np.concatenate([episode.truncations for episode in dataset]),
)
bc = d3rlpy.algos.BCConfig().create()
bc.fit(data, n_steps=100, n_steps_per_epoch=100)


class Actor(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.policy = bc.impl.policy

    def forward(self, observation):
        return self.policy(observation).squashed_mu


wtg_gym.export_onnx(Actor(), "bc", name="my clone", strategy="coordinated-tuned")
