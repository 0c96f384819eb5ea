"""Hyperparameters in the yml format of RL Zoo, read without running any code in them."""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

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
#: What a text in a file may name besides numbers, texts and lists.
ACTIVATIONS = {f"nn.{kind.__name__}": kind for kind in (nn.ELU, nn.LeakyReLU, nn.ReLU, nn.Sigmoid, nn.SiLU, nn.Tanh)}
#: Keys that may hold a text such as "lin_0.0003".
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_OF_THE_RUN = ("n_timesteps", "n_envs", "normalize", "noise_type", "noise_std")
_WHOLE_KEYS = "n_timesteps n_envs n_steps batch_size n_epochs buffer_size policy_delay target_update_interval"
#: What a number must be, its lowest and highest value, and the keys that must be so: else nothing is learned, or an
#: algorithm ends in the midst of a run with an error of its own.
_RANGES = (
    ("a whole number of 1 or more", 1, math.inf, _WHOLE_KEYS.split()),
    ("a whole number of 0 or more", 0, math.inf, ["learning_starts", "top_quantiles_to_drop_per_net"]),
    ("a whole number of 1 or more, or -1", -1, math.inf, ["sde_sample_freq", "gradient_steps"]),
    ("a number from 0 to 1", 0.0, 1.0, ["gamma", "gae_lambda", "tau"]),
    ("a number of 0 or more", 0.0, math.inf, ["vf_coef", "target_policy_noise", "target_noise_clip"]),
    ("a number above 0", 1e-12, math.inf, [*_SCHEDULES, "max_grad_norm", "target_kl", "clip_obs", "clip_reward"]),
)
_RANGE_OF = {key: (kind, low, high) for kind, low, high, keys in _RANGES for key in keys}
#: Arguments of the algorithms that the run itself sets, or that would need code in the file.
_NOT_IN_FILES = {"self", "env", "seed", "device", "verbose", "tensorboard_log", "action_noise", "_init_setup_model"}
_NOT_IN_FILES |= {f"{kind}_buffer_{part}" for kind in ("replay", "rollout") for part in ("class", "kwargs")}


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """A section of a file in Python's terms."""

    n_timesteps: int  # environment steps of a training run, all lanes together
    n_envs: int  # number of lanes
    normalize: Mapping[str, Any] | None  # arguments of VecNormalize; None for no normalisation
    noise_std: float | None  # standard deviation of the exploration noise on the actions, None for none
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
    sections = {name: each for name, each in data.items() if isinstance(each, dict)} if isinstance(data, dict) else {}
    if env_id not in sections:
        names = ", ".join(map(str, sections))
        others = f"; it has one for {names}: give another file with --config, or its --suite" if sections else ""
        raise ValueError(f"the hyperparameter file {path} must have a section {env_id!r} with keys and values{others}")
    return dict(sections[env_id])


def parse(algo: str, raw: Mapping[str, Any]) -> Hyperparameters:
    """Return the hyperparameters that a section of a file means.

    Raises:
        ValueError: a key or value is unknown or out of range; the message says what is allowed.
    """
    known = set(inspect.signature(ALGORITHMS[algo]).parameters) - _NOT_IN_FILES
    unknown = sorted(set(raw) - known - set(_OF_THE_RUN))
    if unknown:
        allowed = ", ".join([*_OF_THE_RUN, *sorted(known)])
        raise ValueError(f"unknown hyperparameters {unknown} of {algo}; known: {allowed}")
    if not isinstance(raw.get("policy"), str):
        raise ValueError(f'policy must be the name of one, such as "MlpPolicy", got {raw.get("policy")!r}')
    # RL Zoo's files write large numbers as 1e6, which is a text in yml.
    values = {"n_envs": 1, "n_timesteps": None, **{key: _value(key, value) for key, value in raw.items()}}
    for key, value in values.items():
        _require_in_range(key, value)
    kind, std = raw.get("noise_type"), raw.get("noise_std")
    if kind is not None and (kind != "normal" or not isinstance(std, (int, float)) or not 0 < std <= 1):
        raise ValueError(f'noise_type must be "normal" with a noise_std above 0 and up to 1, got {kind!r} with {std!r}')
    return Hyperparameters(
        n_timesteps=values["n_timesteps"],
        n_envs=values["n_envs"],
        normalize=_normalize(raw),
        noise_std=None if std is None else float(std),
        arguments={key: value for key, value in values.items() if key in known},
    )


def _normalize(raw: Mapping[str, Any]) -> dict[str, Any] | None:
    given = raw.get("normalize", False)
    if given is False:
        return None
    options = {} if given is True else parse_literal("normalize", given)
    if "gamma" in raw:
        # Rewards are scaled by the spread of the returns that the learner sees.
        options = {**options, "gamma": raw["gamma"]}
    allowed = list(inspect.signature(VecNormalize).parameters)[1:]
    if not set(options) <= set(allowed):
        raise ValueError(f"normalize takes {', '.join(allowed)}, got {options}")
    for key, value in options.items():
        _require_in_range(key, value)
    return options


def _require_in_range(key: str, value: Any) -> None:
    """Refuse a number of the wrong kind or beyond :data:`_RANGES`; None is the algorithm's own business."""
    if key not in _RANGE_OF or isinstance(value, LinearSchedule) or (value is None and key != "n_timesteps"):
        return
    kind, low, high = _RANGE_OF[key]
    types = (int,) if "whole" in kind else (int, float)
    if type(value) not in types or not low <= value <= high or (low == -1 and value == 0):
        raise ValueError(f"{key} must be {kind}, got {value!r}")


def _value(key: str, value: Any) -> Any:
    if key == "policy_kwargs":
        return parse_literal(key, value)
    if key == "train_freq" and isinstance(value, list):
        return tuple(value)
    if key in _SCHEDULES and isinstance(value, str) and value.startswith("lin_"):
        start = _number(value.removeprefix("lin_"))
        if not start > 0.0:
            raise ValueError(f'{key} must be a number above 0, or "lin_" with the number to fall from, got {value!r}')
        return LinearSchedule(start=start, end=0.0, end_fraction=1.0)
    if key in ("n_timesteps", "n_envs") and isinstance(value, (str, float)) and _number(value).is_integer():
        return int(_number(value))
    return value


def _number(text: Any) -> float:
    """Return the finite number that a text is, or NaN."""
    try:
        return float(text) if math.isfinite(float(text)) else math.nan
    except ValueError:
        return math.nan


def parse_literal(key: str, value: Any) -> dict[str, Any]:
    """Return the dictionary that a text such as "dict(net_arch=[64, 64], activation_fn=nn.Tanh)" writes down.

    RL Zoo evaluates such texts. Here only literals, `dict(…)` and the names of :data:`ACTIVATIONS` mean anything.

    Raises:
        ValueError: not a dictionary, or one that holds anything else.
    """
    if isinstance(value, dict):
        return value
    reason = ""
    try:
        result = _literal(ast.parse(value.strip(), mode="eval").body) if isinstance(value, str) else None
        if isinstance(result, dict):
            return result
    except (SyntaxError, ValueError) as error:
        reason = f": {error}"
    allowed = f"a dictionary of numbers, texts, lists, dict(…) and {', '.join(ACTIVATIONS)}"
    raise ValueError(f"{key} must be {allowed}, got {value!r}{reason}")


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
