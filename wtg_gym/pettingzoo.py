"""The environment for many agents, one per WTG group; needs the extra `marl`."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from wtg_gym.envs import GFMWTGEnv
from wtg_gym.envs.interface import Action, Observation, as_actions
from wtg_gym.envs.rendering import Frame
from wtg_gym.extras import install_advice
from wtg_gym.ranges import ByName, require_known
from wtg_gym.signals import undivided
from wtg_gym.tasks.episode import ACTION_MODES
from wtg_gym.tasks.observation import OBSERVATION_BOUND

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError(f"wtg_gym.pettingzoo needs PettingZoo; {install_advice('marl')}") from error

#: Observations, rewards, terminations, truncations and infos, by agent.
Step = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]


class GFMWTGParallelEnv(ParallelEnv[str, Observation, Action]):  # type: ignore[misc]
    """:class:`wtg_gym.envs.GFMWTGEnv` with one agent per WTG group, as an environment of PettingZoo.

    The agents are "wtg0", "wtg1", … in the order of the groups. Their joint run equals that of the single environment
    with the same seed and actions, bit for bit.

    - An agent observes what its own group measures, and its own last action: its part of the local observation.
      `observation_names` has the units. It gives its own group's part of the action.
    - :meth:`state` is the privileged observation of the whole grid, for a central critic.
    - Every agent earns the reward of the single environment.
    - An agent leaves, terminated, with the step in which its group is disconnected, by an event or, with
      `on_failure="trip"`, by its rotor's speed. The group's action is zero from then on. At the end of the episode all
      agents that are left are terminated or truncated.

    Every info is that of the single environment. A TypeError names an argument that is unknown, a ValueError one that
    is out of range.

    Args:
        render_mode: as for the single environment.
        arguments: as for :class:`wtg_gym.envs.GFMWTGEnv`, but `observation_mode`.
    """

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        if "observation_mode" in arguments:
            what = "agents see what their own groups measure, and state() is the privileged observation"
            raise TypeError(f"observation_mode cannot be chosen: {what}")
        #: The environment that the agents share.
        seen = {**arguments, "observation_mode": "privileged"}
        self.single_env = GFMWTGEnv(render_mode=render_mode, **seen)
        self.render_mode = render_mode
        batch, settings = self.single_env.batch, self.single_env.settings
        self.metadata = {**self.single_env.metadata, "name": settings.env_id, "is_parallelizable": True}
        self.possible_agents = [f"wtg{group}" for group in range(batch.n_wtg)]
        self.agents: list[str] = []
        n_modes = sum(ACTION_MODES[settings.action_mode])
        width = settings.task.n_local + n_modes
        # Each its own, so that each can be seeded by itself.
        self.observation_spaces, self.action_spaces = (
            ByName("agent", {name: gym.spaces.Box(-bound, bound, (n,)) for name in self.possible_agents})
            for n, bound in ((width, OBSERVATION_BOUND), (n_modes, 1.0))
        )
        self.state_space = self.single_env.observation_space
        self._action_shape = (n_modes,)
        self._seen = {agent: slice(j * width, (j + 1) * width) for j, agent in enumerate(self.possible_agents)}
        self._done_by = {agent: slice(j * n_modes, (j + 1) * n_modes) for j, agent in enumerate(self.possible_agents)}
        #: Names and units of each agent's observation.
        self.observation_names = {agent: batch.observation_names[entries] for agent, entries in self._seen.items()}

    def observation_space(self, agent: str) -> gym.spaces.Box:
        """Return what an agent observes: Box(-5, 5, (n,))."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gym.spaces.Box:
        """Return what an agent does: Box(-1, 1, (n_modes,))."""
        return self.action_spaces[agent]

    @undivided
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode.

        It returns observations and infos by agent. A ValueError refuses a scenario that does not fit, a
        gymnasium.error.Error a seed that is not a whole number of 0 or more; nothing has changed then.

        Args:
            seed: seeds the generator that scenarios are drawn with; None goes on with it.
            options: {"scenario": Scenario or its to_dict()} plays that scenario. Others are ignored with a warning, as
                PettingZoo's own tests want it.
        """
        if isinstance(options, Mapping):
            unknown = sorted(str(key) for key in options if key != "scenario")
            if unknown:
                gym.logger.warn(f"unknown reset options {unknown} are ignored; known options: scenario")
            options = {key: value for key, value in options.items() if key == "scenario"}
        observation, info = self.single_env.reset(seed=seed, options=options)
        self.agents = list(self.possible_agents)
        return self._parts(observation), {agent: dict(info) for agent in self.agents}

    def _parts(self, observation: Observation) -> dict[str, Observation]:
        return {agent: observation[self._seen[agent]].copy() for agent in self.agents}

    @undivided
    def step(self, actions: Mapping[str, Action]) -> Step:
        """Hold the actions (n_modes,) of every agent that is there, clipped to [-1, 1], for one control interval.

        Those of agents that have left are ignored. It returns observations, rewards, terminations, truncations and
        infos of the agents that acted. A ValueError says that an action is missing, has another shape or is not finite,
        and nothing has been stepped; a RuntimeError that no agent is there, so that reset() is needed.
        """
        if not self.agents:
            raise RuntimeError("the episode is over or was never started; call reset() before step()")
        joint = self._joint(actions)
        batch = self.single_env.batch
        observation, reward, terminated, truncated, info = self.single_env.step(joint)
        acted = self.agents
        observations, rewards = self._parts(observation), dict.fromkeys(acted, reward)
        connected = batch.simulator.wtg_values("connected")[0] > 0.5
        there = dict(zip(self.possible_agents, connected.tolist(), strict=True))
        terminations = {agent: terminated or not there[agent] for agent in acted}
        truncations = {agent: truncated and there[agent] for agent in acted}
        self.agents = [agent for agent in acted if not (terminations[agent] or truncations[agent])]
        return observations, rewards, terminations, truncations, {agent: dict(info) for agent in acted}

    def _joint(self, actions: Mapping[str, Action]) -> npt.NDArray[Any]:
        """Return the action of the single environment, zero for groups whose agents have left."""
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions must be a dictionary by agent, got {type(actions).__name__}")
        require_known("agents", actions, self.possible_agents)
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise ValueError(f"actions are missing of {', '.join(missing)}; needed: {', '.join(self.agents)}")
        joint = np.zeros(len(self._done_by) * self._action_shape[0])
        for agent in self.agents:
            try:
                action = as_actions(actions[agent], self._action_shape)
            except ValueError as error:
                raise ValueError(f"{agent}: {error}") from None
            if not np.isfinite(action).all():
                raise ValueError(f"{agent}: the action {action.tolist()} is not finite; allowed: -1 … 1")
            joint[self._done_by[agent]] = action
        return joint

    def state(self) -> Observation:
        """Return the privileged observation of the whole grid, `state_space`.

        A RuntimeError says that no episode was started.
        """
        if not self.single_env.batch.task_values("end_step")[0] > 0.0:
            raise RuntimeError("no episode was started; call reset() before state()")
        state: Observation = self.single_env.batch.observations[0].copy()
        return state

    def render(self) -> Frame | None:
        """Draw the episode up to now, as the single environment does."""
        return self.single_env.render()

    def close(self) -> None:
        """Release the worker threads, and close the window; the environment can still be used."""
        self.single_env.close()


#: The name under which PettingZoo's environments are made.
parallel_env = GFMWTGParallelEnv
