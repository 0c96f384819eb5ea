"""Training with Stable-Baselines3 on many episodes at once; needs `pip install 'wtg-gym[train]'`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from wtg_gym.envs import GFMWTGVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise ImportError("wtg_gym.sb3 needs Stable-Baselines3: pip install 'wtg-gym[train]'") from error

Observations = npt.NDArray[np.float32]
Info = dict[str, Any]

#: What an attribute of a single environment is called in the vector environment.
_NAMES_IN_THE_BATCH = {"action_space": "single_action_space", "observation_space": "single_observation_space"}
#: Attributes whose values in the vector environment would mislead: its lanes have generators of their own.
_NOT_OF_A_LANE = ("np_random", "np_random_seed")


def _columns(infos: Info) -> Info:
    """Return the keys of a vector environment's info that hold one value per lane, without their masks."""
    return {key: value for key, value in infos.items() if not key.startswith(("_", "final_"))}


def _values(column: npt.NDArray[Any]) -> list[Any]:
    """Return one value per lane, of the types that the single environment gives: numpy's floats, else Python's own."""
    return list(column) if column.dtype.kind == "f" else column.tolist()


def _lane_info(columns: Info, lane: int) -> Info:
    return {key: _values(column[lane : lane + 1])[0] for key, column in columns.items()}


class SB3VecEnv(VecEnv):
    """:class:`wtg_gym.envs.GFMWTGVectorEnv` as a vector environment of Stable-Baselines3.

    Observations, rewards and episode ends equal those of a `DummyVecEnv` of single environments with the same seeds,
    bit for bit. A lane whose episode ends starts the next one within the same step.

    Every step gives a list of `num_envs` infos:

    - While its episode runs, a lane's info holds `TimeLimit.truncated` (False) and the keys of `info_keys`, nothing
      else: learners need no more, and writing every key for every lane slows a large batch down.
    - At its end it holds every key of the single environment's info for the last step, `terminal_observation`
      (n_observation,) float32, and `TimeLimit.truncated`: True where time was over without a failure.

    `reset_infos` holds every lane's info of its episode's start.

    Args:
        num_envs: number of episodes side by side.
        info_keys: keys of the single environment's info to hold at every step as well, e.g. ("frequency_hz",).
        arguments: as for :class:`wtg_gym.envs.GFMWTGVectorEnv`, but `autoreset_mode`.

    Raises:
        TypeError: an argument is unknown.
        ValueError: an argument or one of `info_keys` is unknown or out of range.
    """

    def __init__(self, num_envs: int = 1, *, info_keys: Iterable[str] = (), **arguments: Any) -> None:
        if "autoreset_mode" in arguments:
            raise TypeError("autoreset_mode cannot be chosen: Stable-Baselines3 needs resets within the same step")
        #: The batch that does the work.
        self.vector_env = GFMWTGVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments)
        # Else the letters of a single key would be taken for keys.
        self.info_keys = (info_keys,) if isinstance(info_keys, str) else tuple(info_keys)
        known = list(self.vector_env.lanes.info_arrays())
        unknown = [key for key in self.info_keys if key not in known]
        if unknown:
            self.vector_env.close()
            raise ValueError(f"unknown info_keys {unknown}; known keys: {', '.join(known)}")
        self._actions: npt.NDArray[Any] | None = None
        super().__init__(num_envs, self.vector_env.single_observation_space, self.vector_env.single_action_space)
        # Without it VecVideoRecorder would play an episode three times as fast as it was.
        self.metadata["render_fps"] = self.vector_env.metadata["render_fps"]

    def reset(self) -> Observations:
        """Start an episode in every lane, with the seeds and options set before, which are used once.

        Returns:
            The observations (num_envs, n_observation).

        Raises:
            ValueError: a seed is negative, or a scenario does not fit; seeds and options are kept then.
        """
        self._actions = None
        observations, infos = self._start()
        columns = _columns(infos)
        self.reset_infos = [_lane_info(columns, lane) for lane in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def _start(self) -> tuple[Observations, Info]:
        scenarios = [options.get("scenario") for options in self._options]
        played = np.array([scenario is not None for scenario in scenarios])
        if not played.any():
            return self.vector_env.reset(seed=self._seeds)
        # The vector environment wants a scenario for every lane, those that the mask leaves alone included. Scenarios
        # can be refused and go first, so that nothing has changed where one is.
        filler = scenarios[int(np.argmax(played))]
        given = [filler if scenario is None else scenario for scenario in scenarios]
        result = self.vector_env.reset(seed=self._seeds, options={"reset_mask": played, "scenarios": given})
        if not played.all():
            result = self.vector_env.reset(seed=self._seeds, options={"reset_mask": ~played})
        return result

    def set_options(self, options: Sequence[Info] | Info | None = None) -> None:
        """Set what the next reset starts with; the resets at the ends of episodes draw scenarios again.

        Args:
            options: {"scenario": Scenario or its to_dict()} for all lanes, or a list with one such dictionary, which
                may be empty, per lane.

        Raises:
            ValueError: unknown options, or not one per lane.
        """
        single = options is None or isinstance(options, dict)
        per_lane: list[Any] = [options or {}] * self.num_envs if single else list(options or ())
        if len(per_lane) != self.num_envs or not all(isinstance(given, dict) for given in per_lane):
            raise ValueError(f"options must be a dictionary, or a list of {self.num_envs}, got {options!r:.80}")
        unknown = sorted({str(key) for given in per_lane for key in given if key != "scenario"})
        if unknown:
            raise ValueError(f"unknown reset options {unknown}; known options: scenario")
        super().set_options(per_lane)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take the actions (num_envs, n_action) of the step that :meth:`step_wait` does."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[Info]]:
        """Hold the actions for one control interval in every lane.

        Returns:
            Observations (num_envs, n_observation) float32, rewards (num_envs,) float32, dones (num_envs,) bool and a
            list of infos: new ones at every step. Where done, the observation is the next episode's first.

        Raises:
            ValueError: the actions have a wrong shape or a value that is not finite; nothing has been stepped then.
            RuntimeError: :meth:`step_async` or :meth:`reset` was not called before.
        """
        if self._actions is None:
            raise RuntimeError("no actions to step with; call reset() and step_async(actions) before step_wait()")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, batch = self.vector_env.step(actions)
        dones = terminated | truncated
        infos: list[Info] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for key in self.info_keys:
            for info, value in zip(infos, _values(batch[key]), strict=True):
                info[key] = value
        if dones.any():
            self._end_episodes(infos, batch, dones, truncated & ~terminated)
        return observations, rewards.astype(np.float32), dones, infos

    def _end_episodes(
        self, infos: list[Info], batch: Info, dones: npt.NDArray[np.bool_], out_of_time: npt.NDArray[np.bool_]
    ) -> None:
        """Write the infos of the lanes that ended, and keep those of the episodes that began in their place."""
        last, first = _columns(batch["final_info"]), _columns(batch)
        for index in np.flatnonzero(dones):
            lane = int(index)
            infos[lane] = {
                **_lane_info(last, lane),
                "TimeLimit.truncated": bool(out_of_time[lane]),
                "terminal_observation": batch["final_obs"][lane],
            }
            self.reset_infos[lane] = _lane_info(first, lane)

    def close(self) -> None:
        """Release the worker threads."""
        self.vector_env.close()

    def get_images(self) -> list[npt.NDArray[np.uint8] | None]:
        """Return a frame per lane, which `render_mode="rgb_array"` asks for; else None per lane."""
        if self.vector_env.render_mode is None:
            return [None] * self.num_envs
        return list(self.vector_env.render() or ())

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute that all lanes share, such as `settings` or `observation_names`, once per lane asked for.

        Raises:
            AttributeError: there is none of that name, it is a method, or a lane's own that cannot be read.
            IndexError: there is no such lane.
        """
        lanes = self._lanes_asked_for(indices)
        name = _NAMES_IN_THE_BATCH.get(attr_name, attr_name)
        value = None if name in _NOT_OF_A_LANE else getattr(self.vector_env, name)
        if name in _NOT_OF_A_LANE or callable(value):
            raise AttributeError(f"the lanes are stepped together and have no {attr_name!r} of their own")
        return [value] * len(lanes)

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Refuse: what an environment was made with stays.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(
            f"cannot set {attr_name!r}: the lanes have no attributes of their own; make a new SB3VecEnv with other "
            'arguments, or choose scenarios with set_options({"scenario": …})'
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: the lanes are stepped together and are no objects of their own.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(
            f"cannot call {method_name!r} of single lanes: they are stepped together; `vector_env` has the methods of "
            "the batch, a DummyVecEnv those of single environments"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """Return False per lane asked for: wrappers of single environments cannot be put around a lane."""
        return [False] * len(self._lanes_asked_for(indices))

    def _lanes_asked_for(self, indices: int | Iterable[int] | None) -> list[int]:
        lanes = range(self.num_envs)
        return [lanes[index] for index in self._get_indices(indices)]


def make_sb3_vec_env(
    num_envs: int = 1,
    *,
    seed: int | None = None,
    monitor_file: str | None = None,
    info_keys: Iterable[str] = (),
    **arguments: Any,
) -> VecMonitor:
    """Return a :class:`SB3VecEnv` that reports the returns and lengths of episodes to the learner.

    Args:
        num_envs: number of episodes side by side.
        seed: s seeds lane i with s + i at the first reset; a learner's own `seed` replaces it.
        monitor_file: also write them to this file, whose name is made to end in `monitor.csv`.
        info_keys: keys of the single environment's info to hold at every step as well.
        arguments: as for :class:`wtg_gym.envs.GFMWTGVectorEnv`, but `autoreset_mode`.

    Raises:
        TypeError: an argument is unknown.
        ValueError: an argument or one of `info_keys` is unknown or out of range.
    """
    env = VecMonitor(SB3VecEnv(num_envs, info_keys=info_keys, **arguments), filename=monitor_file)
    if seed is not None:
        env.seed(seed)
    return env


__all__ = ["SB3VecEnv", "make_sb3_vec_env"]
