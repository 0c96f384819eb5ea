"""Training with Stable-Baselines3 on many episodes at once; needs the extra `train`."""

import inspect
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.envs.interface import Observation
from wtg_gym.extras import install_advice
from wtg_gym.policies.entry import learned_in
from wtg_gym.signals import undivided

try:
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise ImportError(f"wtg_gym.sb3 needs Stable-Baselines3; {install_advice('train')}") from error

Info = dict[str, Any]
Indices = int | Iterable[int] | None


class SB3VecEnv(VecEnv):
    """:class:`wtg_gym.envs.GFMWTGVectorEnv` as a vector environment of Stable-Baselines3.

    Observations, rewards and episode ends equal those of a `DummyVecEnv` of single environments with the same seeds,
    bit for bit. An environment whose episode ends starts the next one within the same step.

    While an episode runs, its info holds `TimeLimit.truncated` (False) only: learners need no more, and writing every
    key slows a large batch down. `batch.info_arrays()` has the others. At its end it holds every key of the single
    environment's info for the last step, `terminal_observation` (n_observation,) float32, and `TimeLimit.truncated`:
    True where time was over without a failure. `reset_infos` holds the info of every episode's start.

    Args:
        num_envs: number of episodes side by side.
        arguments: as for :class:`wtg_gym.envs.GFMWTGVectorEnv`, but `autoreset_mode`, with the same errors.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        if "autoreset_mode" in arguments:
            raise TypeError("autoreset_mode cannot be chosen: Stable-Baselines3 needs resets within the same step")
        #: The vector environment that does the work.
        self.vector_env = env = GFMWTGVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments)
        #: Its batch: states, and every number of `info` by `info_arrays()`.
        self.batch = env.batch
        self._actions: npt.NDArray[Any] | None = None
        super().__init__(num_envs, env.single_observation_space, env.single_action_space)
        # Without it VecVideoRecorder would play an episode three times as fast as it was.
        self.metadata["render_fps"] = env.metadata["render_fps"]

    @undivided
    def reset(self) -> Observation:
        """Start an episode in every environment, with the seeds set before, which are used once.

        It returns the observations (num_envs, n_observation). A ValueError says that a seed is negative, or that
        options were set, of which there are none.
        """
        if any(self._options):
            raise ValueError(f"SB3VecEnv has no reset options, got {self._options!r:.80}; its vector_env has some")
        self._actions = None
        observations, infos = self.vector_env.reset(seed=list(self._seeds))
        self.reset_infos = [_env_info(infos, env_index) for env_index in range(self.num_envs)]
        self._reset_seeds()
        return observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take the actions (num_envs, n_action) of the step that :meth:`step_wait` does."""
        self._actions = actions

    @undivided
    def step_wait(self) -> tuple[Observation, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[Info]]:
        """Hold the actions for one control step in every environment.

        It returns observations (num_envs, n_observation) float32, rewards (num_envs,) float32, dones (num_envs,) and
        infos. A RuntimeError says that there were no actions or no reset, a ValueError what is wrong with the actions.
        """
        if self._actions is None:
            raise RuntimeError("call reset() and step_async(actions) before step_wait()")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, of_all = self.vector_env.step(actions)
        dones = terminated | truncated
        infos: list[Info] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for env_index in np.flatnonzero(dones).tolist():
            infos[env_index] = {
                **_env_info(of_all["final_info"], env_index),
                "TimeLimit.truncated": bool(truncated[env_index] and not terminated[env_index]),
                "terminal_observation": of_all["final_obs"][env_index],
            }
            self.reset_infos[env_index] = _env_info(of_all, env_index)
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Release the worker threads."""
        self.vector_env.close()

    def get_images(self) -> list[npt.NDArray[np.uint8] | None]:
        """Return a frame per environment, which `render_mode="rgb_array"` asks for; else None per environment."""
        if self.vector_env.render_mode is None:
            return [None] * self.num_envs
        frames: Any = self.vector_env.render()
        return list(frames or ())

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute that all share, such as `settings` or `observation_names`, once per environment.

        An AttributeError says that there is none, that it is a method, or an environment's own that cannot be read.
        """
        # Spaces of the batch have other shapes, and its generators are not those of the environments.
        name = f"single_{attr_name}" if attr_name in ("action_space", "observation_space") else attr_name
        is_own = name in ("np_random", "np_random_seed")
        if is_own or callable(value := getattr(self.vector_env.unwrapped, name)):
            raise AttributeError(f"the environments are stepped together and have no {attr_name!r} of their own")
        return [value] * len(np.arange(self.num_envs)[list(self._get_indices(indices))])

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Raise an AttributeError: the arguments of an environment are fixed."""
        raise AttributeError(f"cannot set {attr_name!r} of single environments: make them anew with other arguments")

    def env_method(self, method_name: str, *arguments: Any, indices: Indices = None, **keywords: Any) -> list[Any]:
        """Raise an AttributeError: the environments are stepped together and are no objects of their own."""
        raise AttributeError(f"cannot call {method_name!r} of single environments; `vector_env` has those of the batch")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """Return False per environment asked for: none can have a wrapper of its own."""
        return [False for _ in self._get_indices(indices)]


def _env_info(infos: Info, env_index: int) -> Info:
    """Return an environment's info from that of the batch, in the types of the single environment."""
    # Masks and what has ended are left out. Numbers in floating point stay numpy's; others become Python's own.
    columns = {key: column for key, column in infos.items() if not key.startswith(("_", "final_"))}
    return {
        key: column[env_index] if column.dtype.kind == "f" else column[env_index : env_index + 1].tolist()[0]
        for key, column in columns.items()
    }


class _Monitor(VecMonitor):
    """The monitor of Stable-Baselines3, with sums that an interrupt leaves in step, and with copies."""

    @undivided
    def reset(self) -> Any:
        return super().reset()

    @undivided
    def step_wait(self) -> Any:
        return super().step_wait()

    def __getstate__(self) -> dict[str, Any]:
        # What belongs to the class cannot be copied, and need not.
        return {name: value for name, value in vars(self).items() if name != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, class_attributes=dict(inspect.getmembers(type(self))))


def make_sb3_vec_env(num_envs: int = 1, *, seed: int | None = None, **arguments: Any) -> VecMonitor:
    """Return a :class:`SB3VecEnv` that reports the returns and lengths of episodes to the learner.

    Args:
        num_envs: number of episodes side by side.
        seed: s seeds environment i with s + i at the first reset; a learner's own `seed` replaces it.
        arguments: as for :class:`SB3VecEnv`, with the same errors.
    """
    env = _Monitor(SB3VecEnv(num_envs, **arguments))
    if seed is not None:
        env.seed(seed)
    return env


class DeterministicPolicy(torch.nn.Module):
    """The deterministic action of a learner, its normalisation of observations included, for `wtg_gym.export_onnx`.

    The learner is one of Stable-Baselines3 or sb3-contrib with continuous actions.
    """

    _mean: torch.Tensor
    _std: torch.Tensor

    def __init__(self, model: BaseAlgorithm) -> None:
        super().__init__()
        #: Strategy and modes of the model's environment, for entry.toml.
        self.learned_in = learned_in(model)
        self._policy: Any = model.policy
        self._lstm: Any = getattr(model.policy, "lstm_actor", None)
        #: Widths of the states: hidden and cell of every layer of an LSTM, else none.
        self.state_widths: tuple[int, ...] = ()
        if self._lstm is not None:
            self.state_widths = (self._lstm.hidden_size,) * (2 * self._lstm.num_layers)
        normalization: Any = model.get_vec_normalize_env()
        self._clip = None
        if normalization is not None and normalization.norm_obs:
            # In double precision, as VecNormalize does it.
            moments, self._clip = normalization.obs_rms, normalization.clip_obs
            self.register_buffer("_mean", torch.as_tensor(moments.mean))
            self.register_buffer("_std", torch.sqrt(torch.as_tensor(moments.var + normalization.epsilon)))

    def forward(self, observation: torch.Tensor, *states: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return actions (batch, n_action) and next states for raw observations (batch, n_observation)."""
        if self._clip is not None:
            observation = ((observation.double() - self._mean) / self._std).clamp(-self._clip, self._clip).float()
        policy = self._policy
        if self._lstm is None:
            return (policy._predict(observation, deterministic=True),)
        features = policy.extract_features(observation, policy.pi_features_extractor)
        hidden, cell = (torch.stack(states[first::2]) for first in (0, 1))
        output, (hidden, cell) = self._lstm(features[None], (hidden, cell))
        mean = policy.action_net(policy.mlp_extractor.forward_actor(output[0]))
        return mean, *(state for layer in zip(hidden, cell, strict=True) for state in layer)
