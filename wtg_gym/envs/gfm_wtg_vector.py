"""The vector environment: many episodes in one compiled call."""

from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from wtg_gym.envs import interface, rendering
from wtg_gym.envs.batch import EPISODES_AT_ONCE, EnvBatch, PreparedEpisodes
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import is_whole, require_choice, require_whole


class NextEpisodes:
    """The episodes that environments play next, drawn by each one's own generator and prepared several at a time.

    Prepared by the handful, an episode takes less than half the time that it takes alone. Those whose episodes end soon
    are therefore prepared along with those that have ended. Its scenario does not depend on when it was prepared.
    """

    def __init__(self, batch: EnvBatch, generators: Sequence[np.random.Generator]) -> None:
        self._batch = batch
        self._generators = list(generators)
        #: The prepared group of an environment's episode, and its place there.
        self._ready: dict[int, tuple[PreparedEpisodes, int]] = {}
        #: Why an environment's episode cannot start.
        self._refused: dict[int, ValueError] = {}

    def choose(self, wanted: Sequence[int]) -> list[int]:
        """Return which environments to prepare now: those of `wanted` that are not ready, filled up to whole groups."""
        missing = [env for env in wanted if env not in self._ready and env not in self._refused]
        n_more = min(-len(missing) % EPISODES_AT_ONCE, self._batch.num_envs - len(missing))
        if not missing or n_more == 0:
            return missing
        remaining = self._batch.task_values("end_step") - self._batch.simulator.env_values("step")
        remaining[[*missing, *self._ready, *self._refused]] = np.inf
        soonest = np.argpartition(remaining, n_more - 1)[:n_more]
        return [*missing, *(int(env) for env in soonest if np.isfinite(remaining[env]))]

    def prepare(self, chosen: Sequence[int]) -> None:
        """Draw and prepare the next episodes; :meth:`start` raises the error of one that cannot start."""
        for first in range(0, len(chosen), EPISODES_AT_ONCE):
            group = chosen[first : first + EPISODES_AT_ONCE]
            scenarios = self._batch.draw([self._generators[env] for env in group])
            try:
                self._put(group, self._batch.prepare(scenarios))
            except ValueError:
                for env, scenario in zip(group, scenarios, strict=True):
                    try:
                        self._put([env], self._first_to_start(env, iter([scenario])))
                    except ValueError as error:
                        self._refused[env] = error

    def _first_to_start(self, env: int, drawn: Iterator[Scenario]) -> PreparedEpisodes:
        """Return an environment's next episode: of the scenarios drawn already and, after them, of new ones."""
        batch, rngs = self._batch, [self._generators[env]]
        return batch.first_to_start(env, lambda: batch.prepare([next(drawn, None) or batch.draw(rngs)[0]]))

    def _put(self, group: Sequence[int], episodes: PreparedEpisodes) -> None:
        self._ready.update({env: (episodes, place) for place, env in enumerate(group)})

    def reseed(self, generators: dict[int, np.random.Generator]) -> None:
        """Give environments new generators; episodes drawn by the old ones are dropped."""
        for env, generator in generators.items():
            self._generators[env] = generator
            self._ready.pop(env, None)
            self._refused.pop(env, None)

    def start(self, wanted: Sequence[int]) -> None:
        """Start the next episodes.

        A ValueError says that none of the scenarios drawn for one of them starts. None has been started, and that one
        goes on to the scenario after them.
        """
        self.prepare(self.choose(wanted))
        for env in wanted:
            if env in self._refused:
                raise self._refused.pop(env)
        groups: dict[int, list[int]] = {}
        for env in wanted:
            groups.setdefault(id(self._ready[env][0]), []).append(env)
        for group in groups.values():
            ready = [self._ready.pop(env) for env in group]
            self._batch.start(group, ready[0][0], [place for _, place in ready])


class GFMWTGVectorEnv(
    interface.OverBatch, gym.vector.VectorEnv[interface.Observation, interface.Action, npt.NDArray[Any]]
):
    """Many :class:`GFMWTGEnv` episodes in one compiled call.

    A TypeError names an argument that is unknown, a ValueError one that is out of range.

    Args:
        num_envs: number of environments.
        autoreset_mode: NEXT_STEP (Gymnasium's default), SAME_STEP or DISABLED.
        max_episode_steps: cuts episodes off after this many steps; scenarios stay those of `duration_s`.
        n_threads: threads; None for one per processor. Results do not depend on it.
        render_mode: "rgb_array" lets :meth:`render` draw a frame of each environment.
        arguments: as for :class:`GFMWTGEnv`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        n_threads: int | None = None,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        if n_threads is not None:
            n_threads = require_whole("n_threads", n_threads, 1)
        if max_episode_steps is not None:
            max_episode_steps = require_whole("max_episode_steps", max_episode_steps, 1)
        self._step_limit = max_episode_steps
        if not isinstance(autoreset_mode, AutoresetMode):
            require_choice("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode])
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        spaces = self._open(arguments, render_mode, num_envs, n_threads)
        self.single_observation_space, self.single_action_space = spaces
        self.num_envs = self._batch.num_envs
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._next = NextEpisodes(self._batch, [seeding.np_random()[0] for _ in range(num_envs)])
        self._all_envs = np.ones(num_envs, dtype=np.bool_)
        self._all_envs.setflags(write=False)

    @interface.one_thread
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[interface.Observation, dict[str, Any]]:
        """Start an episode in every environment, or in those of a mask.

        A ValueError names unknown options, wrong lengths, or scenarios that do not fit.

        Args:
            seed: s seeds environment i with s + i; or one seed per environment.
            options: {"scenarios": one per environment, or its seed} plays those; {"reset_mask": (num_envs,) bool}
                restarts only these environments.
        """
        checked = interface.check_options(options, ("reset_mask", "scenarios"))
        mask = self._reset_mask(checked.get("reset_mask"))
        seeds = self._env_seeds(seed)
        envs = np.flatnonzero(mask).tolist()
        # Given scenarios that cannot start are refused before the first change.
        episodes = None
        if "scenarios" in checked:
            option, name = checked["scenarios"], 'options["scenarios"]'
            if not isinstance(option, Sequence) or len(option) != self.num_envs:
                raise ValueError(f"{name} must be a list of {self.num_envs} scenarios, got {option!r:.80}")
            scenarios = [self._batch.scenario_of(name, scenario) for scenario in option]
            episodes = self._batch.prepare([scenarios[env] for env in envs], turning=True)
        generators = {env: seeding.np_random(s)[0] for env in envs if (s := seeds[env]) is not None}
        self._next.reseed(generators)
        if episodes is None:
            self._next.start(envs)
        else:
            self._batch.start(envs, episodes)
        if self._frames is not None:
            self._frames.sample()
        return self._batch.observations.copy(), self._infos(mask.copy())

    def _reset_mask(self, option: Any) -> npt.NDArray[np.bool_]:
        if option is None:
            return np.ones(self.num_envs, dtype=np.bool_)
        mask = np.asarray(option)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f'options["reset_mask"] must be a boolean array of shape {(self.num_envs,)} with at least one True, '
                f"got shape {mask.shape}, dtype {mask.dtype}: {option!r:.80}"
            )
        return mask

    def _env_seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        seeds: Sequence[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)) and is_whole(seed):
            seeds = [int(seed) + env for env in range(self.num_envs)]
        elif not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, str):
            raise ValueError(f"seed must be a whole number, or one per environment, got {seed!r}")
        elif len(seed) != self.num_envs:
            raise ValueError(f"one seed per environment is needed ({self.num_envs}), got {len(seed)}")
        else:
            seeds = seed
        return [None if env_seed is None else require_whole("a seed", env_seed, 0) for env_seed in seeds]

    @interface.one_thread
    def step(
        self, actions: interface.Action
    ) -> tuple[interface.Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Hold the actions (num_envs, n_action), clipped to [-1, 1], for one control step in every environment.

        A ValueError says that the actions have another shape or are not finite, and nothing has been stepped; or that a
        drawn scenario cannot start: every running environment has been stepped, and that one still waits for its reset.
        A RuntimeError says that an environment was never started, or is over and resets are disabled, or that another
        thread is in this object.
        """
        waiting = np.logical_or(*self._batch.ended())
        beginning = np.flatnonzero(waiting).tolist()
        if beginning and (self.autoreset_mode != AutoresetMode.NEXT_STEP or not self._batch.started):
            raise RuntimeError(f"environments {beginning} have ended or were never started; call reset()")
        preparing = self._next.choose(beginning)
        as_floats = interface.as_actions(actions, (self.num_envs, self._batch.n_action))
        self._batch.step(as_floats, lambda: self._next.prepare(preparing), len(preparing))
        if self._step_limit is not None:
            self._batch.stop(~waiting & (self._batch.n_steps() >= self._step_limit))
        terminated, truncated = self._batch.ended()
        # An environment that waited for its reset has not been stepped: this step starts its next episode.
        terminated &= ~waiting
        truncated &= ~waiting
        rewards = self._batch.rewards.copy()
        done = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and done.any():
            final = np.full(self.num_envs, None, dtype=object)
            for env in np.flatnonzero(done):
                final[env] = self._batch.observations[env].copy()
            infos["final_obs"], infos["_final_obs"] = final, done.copy()
            infos["final_info"], infos["_final_info"] = self._infos(done.copy()), done.copy()
            beginning = np.flatnonzero(done).tolist()
        if beginning:
            self._next.start(beginning)
        if self._frames is not None:
            self._frames.sample()
        infos.update(self._infos(self._all_envs))
        return self._batch.observations.copy(), rewards, terminated, truncated, infos

    def _infos(self, mask: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """Every key of `info` as an array, and as `_key` the environments that it holds for: one array for all keys."""
        arrays = self._batch.info_arrays()
        return {**arrays, **{f"_{key}": mask for key in arrays}}

    def render(self) -> tuple[rendering.Frame, ...] | None:
        """Draw every episode up to now: a frame (540, 960, 3) uint8 per environment.

        Without a render mode: None and a warning. A RuntimeError says that an environment was never started.
        """
        if self._frames is None:
            interface.warn_of_no_render_mode()
            return None
        return self._frames.paint()

    def close_extras(self, **kwargs: Any) -> None:
        """Release the worker threads."""
        self._batch.close()
