"""Hyperparameters in the yml format of RL Zoo, read without running any code in them."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from wtg_gym.files import read_text

#: The algorithms by name; RL Zoo calls the last one ppo_lstm.
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "recurrent_ppo": RecurrentPPO}
CONFIG_FOLDER = Path(__file__).parent / "configs"
#: What a text in a file may name besides numbers, texts and lists.
ACTIVATIONS = {f"nn.{kind.__name__}": kind for kind in (nn.ELU, nn.LeakyReLU, nn.ReLU, nn.Sigmoid, nn.SiLU, nn.Tanh)}
#: Keys that may hold a text such as "lin_0.0003".
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_OF_THE_RUN = ("n_timesteps", "n_envs", "normalize")


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """A section of a file in Python's terms."""

    n_timesteps: int  # environment steps of a training run, all lanes together
    n_envs: int  # number of lanes
    normalize: Mapping[str, Any] | None  # arguments of VecNormalize; None for no normalisation
    arguments: Mapping[str, Any]  # arguments of the algorithm, `policy` among them


def read_config(path: Path, env_id: str) -> dict[str, Any]:
    """Return the section of an environment in a yml file as it is written there.

    Raises:
        ValueError: the file cannot be read, is not YAML, or has no section for the environment.
    """
    try:
        data = yaml.safe_load(read_text(path, "hyperparameter file"))
    except yaml.YAMLError as error:
        raise ValueError(f"the hyperparameter file {path} is not yml: {error}") from error
    if not isinstance(data, dict) or not isinstance(data.get(env_id), dict):
        raise ValueError(f"the hyperparameter file {path} must have a section {env_id!r} with keys and values")
    return dict(data[env_id])


def parse(raw: Mapping[str, Any]) -> Hyperparameters:
    """Return the hyperparameters that a section of a file means; the algorithm refuses unknown ones.

    Raises:
        ValueError: a value cannot be read; the message says what is allowed.
    """
    normalize = raw.get("normalize", False)
    options = {} if isinstance(normalize, bool) else parse_literal("normalize", normalize)
    if "gamma" in raw:
        # Rewards are scaled by the spread of the returns that the learner sees.
        options = {**options, "gamma": raw["gamma"]}
    return Hyperparameters(
        n_timesteps=_count("n_timesteps", raw.get("n_timesteps")),
        n_envs=_count("n_envs", raw.get("n_envs", 1)),
        normalize=None if normalize is False else options,
        arguments={key: _argument(key, value) for key, value in raw.items() if key not in _OF_THE_RUN},
    )


def _count(key: str, value: Any) -> int:
    """Return a whole number; RL Zoo's files write large ones as 1e6, which is a text in yml."""
    try:
        return int(float(value))
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{key} must be a whole number, got {value!r}") from error


def _argument(key: str, value: Any) -> Any:
    if key == "policy_kwargs":
        return parse_literal(key, value)
    if key == "train_freq" and isinstance(value, list):
        return tuple(value)
    if key in _SCHEDULES and isinstance(value, str):
        start = float(value.removeprefix("lin_"))
        return LinearSchedule(start=start, end=0.0, end_fraction=1.0) if value.startswith("lin_") else start
    return value


def parse_literal(key: str, value: Any) -> dict[str, Any]:
    """Return the dictionary that a text such as "dict(net_arch=[64, 64], activation_fn=nn.Tanh)" writes down.

    RL Zoo evaluates such texts. Here only literals, `dict(…)` and the names of :data:`ACTIVATIONS` mean anything.

    Raises:
        ValueError: not a dictionary, or one that holds anything else.
    """
    if isinstance(value, dict):
        return value
    try:
        result = _literal(ast.parse(str(value).strip(), mode="eval").body)
        if isinstance(result, dict):
            return result
    except (SyntaxError, ValueError):
        pass
    allowed = f"a dictionary of numbers, texts, lists, dict(…) and {', '.join(ACTIVATIONS)}"
    raise ValueError(f"{key} must be {allowed}, got {value!r}")


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
    return ast.literal_eval(node)
