"""Hyperparameters in the yml format of RL Zoo, read without running any code in them."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from agents.networks import ACTIVATIONS
from wtg_gym import ENV_ID
from wtg_gym.files import read_text

#: The algorithms by name; RL Zoo calls the last one ppo_lstm.
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "ppo": PPO,
    "sac": SAC,
    "td3": TD3,
    "tqc": TQC,
    "recurrent_ppo": RecurrentPPO,
}
CONFIG_FOLDER = Path(__file__).parent / "configs"
#: Keys that may hold a text such as "lin_0.0003".
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_OF_THE_RUN = ("n_timesteps", "n_envs", "normalize", "noise_type", "noise_std")
#: What a number must be, lowest and highest value, and the keys that must be so: else nothing is learned, or an
#: algorithm ends in the midst of a run with an error of its own. None is allowed where it is an algorithm's default.
_RANGES: tuple[tuple[str, float, float, tuple[str, ...]], ...] = (
    ("a whole number of 1 or more", 1, 1e12, ("n_steps", "batch_size", "n_epochs", "buffer_size", "policy_delay")),
    ("a whole number of 1 or more", 1, 1e12, ("target_update_interval", "stats_window_size")),
    ("a whole number of 0 or more", 0, 1e12, ("learning_starts", "top_quantiles_to_drop_per_net")),
    ("a whole number of 1 or more, or -1", -1, 1e12, ("sde_sample_freq", "gradient_steps")),
    ("a number from 0 to 1", 0.0, 1.0, ("gamma", "gae_lambda", "tau")),
    ("a number of 0 or more", 0.0, 1e12, ("ent_coef", "vf_coef", "target_policy_noise", "target_noise_clip")),
    ("a number above 0", 1e-12, 1e12, ("learning_rate", "clip_range", "clip_range_vf", "max_grad_norm", "target_kl")),
    ("a number above 0", 1e-12, 1e12, ("clip_obs", "clip_reward", "epsilon")),
)
_RANGE_OF = {key: (what, low, high) for what, low, high, keys in _RANGES for key in keys}
#: Arguments of the algorithms that are set by the run itself or would need code in the file.
_NOT_IN_FILES = (
    "self",
    "env",
    "seed",
    "device",
    "verbose",
    "tensorboard_log",
    "action_noise",
    "replay_buffer_class",
    "replay_buffer_kwargs",
    "rollout_buffer_class",
    "rollout_buffer_kwargs",
    "_init_setup_model",
)


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """What a file says, in Python's terms.

    Args:
        n_timesteps: environment steps of a training run, all lanes together.
        n_envs: number of lanes.
        normalize: arguments of VecNormalize; None for no normalisation.
        noise_std: standard deviation of the exploration noise on the actions, None for none.
        arguments: arguments of the algorithm, `policy` among them.
    """

    n_timesteps: int
    n_envs: int
    normalize: Mapping[str, Any] | None
    noise_std: float | None
    arguments: Mapping[str, Any]


def read_config(path: Path) -> dict[str, Any]:
    """Return the environment's section of a yml file as it is written there.

    Raises:
        ValueError: the file cannot be read, is no yml, or has no section for the environment.
    """
    try:
        data = yaml.safe_load(read_text(path, "hyperparameter file"))
    except yaml.YAMLError as error:
        raise ValueError(f"the hyperparameter file {path} is not yml: {error}") from error
    if not isinstance(data, dict) or not isinstance(data.get(ENV_ID), dict):
        raise ValueError(f"the hyperparameter file {path} must have a section {ENV_ID!r} with keys and values")
    return dict(data[ENV_ID])


def parse(algo: str, raw: Mapping[str, Any]) -> Hyperparameters:
    """Return the hyperparameters that a section of a file means.

    Args:
        algo: one of :data:`ALGORITHMS`.
        raw: what :func:`read_config` returns.

    Raises:
        ValueError: an algorithm, key or value is unknown or out of range; the message says what is allowed.
    """
    if algo not in ALGORITHMS:
        raise ValueError(f"unknown algorithm {algo!r}; choose one of {', '.join(ALGORITHMS)}")
    known = [key for key in inspect.signature(ALGORITHMS[algo]).parameters if key not in _NOT_IN_FILES]
    unknown = sorted(set(raw) - set(known) - set(_OF_THE_RUN))
    if unknown:
        raise ValueError(f"unknown hyperparameters {unknown} of {algo}; known: {', '.join([*_OF_THE_RUN, *known])}")
    if not isinstance(raw.get("policy"), str):
        raise ValueError(f'policy must be the name of one, such as "MlpPolicy", got {raw.get("policy")!r}')
    _require_finite(raw)
    defaults = {key: each.default for key, each in inspect.signature(ALGORITHMS[algo]).parameters.items()}
    arguments = {key: _value(key, raw[key]) for key in raw if key in known}
    for key, value in arguments.items():
        _require_in_range(key, value, defaults[key])
    normalize = raw.get("normalize", False)
    options = None if normalize is False else {} if normalize is True else parse_literal("normalize", normalize)
    if options is not None and "gamma" in raw:
        # Rewards are scaled by the spread of the returns that the learner sees.
        options = {**options, "gamma": raw["gamma"]}
    taken = [key for key in inspect.signature(VecNormalize).parameters if key != "venv"]
    if options is not None and not set(options) <= set(taken):
        raise ValueError(f"normalize takes {', '.join(taken)}, got {options}")
    for key, value in (options or {}).items():
        _require_in_range(key, value, inspect.signature(VecNormalize).parameters[key].default, "normalize: ")
    return Hyperparameters(
        n_timesteps=_whole("n_timesteps", raw.get("n_timesteps")),
        n_envs=_whole("n_envs", raw.get("n_envs", 1)),
        normalize=options,
        noise_std=_noise(raw),
        arguments=arguments,
    )


def _require_finite(values: Any, key: str = "") -> None:
    """Refuse NaN and infinity, in lists and dictionaries as well; no file of ours could hold them."""
    if isinstance(values, Mapping):
        for name, value in values.items():
            _require_finite(value, key or str(name))
    elif isinstance(values, (list, tuple)):
        for value in values:
            _require_finite(value, key)
    elif isinstance(values, float) and not np.isfinite(values):
        raise ValueError(f"{key} must be finite, got {values}")


def _require_in_range(key: str, value: Any, default: Any, where: str = "") -> None:
    """Refuse a value of the wrong type or beyond :data:`_RANGES`; `default` is the algorithm's own."""
    if value is None and default is None:
        return
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{where}{key} must be true or false, got {value!r}")
    elif key == "train_freq":
        steps = value[0] if isinstance(value, tuple) and len(value) == 2 and value[1] == "step" else value
        if isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
            raise ValueError(f'{where}{key} must be a whole number of 1 or more, or [it, "step"], got {value!r}')
    elif key in _RANGE_OF and not isinstance(value, LinearSchedule):
        if key == "ent_coef" and isinstance(default, str) and isinstance(value, str):
            if value != "auto" and not _is_number_above_0(value.removeprefix("auto_")):
                raise ValueError(
                    f'{where}{key} must be a number, "auto", or "auto_" with a number above 0, got {value!r}'
                )
            return
        what, low, high = _RANGE_OF[key]
        kinds = int if "whole" in what else (int, float)
        bad = isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high
        if bad or (low == -1 and value == 0):
            raise ValueError(f"{where}{key} must be {what}, got {value!r}")


def _is_number_above_0(text: str) -> bool:
    try:
        return 0.0 < float(text) < np.inf
    except ValueError:
        return False


def _value(key: str, value: Any) -> Any:
    if key == "policy_kwargs":
        result = parse_literal(key, value)
        _require_finite(result, key)
        return result
    if key == "train_freq" and isinstance(value, list):
        return tuple(value)
    if key in _SCHEDULES and isinstance(value, str):
        kind, _, start = value.partition("_")
        if kind != "lin" or not _is_number_above_0(start):
            raise ValueError(f'{key} must be a number above 0, or "lin_" with the number to fall from, got {value!r}')
        return LinearSchedule(start=float(start), end=0.0, end_fraction=1.0)
    return value


def _whole(key: str, value: Any) -> int:
    # 1e6 is a text in yml and 1.0e6 a float.
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = 0.0
    if isinstance(value, bool) or not number.is_integer() or number < 1:
        raise ValueError(f"{key} must be a whole number of 1 or more, got {value!r}")
    return int(number)


def _noise(raw: Mapping[str, Any]) -> float | None:
    if raw.get("noise_type") is None:
        return None
    std = raw.get("noise_std")
    if raw["noise_type"] != "normal" or isinstance(std, bool) or not isinstance(std, (int, float)) or not 0 < std <= 1:
        raise ValueError(
            f'noise_type must be "normal" with a noise_std above 0 and up to 1, got {raw["noise_type"]!r} with {std!r}'
        )
    return float(std)


def parse_literal(key: str, value: Any) -> dict[str, Any]:
    """Return the dictionary that a text such as "dict(net_arch=[64, 64], activation_fn=nn.Tanh)" writes down.

    RL Zoo evaluates such texts. Here only literals, `dict(…)` and the names of :data:`agents.networks.ACTIVATIONS`
    mean anything.

    Raises:
        ValueError: it is no dictionary, or holds anything else.
    """
    allowed = f"{key} must be a dictionary of numbers, texts, lists, dict(…) and {', '.join(ACTIVATIONS)}"
    if isinstance(value, dict):
        return value
    if not isinstance(value, str):
        raise ValueError(f"{allowed}, got {value!r}")
    try:
        result = _literal(ast.parse(value.strip(), mode="eval").body)
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"{allowed}, got {value!r}: {error}") from error
    if not isinstance(result, dict):
        raise ValueError(f"{allowed}, got {value!r}")
    return result


def _literal(node: ast.expr) -> Any:
    match node:
        case ast.Call(func=ast.Name(id="dict"), args=[], keywords=keywords) if all(each.arg for each in keywords):
            return {str(each.arg): _literal(each.value) for each in keywords}
        case ast.Dict(keys=keys, values=values) if None not in keys:
            return {_literal(key): _literal(value) for key, value in zip(keys, values, strict=True) if key is not None}
        case ast.List(elts=elements):
            return [_literal(element) for element in elements]
        case ast.Attribute() if ast.unparse(node) in ACTIVATIONS:
            return ACTIVATIONS[ast.unparse(node)]
        case ast.Call() | ast.Attribute() | ast.Name():
            raise ValueError(f"{ast.unparse(node)!r} is not allowed")
    return ast.literal_eval(node)


def build_model(algo: str, hyperparameters: Hyperparameters, env: VecEnv, *, seed: int, device: str) -> BaseAlgorithm:
    """Return an untrained learner.

    Args:
        algo: one of :data:`ALGORITHMS`.
        hyperparameters: its hyperparameters.
        env: environment to learn in.
        seed: seed of the weights, of the exploration and, plus the lane's number, of the lanes' scenarios.
        device: "cpu" or "cuda".

    Raises:
        ValueError: the algorithm refuses a hyperparameter, or there is no such device.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("device is cuda, but torch finds no such device; use cpu")
    # The algorithms write into policy_kwargs.
    arguments = dict(hyperparameters.arguments)
    arguments["policy_kwargs"] = dict(arguments.get("policy_kwargs") or {})
    if hyperparameters.noise_std is not None:
        shape = env.action_space.shape
        assert shape is not None
        arguments["action_noise"] = NormalActionNoise(np.zeros(shape), np.full(shape, hyperparameters.noise_std))
    try:
        return ALGORITHMS[algo](env=env, seed=seed, device=device, **arguments)
    except (AssertionError, AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{algo} refuses its hyperparameters {dict(hyperparameters.arguments)}: {reason}") from error


__all__ = ["ALGORITHMS", "CONFIG_FOLDER", "Hyperparameters", "build_model", "parse", "read_config"]
