"""Facts about training one policy that every WTG group plays by itself."""

import numpy as np
import pytest
import torch
from torch import nn

from agents.multi_agent import AgentVecEnv, SharedPolicy
from wtg_gym.envs import EnvSettings
from wtg_gym.sb3 import SB3VecEnv

SHORT = {"version": "v0", "duration_s": 5.0, "strategy": "mppt"}


def test_lanes_are_the_groups_of_the_episodes():
    arguments = {**SHORT, "groups": 3}
    episodes, groups = SB3VecEnv(2, reward="score", **arguments), AgentVecEnv(SB3VecEnv(2, reward="score", **arguments))
    for env in (episodes, groups):
        env.seed(3)
    seen, split = episodes.reset(), groups.reset()
    names = episodes.lanes.observation_names
    assert (groups.num_envs, groups.n_wtg) == (6, 3)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(60):
        for lane in range(6):
            episode, group = divmod(lane, 3)
            # What a group measures, its last actions, and its size.
            own = [index for index, name in enumerate(names) if name.startswith(f"wtg{group}.")]
            assert split[lane].tolist() == [*seen[episode, own], 1.0]
            assert groups.observation_space.contains(split[lane])
        actions = rng.uniform(-1.0, 1.0, (6, 2)).astype(np.float32)
        seen, rewards, dones, infos = episodes.step(actions.reshape(2, 6))
        split, each, ended, own_infos = groups.step(actions)
        assert each.tolist() == np.repeat(rewards, 3).tolist() and ended.tolist() == np.repeat(dones, 3).tolist()
        for lane in np.flatnonzero(ended):
            episode, group = divmod(int(lane), 3)
            ends += 1
            last, own_last = infos[episode]["terminal_observation"], own_infos[lane]["terminal_observation"]
            assert own_last[:10].tolist() == last[10 * group : 10 * group + 10].tolist()
            assert own_infos[lane]["TimeLimit.truncated"] == infos[episode]["TimeLimit.truncated"]
    assert ends >= 6


class Agent(nn.Linear):
    """Answers as a learner's network does: a tuple that begins with the actions."""

    def forward(self, observation):
        return (super().forward(observation),)


@pytest.mark.parametrize("suite", ["standard", "standard-v1"])
def test_every_group_acts_by_what_it_sees_itself_its_size_among_it(suite):
    settings = EnvSettings(suite=suite)
    turbines = torch.tensor([float(group.n_turbines) for group in settings.resolved_plant.groups])
    n, width = len(turbines), 7
    agent = Agent(width + 1, 2)
    observations = torch.randn(3, n * width)
    found = SharedPolicy(agent, settings)(observations)
    for group in range(n):
        size = (turbines[group] / turbines.mean()).expand(3, 1)
        (expected,) = agent(torch.cat([observations[:, width * group : width * (group + 1)], size], dim=1))
        assert torch.allclose(found[:, 2 * group : 2 * group + 2], expected)
