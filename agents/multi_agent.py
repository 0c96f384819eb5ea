"""Independent PPO with shared parameters, "ippo" of `agents.train`: an agent per WTG group, one policy for all of them.

De Witt et al., "Is Independent Learning All You Need in the StarCraft Multi-Agent Challenge?", 2020. Every agent is an
environment of its own for Stable-Baselines3, which knows single agents alone. It sees what its group measures, its last
action, and its size: every group's duty counts alike in the cost, but a large one moves the frequency by more.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnvWrapper
from torch import Tensor, nn

from agents.run import RunSettings
from wtg_gym.envs import EnvSettings
from wtg_gym.sb3 import SB3VecEnv
from wtg_gym.tasks.episode import ACTION_MODES
from wtg_gym.tasks.observation import OBSERVATION_BOUND

Array = npt.NDArray[Any]
Infos = list[dict[str, Any]]


def group_sizes(settings: EnvSettings) -> Array:
    """Return the number of turbines of each WTG group, as a multiple of their mean, (n_wtg,) float32."""
    turbines = np.array([group.n_turbines for group in settings.resolved_plant.groups])
    sizes: Array = (turbines / turbines.mean()).astype(np.float32)
    return sizes


def agent_env(settings: RunSettings) -> "AgentVecEnv":
    """Return the environments that a run learns in; a ValueError if they are no multiple of the groups or not local."""
    if settings.observation_mode != "local":
        raise ValueError(f"agents of {settings.algo} see what their own groups measure: leave out --observation-mode")
    n_wtg = group_sizes(EnvSettings(**settings.env_arguments)).size
    if settings.n_envs % n_wtg:
        raise ValueError(f"n_envs must be a whole multiple of the {n_wtg} WTG groups, got {settings.n_envs}")
    return AgentVecEnv(SB3VecEnv(settings.n_envs // n_wtg, reward="score", **settings.env_arguments))


class AgentVecEnv(VecEnvWrapper):
    """A batch with an environment for every agent: environment i is WTG group i % n_wtg of episode i // n_wtg.

    All agents of an episode earn its reward and end together.
    """

    def __init__(self, venv: SB3VecEnv) -> None:
        batch = venv.batch
        self.n_wtg = batch.n_wtg
        self._sizes = group_sizes(batch.settings)
        n_modes = batch.n_action // self.n_wtg
        bound = np.full(batch.n_local + n_modes + 1, OBSERVATION_BOUND, dtype=np.float32)
        high = np.ones(n_modes, dtype=np.float32)
        super().__init__(venv, Box(-bound, bound), Box(-high, high))
        self.num_envs = venv.num_envs * self.n_wtg

    def _split(self, observations: Any) -> Array:
        """Return the observation of each agent, (n · n_wtg, width), from those of episodes (n, n_observation)."""
        measured = observations.reshape(len(observations), self.n_wtg, -1)
        column = np.broadcast_to(self._sizes[:, None], (*measured.shape[:2], 1))
        return np.concatenate([measured, column], axis=2).reshape(len(observations) * self.n_wtg, -1)

    def reset(self) -> Array:
        """Start all episodes; returns the observations (num_envs, width)."""
        return self._split(self.venv.reset())

    def step_async(self, actions: Array) -> None:
        """Take the actions (num_envs, n_modes)."""
        self.venv.step_async(np.asarray(actions).reshape(self.venv.num_envs, -1))

    def step_wait(self) -> tuple[Array, Array, Array, Infos]:
        """Hold the actions for one control interval; returns observations, rewards, dones and infos."""
        observations, rewards, dones, infos = self.venv.step_wait()
        of_agents = [info for step_infos in infos for info in self._infos(step_infos)]
        return self._split(observations), np.repeat(rewards, self.n_wtg), np.repeat(dones, self.n_wtg), of_agents

    def _infos(self, info: dict[str, Any]) -> Infos:
        if "terminal_observation" not in info:
            return [info] * self.n_wtg
        return [{**info, "terminal_observation": last} for last in self._split(info["terminal_observation"][None])]


class SharedPolicy(nn.Module):
    """The joint policy of agents with shared parameters, for any number of them, in an environment with `settings`.

    `agent` takes observations of agents (n, width) and returns a tuple that begins with their actions.
    """

    def __init__(self, agent: nn.Module, settings: EnvSettings) -> None:
        super().__init__()
        self._agent = agent
        self.register_buffer("_sizes", torch.as_tensor(group_sizes(settings))[:, None])
        # A plain number, so that the width of the file's action does not depend on the batch.
        self._n_action = sum(ACTION_MODES[settings.action_mode]) * len(settings.resolved_plant.groups)

    def forward(self, observation: Tensor) -> Tensor:
        """Return the joint actions (batch, n_action) for the joint local observations (batch, n_observation)."""
        sizes: Any = self._sizes
        measured = observation.reshape(observation.shape[0], sizes.shape[0], -1)
        of_agents = torch.cat([measured, sizes.expand(observation.shape[0], -1, -1)], dim=2)
        actions: Tensor = self._agent(of_agents.flatten(0, 1))[0]
        return actions.reshape(-1, self._n_action)
