"""Many agents that learn one policy: every WTG group plays it by itself, from what it measures itself.

"ippo" is independent PPO with shared parameters (de Witt et al., "Is Independent Learning All You Need in the StarCraft
Multi-Agent Challenge?", 2020); "mappo" adds a value function that sees the whole grid (Yu et al., "The Surprising
Effectiveness of PPO in Cooperative Multi-Agent Games", 2022). A lane of the learner is one group of one episode.

Besides what it measures, a group sees its size: every group's duty counts alike in the cost, but a large one moves the
frequency by more, so that one policy for all must tell them apart.
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

#: The algorithms of many agents.
ALGORITHMS = ("ippo", "mappo")
#: What all of them learn with, as :data:`agents.hyperparameters.ALGORITHMS` names it.
LEARNER = "ppo"
#: Where the archive of the learner is in the folder of its best policy.
ARCHIVE_FOLDER = "learner"


def group_sizes(settings: EnvSettings) -> Array:
    """Return the number of turbines of each WTG group, as a multiple of their mean, (n_wtg,) float32."""
    turbines = np.array([group.n_turbines for group in settings.wtg_groups()])
    sizes: Array = (turbines / turbines.mean()).astype(np.float32)
    return sizes


def with_sizes(observations: Array, sizes: Array) -> Array:
    """Return what each group measures and its size, (n · n_wtg, n_own), of local observations (n, n_observation)."""
    measured = observations.reshape(len(observations), sizes.size, -1)
    column = np.broadcast_to(sizes[:, None], (*measured.shape[:2], 1))
    return np.concatenate([measured, column], axis=2).reshape(len(observations) * sizes.size, -1)


class GroupVecEnv(VecEnvWrapper):
    """A batch of episodes with a lane for every WTG group: lane i is group i % n_wtg of episode i // n_wtg.

    All groups of an episode earn its gain and end together.

    Args:
        venv: the episodes.
        sees_grid: whether the whole observation, which is then to be the privileged one, follows that of the group.
    """

    def __init__(self, venv: GainVecEnv, *, sees_grid: bool) -> None:
        lanes = venv.vector_env.lanes
        self.n_wtg = lanes.n_wtg
        self._sees_grid = sees_grid
        n_modes = lanes.n_action // self.n_wtg
        self._sizes = group_sizes(lanes.settings)
        #: Entries of the observation that are a group's own; they come first.
        self.n_own = lanes.n_local + n_modes + 1
        width = self.n_own + (lanes.n_observation if sees_grid else 0)
        bound = np.full(width, OBSERVATION_BOUND, dtype=np.float32)
        one = np.ones(n_modes, dtype=np.float32)
        super().__init__(venv, Box(-bound, bound), Box(-one, one))
        self.num_envs = venv.num_envs * self.n_wtg

    def _split(self, observations: Array) -> Array:
        """Return what each group sees, (n · n_wtg, width), of observations (n, n_observation)."""
        own = with_sizes(observations[:, : self.n_wtg * (self.n_own - 1)], self._sizes)
        if not self._sees_grid:
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
        of_groups = [info for each in infos for info in self._infos(each)]
        return self._split(observations), np.repeat(rewards, self.n_wtg), np.repeat(dones, self.n_wtg), of_groups

    def _infos(self, info: dict[str, Any]) -> Infos:
        if "terminal_observation" not in info:
            return [info] * self.n_wtg
        return [{**info, "terminal_observation": last} for last in self._split(info["terminal_observation"][None])]

    def __getstate__(self) -> dict[str, Any]:
        # It cannot be pickled; its class has it.
        return {key: value for key, value in self.__dict__.items() if key != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes={name: getattr(type(self), name) for name in dir(type(self))})


class _OwnActor(MlpExtractor):
    """Layers of a policy that sees the first entries of the observation, and of a value function that sees all."""

    def __init__(self, n_own: int, actor: MlpExtractor, critic: MlpExtractor) -> None:
        torch.nn.Module.__init__(self)
        self.n_own = n_own
        self.policy_net, self.latent_dim_pi = actor.policy_net, actor.latent_dim_pi
        self.value_net, self.latent_dim_vf = critic.value_net, critic.latent_dim_vf

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = self.policy_net(features[:, : self.n_own])
        return latent


class CentralCriticPolicy(ActorCriticPolicy):
    """A policy that sees what its group measures, and a value function that sees the grid too.

    Args:
        n_own: entries of the observation that the group measures; they come first.
        arguments: as for Stable-Baselines3's "MlpPolicy".
    """

    def __init__(self, *arguments: Any, n_own: int, **keywords: Any) -> None:
        self.n_own = n_own
        super().__init__(*arguments, **keywords)

    def _build_mlp_extractor(self) -> None:
        actor, critic = (
            MlpExtractor(width, net_arch=self.net_arch, activation_fn=self.activation_fn, device=self.device)
            for width in (self.n_own, self.features_dim)
        )
        self.mlp_extractor = _OwnActor(self.n_own, actor, critic)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "n_own": self.n_own}


@dataclasses.dataclass(frozen=True)
class SharedPolicy:
    """A policy that every WTG group plays by itself, for any number of groups.

    Args:
        policy: takes what one group sees.
        sizes: of the groups, :func:`group_sizes`.
    """

    policy: NormalizedPolicy
    sizes: Array

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), state) for raw local observations (n_lanes, n_observation)."""
        n_own, width = _widths(self.policy.policy)
        own = with_sizes(np.asarray(observation), self.sizes)
        # Of the grid the actor sees nothing.
        unseen = np.zeros((own.shape[0], width - n_own), dtype=own.dtype)
        actions, _ = self.policy.predict(np.concatenate([own, unseen], axis=1), None, None, deterministic)
        return actions.reshape(len(observation), -1), state


def _widths(policy: BasePolicy) -> tuple[int, int]:
    """Return how many entries of the observation the actor sees, and how many there are."""
    shape = policy.observation_space.shape
    assert shape is not None
    return policy.n_own if isinstance(policy, CentralCriticPolicy) else shape[0], shape[0]


# --- for single agents too, whose policy sees all and does all -------------------------------------------------------


def learner_of(algo: str) -> str:
    """Return what an algorithm learns with, as :data:`agents.hyperparameters.ALGORITHMS` names it."""
    return LEARNER if algo in ALGORITHMS else algo


def training_env(settings: RunSettings) -> VecEnv:
    """Return the lanes that a run learns in.

    Raises:
        ValueError: lanes are groups, and their number is no multiple of that of the groups, or the observations are
            not local.
    """
    if settings.algo not in ALGORITHMS:
        return GainVecEnv(settings.n_envs, **settings.env_arguments)
    if settings.observation_mode != "local":
        raise ValueError(f"agents of {settings.algo} see what their own groups measure: leave out the observation mode")
    n_wtg = sizes_of(settings).size
    if settings.n_envs % n_wtg:
        raise ValueError(f"n_envs must be a whole multiple of the {n_wtg} WTG groups, got {settings.n_envs}")
    arguments, sees_grid = settings.env_arguments, settings.algo == "mappo"
    if sees_grid:
        arguments["observation_mode"] = "privileged"
    return GroupVecEnv(GainVecEnv(settings.n_envs // n_wtg, **arguments), sees_grid=sees_grid)


def as_played(settings: RunSettings) -> RunSettings:
    """Return a run's settings with the groups of its suite, with which its policy is an entry.

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


def with_policy(settings: RunSettings, hyperparameters: Hyperparameters, env: VecEnv) -> Hyperparameters:
    """Return a run's hyperparameters with the policy that its algorithm learns in its lanes."""
    if settings.algo != "mappo":
        return hyperparameters
    of_groups = unwrap_vec_wrapper(env, GroupVecEnv)
    assert isinstance(of_groups, GroupVecEnv)
    policy_kwargs = {**(hyperparameters.arguments.get("policy_kwargs") or {}), "n_own": of_groups.n_own}
    arguments = {**hyperparameters.arguments, "policy": CentralCriticPolicy, "policy_kwargs": policy_kwargs}
    return dataclasses.replace(hyperparameters, arguments=arguments)


def played(settings: RunSettings, policy: NormalizedPolicy) -> Policy:
    """Return a run's policy as one that acts for all groups."""
    return SharedPolicy(policy, sizes_of(settings)) if settings.algo in ALGORITHMS else policy


def network_played(settings: RunSettings, policy: NormalizedPolicy) -> PolicyNetwork:
    """Return the network that :func:`played` evaluates.

    Raises:
        ValueError: it has a layer that the export cannot write.
    """
    network = network_of(policy.policy, policy.vec_normalize)
    if settings.algo not in ALGORITHMS:
        return network
    seen, (n_own, _) = network.normalization, _widths(policy.policy)
    if seen is not None:
        seen = dataclasses.replace(seen, mean=seen.mean[:n_own], std=seen.std[:n_own])
    return dataclasses.replace(network, n_observation=n_own, normalization=seen, sizes=sizes_of(settings))
