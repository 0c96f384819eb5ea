"""What the single and the vector environment share: spaces, spec, settings, and checks of what they are given."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.observation import OBSERVATION_BOUND
from wtg_gym.envs.settings import EnvArguments, EnvSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios.benchmark import BENCHMARKS

Observation = npt.NDArray[np.float32]
Action = npt.NDArray[np.float32]


class OverLanes:
    """An environment that plays its episodes in lanes."""

    _lanes: TaskLanes
    _step_limit: int | None = None
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's description of this environment; its `max_episode_steps` follows `duration_s`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = _with_episode_steps(spec, self._lanes, self._step_limit)

    @property
    def lanes(self) -> TaskLanes:
        """The simulator, observations and costs of every episode."""
        return self._lanes

    @property
    def observation_names(self) -> list[str]:
        """Names and units of the entries of one episode's observation."""
        return self._lanes.observation_names


def spaces(lanes: TaskLanes) -> tuple[gym.spaces.Box[np.float32], gym.spaces.Box[np.float32]]:
    """Return the observation space and the action space of one episode."""
    bound = np.full(lanes.n_observation, OBSERVATION_BOUND, dtype=np.float32)
    one = np.ones(lanes.n_action, dtype=np.float32)
    return gym.spaces.Box(-bound, bound, dtype=np.float32), gym.spaces.Box(-one, one, dtype=np.float32)


def settings_of(owner: str, arguments: EnvArguments) -> EnvSettings:
    """Return the settings that keyword arguments make; an unknown one raises a TypeError."""
    known = [field.name for field in dataclasses.fields(EnvSettings)]
    unknown = [name for name in arguments if name not in known]
    if unknown:
        # Python's own words come first: TorchRL looks for them to find out which arguments an environment takes.
        raise TypeError(
            f"{owner}.__init__() got an unexpected keyword argument {unknown[0]!r}; "
            f"known settings: {', '.join(known)}, render_mode"
        )
    return EnvSettings(**arguments)


def _with_episode_steps(spec: EnvSpec | None, lanes: TaskLanes, limit: int | None) -> EnvSpec | None:
    """Return a spec that says how many steps an episode has at most.

    Gymnasium leaves this empty because the environment is registered without a time limit: it ends episodes itself.

    Raises:
        ValueError: the spec's id is that of another version.
    """
    version = lanes.settings.version
    if spec is not None and spec.id in BENCHMARKS and BENCHMARKS[spec.id].version != version:
        raise ValueError(f"{spec.id} cannot be made with version = {version!r}: its id is its version; leave it out")
    if spec is None or spec.max_episode_steps is not None:
        return spec
    n_steps = round(lanes.duration_s / lanes.settings.control_dt)
    return dataclasses.replace(spec, max_episode_steps=n_steps if limit is None else min(limit, n_steps))


def check_render_mode(render_mode: Any, metadata: Mapping[str, Any]) -> None:
    """Refuse an unknown render mode."""
    if render_mode is not None and render_mode not in metadata["render_modes"]:
        modes = ", ".join(repr(mode) for mode in metadata["render_modes"])
        raise ValueError(f"unknown render_mode {render_mode!r}; choose None or one of {modes}")


def in_real_time(metadata: Mapping[str, Any], settings: EnvSettings) -> dict[str, Any]:
    """Return metadata with as many frames per second as there are control intervals."""
    return {**metadata, "render_fps": max(1, round(1.0 / settings.control_dt))}


def warn_of_no_render_mode() -> None:
    """Warn that there is nothing to render with."""
    gym.logger.warn(
        'render() draws nothing, since the environment was made without a render_mode; give one, such as "rgb_array"'
    )


def as_scenario(value: Any) -> Scenario:
    """Return a scenario that `reset` was given, as such or as a dictionary; anything else raises a ValueError."""
    if isinstance(value, Scenario):
        return value
    if isinstance(value, dict):
        return Scenario.from_dict(value)
    raise ValueError(f'options["scenario"] must be a Scenario or its to_dict() form, got {type(value).__name__}')


def check_options(options: dict[str, Any] | None, allowed: Sequence[str]) -> dict[str, Any]:
    """Return the options of `reset`; unknown ones raise a ValueError."""
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"reset options must be a dictionary with keys out of {', '.join(allowed)}, got {options!r}")
    unknown = sorted(map(str, set(options or {}) - set(allowed)))
    if unknown:
        raise ValueError(f"unknown reset options {unknown}; known options: {', '.join(allowed)}")
    return options or {}


def check_snapshot(snapshot: Any, kind: type, owner: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]) -> None:
    """Refuse what is not a snapshot of this kind of environment."""
    if not isinstance(snapshot, kind):
        name = type(owner).__name__
        raise ValueError(f"restore() takes what snapshot() of a {name} returned, got {type(snapshot).__name__}")
