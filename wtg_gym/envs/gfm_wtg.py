"""The environments: one episode at a time, and many at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Unpack

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from wtg_gym.envs.lanes import LanesSnapshot, NextEpisodes, TaskLanes, as_actions
from wtg_gym.envs.observation import OBSERVATION_BOUND
from wtg_gym.envs.one_thread import Use, in_use, one_thread
from wtg_gym.envs.rendering import Frame, LaneFrames
from wtg_gym.envs.settings import EnvArguments, EnvSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios.benchmark import BENCHMARKS

Observation = npt.NDArray[np.float32]
Action = npt.NDArray[np.float32]

_MOST_ENVS = 1_000_000


def _spaces(lanes: TaskLanes) -> tuple[gym.spaces.Box[np.float32], gym.spaces.Box[np.float32]]:
    bound = np.full(lanes.n_observation, OBSERVATION_BOUND, dtype=np.float32)
    one = np.ones(lanes.n_action, dtype=np.float32)
    return gym.spaces.Box(-bound, bound, dtype=np.float32), gym.spaces.Box(-one, one, dtype=np.float32)


def _settings(owner: str, arguments: EnvArguments) -> EnvSettings:
    known = [field.name for field in dataclasses.fields(EnvSettings)]
    unknown = [name for name in arguments if name not in known]
    if unknown:
        # Python's own words come first: TorchRL looks for them to find out which arguments an environment takes.
        raise TypeError(
            f"{owner}.__init__() got an unexpected keyword argument {unknown[0]!r}; "
            f"known settings: {', '.join(known)}, render_mode"
        )
    return EnvSettings(**arguments)


def _with_episode_steps(spec: EnvSpec | None, lanes: TaskLanes, limit: int | None = None) -> EnvSpec | None:
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


def _check_render_mode(render_mode: Any, metadata: Mapping[str, Any]) -> None:
    if render_mode is not None and render_mode not in metadata["render_modes"]:
        modes = ", ".join(repr(mode) for mode in metadata["render_modes"])
        raise ValueError(f"unknown render_mode {render_mode!r}; choose None or one of {modes}")


def _in_real_time(metadata: Mapping[str, Any], settings: EnvSettings) -> dict[str, Any]:
    """Return metadata with as many frames per second as there are control intervals."""
    return {**metadata, "render_fps": max(1, round(1.0 / settings.control_dt))}


def _warn_of_no_render_mode() -> None:
    gym.logger.warn(
        'render() draws nothing, since the environment was made without a render_mode; give one, such as "rgb_array"'
    )


def _as_scenario(value: Any) -> Scenario:
    if isinstance(value, Scenario):
        return value
    if isinstance(value, dict):
        return Scenario.from_dict(value)
    raise ValueError(f'options["scenario"] must be a Scenario or its to_dict() form, got {type(value).__name__}')


def _check_options(options: dict[str, Any] | None, allowed: Sequence[str]) -> dict[str, Any]:
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"reset options must be a dictionary with keys out of {', '.join(allowed)}, got {options!r}")
    unknown = sorted(map(str, set(options or {}) - set(allowed)))
    if unknown:
        raise ValueError(f"unknown reset options {unknown}; known options: {', '.join(allowed)}")
    return options or {}


def _is_whole(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _lane_seed(given: Any) -> int | None:
    if given is None:
        return None
    if not _is_whole(given) or given < 0:
        raise ValueError(f"a seed must be a whole number of 0 or more, got {given!r}")
    return int(given)


class Snapshot(NamedTuple):
    """Complete state of the episode of a :class:`GFMWTGEnv`."""

    lanes: LanesSnapshot
    running: bool
    frames: Any


class VectorSnapshot(NamedTuple):
    """Complete state of the episodes of a :class:`GFMWTGVectorEnv`."""

    lanes: LanesSnapshot
    needs_reset: npt.NDArray[np.bool_]
    n_steps: npt.NDArray[np.int64]
    frames: Any


def _check_snapshot(snapshot: Any, kind: type, owner: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]) -> None:
    if not isinstance(snapshot, kind):
        name = type(owner).__name__
        raise ValueError(f"restore() takes what snapshot() of a {name} returned, got {type(snapshot).__name__}")


class GFMWTGEnv(gym.Env[Observation, Action]):
    """Grid-forming wind turbine generators hold up the frequency of the modified IEEE 14-bus system.

    ## Description
    Groups of grid-forming wind turbines feed a transmission grid with one synchronous generator and three condensers.
    Loads switch on and off, lines trip, the wind blows as it likes. Each group runs the power-tracking-coefficient
    droop of Chen et al. (2026): P_st = k ω_m³ + D_p x with k = g(ω) and transient damping τ. The agent modulates k, τ
    or both on top of it, so that the frequency is held and no rotor is slowed down to a stall.

    ## Action Space
    `Box(-1, 1, (n_wtg · n_modes,), float32)`, per group: the offset on k (full action: half the regulation range
    K_opt - K_pr, in v1 all of it, beyond K_opt too), then the scale of τ (full action: four times, or a quarter). Zero
    action leaves the law `strategy` as it is, to the last bit; by default that is the reference controller. Actions
    outside -1 … 1 are clipped; an action that is not finite raises a ValueError.

    ## Observation Space
    `Box(-5, 5, (n,), float32)`, per group what its own controller measures: frequency deviation and its rate of change
    (RoCoF), tip-speed ratio between λ_opt and λ_pr, rotor speed, power, rotor-effective wind, k, filter state, last
    action. With `observation_mode="privileged"` the grid follows: speed, power and voltage of each synchronous machine,
    then frequency deviation, RoCoF and the machines' torque. `observation_names` lists every entry with its unit.

    In v1 a group sees what its sensors say: frequency deviation, RoCoF, tip-speed ratio, rotor speed, power, wind, with
    noise and bias, 0.1 … 0.3 s late, and its last action. The privileged part begins with the exact values.

    ## Rewards
    Minus the cost of the step: frequency deviation, RoCoF, regulation duty, rotor range, converter overload, actuator
    effort, and failure, which costs more than going on ever does; :class:`CostWeights` gives each weight's reason.
    The terms are `info["cost_…"]`, whose sum is minus the reward. `info["cost"]` is not that sum, but 1 in a
    step that violates a constraint and else 0, for safe learning.

    ## Starting State
    The exact equilibrium of the drawn scenario's wind, load and grid at nominal frequency.

    ## Episode End
    Terminated (`info["termination_reason"]`) at a "stall", "over-speed" or, in extended physics, "under-speed" of a
    rotor, at a "frequency limit" (outside 47.5 … 51.5 Hz, in v1 48.5 … 51.5 Hz), a "loss of synchronism" (two units
    more than 180° apart), a "voltage collapse" (a unit's terminal below 0.85 p.u. for more than 3 s), or a "numerical
    failure". Protections look every 0.1 s, and at the end of shorter control intervals. Truncated when the time is
    over.

    ## Arguments
    `help(wtg_gym.envs.EnvSettings)` lists them; `render_mode` is one more. An unknown one raises a TypeError, a value
    that is not allowed a ValueError. `reset(options={"scenario": …})` plays a scenario of your own.

    ## Rendering
    `render_mode="rgb_array"` gives frames of 960 × 540 pixels: the grid with the events so far, and what frequency and
    turbines have done. `render_mode="human"` shows them in a window, in real time. Both need the `render` extra.
    Nothing of the simulation depends on it.

    ## Vectorized environment
    `gym.make_vec("GFMWTG-14bus-v0", num_envs=…)` gives :class:`GFMWTGVectorEnv`; its lane i seeded with s equals this
    environment seeded with s + i, bit for bit.

    ## Version History
    * v1: a grid that needs the wind, extended physics, sensors, outages, a score that pays for the frequency first.
    * v0: first version, the paper's system.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium sets it so)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
    }
    _spec: EnvSpec | None = None

    def __init__(self, *, render_mode: str | None = None, **arguments: Unpack[EnvArguments]) -> None:
        _check_render_mode(render_mode, self.metadata)
        self.render_mode = render_mode
        self.settings = _settings(type(self).__name__, arguments)
        self._lanes = TaskLanes(self.settings, 1)
        self._use = Use()
        self.metadata = _in_real_time(self.metadata, self.settings)
        self._frames: LaneFrames | None = None
        if render_mode is not None:
            window = render_mode == "human"
            self._frames = LaneFrames(self._lanes, opens_window=window, fps=self.metadata["render_fps"])
        self.observation_space, self.action_space = _spaces(self._lanes)
        self._action_shape = (self._lanes.n_action,)
        self._running = False

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's description of this environment; its `max_episode_steps` follows `duration_s`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = _with_episode_steps(spec, self._lanes)

    @property
    def lanes(self) -> TaskLanes:
        """The episode's simulator, observations and costs."""
        return self._lanes

    @property
    def observation_names(self) -> list[str]:
        """Names and units of the observation's entries."""
        return self._lanes.observation_names

    @one_thread
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seeds the generator that scenarios are drawn with; None goes on with it.
            options: {"scenario": Scenario or its to_dict()} plays that scenario.

        Raises:
            ValueError: unknown options, or a scenario that does not fit; nothing has changed then.
            gymnasium.error.Error: the seed is no whole number of 0 or more.
        """
        given = _check_options(options, ("scenario",))
        # A given scenario that cannot start is refused before the first change, of the generator too.
        prepared = self._lanes.prepare_given([_as_scenario(given["scenario"])]) if "scenario" in given else None
        super().reset(seed=seed)
        if prepared is None:
            prepared = self._lanes.prepare(self._lanes.draw([self.np_random]))
        self._lanes.commit([0], [prepared])
        self._running = True
        if self._frames is not None:
            self._frames.sample()
            self._frames.show()
        return self._lanes.observations[0].copy(), self._lanes.info()

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold the action for one control interval.

        Args:
            action: (n_action,), clipped to [-1, 1].

        Raises:
            ValueError: wrong shape, or a value that is not finite.
            RuntimeError: the episode is over, call reset(); or another thread is in this environment.
        """
        if not self._running:
            raise RuntimeError("the episode is over or was never started; call reset() before step()")
        # As one_thread does; a decorator would add a fiftieth to the shortest step.
        use = self._use
        if not use.take(False):
            raise in_use(self, "step")
        try:
            lanes = self._lanes
            lanes.step(as_actions(action, self._action_shape)[None, :])
            outputs = lanes.outputs
            terminated, truncated = bool(outputs.terminated[0]), bool(outputs.truncated[0])
            self._running = not (terminated or truncated)
            if self._frames is not None:
                self._frames.sample()
                self._frames.show()
            return outputs.observations[0].copy(), float(outputs.rewards[0]), terminated, truncated, lanes.info()
        finally:
            use.give_back()

    def render(self) -> Frame | None:
        """Draw the episode up to now.

        Returns:
            With "rgb_array" the frame (540, 960, 3) uint8; with "human", where :meth:`reset` and :meth:`step` draw by
            themselves, None; without a render mode None and a warning.

        Raises:
            RuntimeError: no episode was started; or with "human" there is no display.
        """
        if self._frames is None:
            _warn_of_no_render_mode()
            return None
        if self.render_mode == "human":
            self._frames.show()
            return None
        return self._frames.paint()[0]

    @one_thread
    def snapshot(self) -> Any:
        """Return a copy of the episode's complete state, for :meth:`restore`; the generator is not part of it.

        An environment that renders adds what it has drawn so far.
        """
        frames = None if self._frames is None else self._frames.snapshot()
        return Snapshot(self._lanes.snapshot(), self._running, frames)

    @one_thread
    def restore(self, snapshot: Any) -> None:
        """Go back to a :meth:`snapshot`: what follows is then the same, bit for bit.

        Raises:
            ValueError: it is no snapshot, or of an environment with other settings than suite, split and scenario;
                nothing has changed then.
        """
        _check_snapshot(snapshot, Snapshot, self)
        lanes, running, frames = snapshot
        self._lanes.restore(lanes)
        self._running = running
        if self._frames is not None:
            self._frames.restore(frames)

    def close(self) -> None:
        """Release the worker threads, and close the window; the environment can still be used."""
        self._lanes.simulator.close()
        if self._frames is not None:
            self._frames.close()


class GFMWTGVectorEnv(gym.vector.VectorEnv[Observation, Action, npt.NDArray[Any]]):
    """Many :class:`GFMWTGEnv` episodes in one compiled call.

    Args:
        num_envs: number of episodes side by side.
        autoreset_mode: NEXT_STEP (Gymnasium's default), SAME_STEP or DISABLED.
        max_episode_steps: cuts episodes off after this many steps; scenarios stay those of `duration_s`.
        n_threads: threads to step with; None for one per processor. Results do not depend on it.
        render_mode: "rgb_array" lets :meth:`render` draw a frame per lane.
        arguments: as for :class:`GFMWTGEnv`.

    Raises:
        TypeError: an argument is unknown.
        ValueError: an argument is out of range.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    _spec: EnvSpec | None = None

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        n_threads: int | None = None,
        render_mode: str | None = None,
        **arguments: Unpack[EnvArguments],
    ) -> None:
        _check_render_mode(render_mode, self.metadata)
        self.render_mode = render_mode
        if not _is_whole(num_envs) or not 1 <= num_envs <= _MOST_ENVS:
            raise ValueError(f"num_envs must be a whole number in 1 … {_MOST_ENVS}, got {num_envs!r}")
        if n_threads is not None and (not _is_whole(n_threads) or n_threads < 1):
            raise ValueError(f"n_threads must be a whole number of 1 or more, got {n_threads!r}")
        if max_episode_steps is not None and (not _is_whole(max_episode_steps) or max_episode_steps < 1):
            raise ValueError(f"max_episode_steps must be a whole number of 1 or more, got {max_episode_steps!r}")
        self._max_episode_steps = max_episode_steps
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in modes and autoreset_mode not in list(AutoresetMode):
            raise ValueError(f"unknown autoreset_mode {autoreset_mode!r}; choose one of {', '.join(modes)}")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.settings = _settings(type(self).__name__, arguments)
        self.num_envs = num_envs
        self._lanes = TaskLanes(self.settings, num_envs, None if n_threads is None else int(n_threads))
        self._use = Use()
        self.metadata = {**_in_real_time(self.metadata, self.settings), "autoreset_mode": self.autoreset_mode}
        self._frames = None if render_mode is None else LaneFrames(self._lanes)
        self.single_observation_space, self.single_action_space = _spaces(self._lanes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._next = NextEpisodes(self._lanes, [seeding.np_random()[0] for _ in range(num_envs)])
        self._needs_reset = np.ones(num_envs, dtype=np.bool_)
        self._n_steps = np.zeros(num_envs, dtype=np.int64)
        self._all_lanes = np.ones(num_envs, dtype=np.bool_)
        self._all_lanes.setflags(write=False)

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's description of this environment; its `max_episode_steps` follows `duration_s`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = _with_episode_steps(spec, self._lanes, self._max_episode_steps)

    @property
    def lanes(self) -> TaskLanes:
        """The episodes' simulator, observations and costs."""
        return self._lanes

    @property
    def observation_names(self) -> list[str]:
        """Names and units of one lane's observation."""
        return self._lanes.observation_names

    @one_thread
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every lane, or in those of a mask.

        Args:
            seed: s seeds lane i with s + i; or one seed per lane.
            options: {"scenarios": one per lane} plays those; {"reset_mask": (num_envs,) bool} restarts only these.

        Raises:
            ValueError: unknown options, wrong lengths, or scenarios that do not fit.
        """
        given = _check_options(options, ("reset_mask", "scenarios"))
        mask = self._reset_mask(given.get("reset_mask"))
        seeds = self._lane_seeds(seed)
        scenarios = self._scenarios(given["scenarios"]) if "scenarios" in given else None
        lanes = np.flatnonzero(mask).tolist()
        generators = {lane: seeding.np_random(s)[0] for lane in lanes if (s := seeds[lane]) is not None}
        # Given scenarios that cannot start are refused before the first change.
        episodes = None if scenarios is None else self._lanes.prepare_given([scenarios[lane] for lane in lanes])
        self._next.reseed(generators)
        if episodes is None:
            self._next.start(lanes)
        else:
            self._lanes.commit(lanes, [episodes])
        self._mark_started(lanes)
        if self._frames is not None:
            self._frames.sample()
        return self._lanes.observations.copy(), self._infos(mask.copy())

    def _reset_mask(self, given: Any) -> npt.NDArray[np.bool_]:
        if given is None:
            return np.ones(self.num_envs, dtype=np.bool_)
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f'options["reset_mask"] must be a boolean array of shape {(self.num_envs,)} with at least one True, '
                f"got shape {mask.shape}, dtype {mask.dtype}: {given!r:.80}"
            )
        return mask

    def _scenarios(self, given: Any) -> list[Scenario]:
        if not isinstance(given, Sequence) or len(given) != self.num_envs:
            raise ValueError(f'options["scenarios"] must be a list of {self.num_envs} scenarios, got {given!r:.80}')
        return [_as_scenario(scenario) for scenario in given]

    def _lane_seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (int, np.integer)) and _is_whole(seed):
            return [_lane_seed(int(seed) + lane) for lane in range(self.num_envs)]
        if not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, str):
            raise ValueError(f"seed must be a whole number, or one per lane, got {seed!r}")
        if len(seed) != self.num_envs:
            raise ValueError(f"one seed per lane is needed ({self.num_envs}), got {len(seed)}")
        return [_lane_seed(given) for given in seed]

    def _mark_started(self, lanes: list[int]) -> None:
        self._needs_reset[lanes] = False
        self._n_steps[lanes] = 0

    @one_thread
    def step(
        self, actions: Action
    ) -> tuple[Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Hold the actions for one control interval in every lane.

        Args:
            actions: (num_envs, n_action), clipped to [-1, 1].

        Raises:
            ValueError: wrong shape, or a value that is not finite; nothing has been stepped then. Or a drawn scenario
                cannot start; every running lane has been stepped then, and that one still waits for its reset.
            RuntimeError: a lane was never started, or is over and resets are disabled; or another thread is in this
                environment.
        """
        waiting = self._needs_reset.copy()
        if waiting.any() and (self.autoreset_mode != AutoresetMode.NEXT_STEP or not self._started()):
            raise RuntimeError(
                f"lanes {np.flatnonzero(waiting).tolist()} are over or were never started; call reset() before step()"
            )
        beginning = np.flatnonzero(waiting).tolist()
        preparing = self._next.choose(beginning)
        self._lanes.step(
            as_actions(actions, (self.num_envs, self._lanes.n_action)),
            lambda: self._next.prepare(preparing),
            len(preparing),
        )
        self._n_steps += 1
        if self._max_episode_steps is not None:
            self._lanes.stop(~waiting & (self._n_steps >= self._max_episode_steps))
        terminated, truncated = self._lanes.ended()
        # A lane that waited for its reset has not been stepped: this step starts its next episode.
        terminated &= ~waiting
        truncated &= ~waiting
        rewards = self._lanes.rewards.copy()
        done = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and done.any():
            infos = self._final_infos(done)
            beginning = np.flatnonzero(done).tolist()
        self._needs_reset |= done
        if beginning:
            self._next.start(beginning)
            self._mark_started(beginning)
        if self._frames is not None:
            self._frames.sample()
        infos.update(self._infos(self._all_lanes))
        return self._lanes.observations.copy(), rewards, terminated, truncated, infos

    def _started(self) -> bool:
        return bool((self._lanes.task_values("end_step") > 0.0).all())

    def _infos(self, mask: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """Every key of `info` as an array, and as `_key` the lanes that it holds for: one array for all keys."""
        infos: dict[str, Any] = {}
        for key, array in self._lanes.info_arrays().items():
            infos[key], infos[f"_{key}"] = array, mask
        return infos

    def _final_infos(self, done: npt.NDArray[np.bool_]) -> dict[str, Any]:
        final = np.full(self.num_envs, None, dtype=object)
        for lane in np.flatnonzero(done):
            final[lane] = self._lanes.observations[lane].copy()
        return {
            "final_obs": final,
            "_final_obs": done.copy(),
            "final_info": self._infos(done.copy()),
            "_final_info": done.copy(),
        }

    def render(self) -> tuple[Frame, ...] | None:
        """Draw every lane's episode up to now: a frame (540, 960, 3) uint8 per lane.

        Without a render mode: None and a warning.

        Raises:
            RuntimeError: a lane was never started.
        """
        if self._frames is None:
            _warn_of_no_render_mode()
            return None
        return self._frames.paint()

    @one_thread
    def snapshot(self) -> Any:
        """Return a copy of every episode's complete state, for :meth:`restore`; the generators are not part of it."""
        frames = None if self._frames is None else self._frames.snapshot()
        return VectorSnapshot(self._lanes.snapshot(), self._needs_reset.copy(), self._n_steps.copy(), frames)

    @one_thread
    def restore(self, snapshot: Any) -> None:
        """Go back to a :meth:`snapshot`; errors as of :meth:`GFMWTGEnv.restore`."""
        _check_snapshot(snapshot, VectorSnapshot, self)
        lanes, needs_reset, n_steps, frames = snapshot
        self._lanes.restore(lanes)
        self._needs_reset[:], self._n_steps[:] = needs_reset, n_steps
        if self._frames is not None:
            self._frames.restore(frames)

    def close_extras(self, **kwargs: Any) -> None:
        """Release the worker threads."""
        self._lanes.simulator.close()
