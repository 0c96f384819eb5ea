"""Multi-agent PPO with shared parameters, for `agents.train`: an agent per WTG group, one policy for all of them.

"ippo" is independent PPO (de Witt et al., "Is Independent Learning All You Need in the StarCraft Multi-Agent
Challenge?", 2020): actor and critic see an agent's local observation. "mappo" has a central critic, which sees the
whole grid too (Yu et al., "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games", 2022).
Stable-Baselines3 knows single agents alone: here every agent is a lane of its own.

A local observation is what a group measures, its last action, and its size: every group's duty counts alike in the
cost, but a large one moves the frequency by more, so that one policy for all must tell them apart.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, unwrap_vec_wrapper

from agents.hyperparameters import Hyperparameters
from agents.learners import network_of
from agents.onnx_graph import PolicyNetwork
from agents.runs import RunSettings
from agents.vec_env import GainVecEnv
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.observation import OBSERVATION_BOUND
from wtg_gym.evaluation import Policy
from wtg_gym.policies.sb3_archive import NormalizedPolicy
from wtg_gym.scenarios import get_suite

Array = npt.NDArray[Any]
Infos = list[dict[str, Any]]

#: The multi-agent algorithms.
ALGORITHMS = ("ippo", "mappo")
#: Where the archive of the learner is in the folder of its best policy.
ARCHIVE_FOLDER = "learner"


def group_sizes(settings: EnvSettings) -> Array:
    """Return the number of turbines of each WTG group, as a multiple of their mean, (n_wtg,) float32."""
    turbines = np.array([group.n_turbines for group in settings.wtg_groups()])
    sizes: Array = (turbines / turbines.mean()).astype(np.float32)
    return sizes


def agent_observations(observations: Array, sizes: Array) -> Array:
    """Return the local observation of each agent, (n · n_wtg, n_actor), from those of episodes (n, n_observation)."""
    measured = observations.reshape(len(observations), sizes.size, -1)
    column = np.broadcast_to(sizes[:, None], (*measured.shape[:2], 1))
    return np.concatenate([measured, column], axis=2).reshape(len(observations) * sizes.size, -1)


class AgentVecEnv(VecEnvWrapper):
    """A batch of episodes with a lane for every agent: lane i is WTG group i % n_wtg of episode i // n_wtg.

    All agents of an episode earn its gain and end together.

    Args:
        venv: the episodes.
        central_critic: whether the privileged observation, which the episodes then must have, follows the local one.
    """

    def __init__(self, venv: GainVecEnv, *, central_critic: bool) -> None:
        lanes = venv.vector_env.lanes
        self.n_wtg = lanes.n_wtg
        self._central_critic = central_critic
        n_modes = lanes.n_action // self.n_wtg
        self._sizes = group_sizes(lanes.settings)
        #: Entries of the local observation; they come first.
        self.n_actor = lanes.n_local + n_modes + 1
        width = self.n_actor + (lanes.n_observation if central_critic else 0)
        bound = np.full(width, OBSERVATION_BOUND, dtype=np.float32)
        one = np.ones(n_modes, dtype=np.float32)
        super().__init__(venv, Box(-bound, bound), Box(-one, one))
        self.num_envs = venv.num_envs * self.n_wtg

    def _split(self, observations: Array) -> Array:
        """Return the observation of each agent, (n · n_wtg, width), from those of episodes (n, n_observation)."""
        own = agent_observations(observations[:, : self.n_wtg * (self.n_actor - 1)], self._sizes)
        if not self._central_critic:
            return own
        return np.concatenate([own, np.repeat(observations, self.n_wtg, axis=0)], axis=1)

    def reset(self) -> Array:
        """Start all episodes; returns the observations (num_envs, width)."""
        observations = self.venv.reset()
        assert isinstance(observations, np.ndarray)
        return self._split(observations)

    def step_async(self, actions: Array) -> None:
        """Take the actions (num_envs, n_modes)."""
        self.venv.step_async(np.asarray(actions).reshape(self.venv.num_envs, -1))

    def step_wait(self) -> tuple[Array, Array, Array, Infos]:
        """Hold the actions for one control interval; returns observations, rewards, dones and infos of the lanes."""
        observations, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observations, np.ndarray)
        of_agents = [info for each in infos for info in self._infos(each)]
        return self._split(observations), np.repeat(rewards, self.n_wtg), np.repeat(dones, self.n_wtg), of_agents

    def _infos(self, info: dict[str, Any]) -> Infos:
        if "terminal_observation" not in info:
            return [info] * self.n_wtg
        return [{**info, "terminal_observation": last} for last in self._split(info["terminal_observation"][None])]

    def __getstate__(self) -> dict[str, Any]:
        # It cannot be pickled; its class has it.
        return {key: value for key, value in self.__dict__.items() if key != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes={name: getattr(type(self), name) for name in dir(type(self))})


class _LocalActor(MlpExtractor):
    """Layers of an actor that sees the first `n_actor` entries of the observation, and of a critic that sees all."""

    def __init__(self, n_actor: int, n_all: int, **layers: Any) -> None:
        actor = MlpExtractor(n_actor, **layers)
        super().__init__(n_all, **layers)
        self.n_actor = n_actor
        self.policy_net, self.latent_dim_pi = actor.policy_net, actor.latent_dim_pi

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = self.policy_net(features[:, : self.n_actor])
        return latent


class CentralCriticPolicy(ActorCriticPolicy):
    """An actor that sees its agent's local observation, and a critic that sees the whole grid too.

    Args:
        n_actor: entries of the local observation; they come first.
        arguments: as for Stable-Baselines3's "MlpPolicy".
    """

    def __init__(self, *arguments: Any, n_actor: int, **keywords: Any) -> None:
        self.n_actor = n_actor
        super().__init__(*arguments, **keywords)

    def _build_mlp_extractor(self) -> None:
        layers = {"net_arch": self.net_arch, "activation_fn": self.activation_fn, "device": self.device}
        self.mlp_extractor = _LocalActor(self.n_actor, self.features_dim, **layers)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "n_actor": self.n_actor}


@dataclasses.dataclass(frozen=True)
class SharedPolicy:
    """The joint policy of agents with shared parameters, for any number of them.

    Args:
        policy: takes the observation of one agent.
        sizes: of the groups, :func:`group_sizes`.
    """

    policy: NormalizedPolicy
    sizes: Array

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), state) for raw local observations (n_lanes, n_observation)."""
        n_actor, width = _widths(self.policy.policy)
        own = agent_observations(np.asarray(observation), self.sizes)
        # What the central critic alone sees.
        unseen = np.zeros((own.shape[0], width - n_actor), dtype=own.dtype)
        actions, _ = self.policy.predict(np.concatenate([own, unseen], axis=1), None, None, deterministic)
        return actions.reshape(len(observation), -1), state


def _widths(policy: BasePolicy) -> tuple[int, int]:
    """Return how many entries of the observation the actor sees, and how many there are."""
    shape = policy.observation_space.shape
    assert shape is not None
    return policy.n_actor if isinstance(policy, CentralCriticPolicy) else shape[0], shape[0]


# --- for any algorithm: a single agent's is left as it is -------------------------------------------------------------


def base_algorithm(algo: str) -> str:
    """Return the algorithm of :data:`agents.hyperparameters.ALGORITHMS` that an algorithm is made of."""
    return "ppo" if algo in ALGORITHMS else algo


def training_env(settings: RunSettings) -> VecEnv:
    """Return the lanes that a run learns in.

    Raises:
        ValueError: lanes are agents, and their number is no multiple of the episodes' agents, or the observations are
            not local.
    """
    if settings.algo not in ALGORITHMS:
        return GainVecEnv(settings.n_envs, **settings.env_arguments)
    if settings.observation_mode != "local":
        raise ValueError(f"agents of {settings.algo} see what their own groups measure: leave out --observation-mode")
    n_wtg = sizes_of(settings).size
    if settings.n_envs % n_wtg:
        raise ValueError(f"n_envs must be a whole multiple of the {n_wtg} WTG groups, got {settings.n_envs}")
    arguments, central_critic = settings.env_arguments, settings.algo == "mappo"
    if central_critic:
        arguments["observation_mode"] = "privileged"
    return AgentVecEnv(GainVecEnv(settings.n_envs // n_wtg, **arguments), central_critic=central_critic)


def entry_settings(settings: RunSettings) -> RunSettings:
    """Return a run's settings with the groups of its suite, for its policy as an entry.

    Raises:
        ValueError: a single agent's policy takes the observations of other groups.
    """
    own = len(get_suite(settings.suite).plant.groups)
    if settings.algo not in ALGORITHMS and settings.groups not in (None, own):
        raise ValueError(f"the policy acts for {settings.groups} WTG groups, suite {settings.suite!r} has {own}")
    return dataclasses.replace(settings, groups=None)


def sizes_of(settings: RunSettings) -> Array:
    """Return the sizes of the WTG groups of a run's episodes, see :func:`group_sizes`."""
    return group_sizes(EnvSettings(**settings.env_arguments))


def with_central_critic(settings: RunSettings, hyperparameters: Hyperparameters, env: VecEnv) -> Hyperparameters:
    """Return a run's hyperparameters, those of "mappo" with its policy for these lanes."""
    if settings.algo != "mappo":
        return hyperparameters
    lanes = unwrap_vec_wrapper(env, AgentVecEnv)
    assert isinstance(lanes, AgentVecEnv)
    policy_kwargs = {**(hyperparameters.arguments.get("policy_kwargs") or {}), "n_actor": lanes.n_actor}
    arguments = {**hyperparameters.arguments, "policy": CentralCriticPolicy, "policy_kwargs": policy_kwargs}
    return dataclasses.replace(hyperparameters, arguments=arguments)


def joint_policy(settings: RunSettings, policy: NormalizedPolicy) -> Policy:
    """Return a run's policy as one that acts for all agents."""
    return SharedPolicy(policy, sizes_of(settings)) if settings.algo in ALGORITHMS else policy


def joint_network(settings: RunSettings, policy: NormalizedPolicy) -> PolicyNetwork:
    """Return the network that :func:`joint_policy` evaluates.

    Raises:
        ValueError: it has a layer that the export cannot write.
    """
    network = network_of(policy.policy, policy.vec_normalize)
    if settings.algo not in ALGORITHMS:
        return network
    seen, (n_actor, _) = network.normalization, _widths(policy.policy)
    if seen is not None:
        seen = dataclasses.replace(seen, mean=seen.mean[:n_actor], std=seen.std[:n_actor])
    return dataclasses.replace(network, n_observation=n_actor, normalization=seen, sizes=sizes_of(settings))
