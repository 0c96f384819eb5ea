"""The algorithms of Stable-Baselines3, and their hyperparameters in the yml format of RL Zoo."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import LinearSchedule

from wtg_gym.files import interpreting, read_text, require_plain

#: PPO of which one network acts for every WTG group.
IPPO = "ippo"
#: The algorithms by name; RL Zoo calls recurrent_ppo ppo_lstm.
TRAINED: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "recurrent_ppo": RecurrentPPO, IPPO: PPO}
CONFIG_FOLDER = Path(__file__).parent / "configs"
#: A text that begins so is a schedule that falls linearly to zero.
_LINEAR = "lin_"
_OF_THE_RUN = ("n_timesteps", "n_envs", "normalize")


def read_config(path: Path, env_id: str) -> dict[str, Any]:
    """Return the section of an environment in a yml file as it is written there.

    Raises:
        ValueError: the file cannot be read, is not YAML, or has no section for the environment.
    """
    text = read_text(path, "hyperparameter file")
    with interpreting(path, "hyperparameter file"):
        try:
            data = yaml.load(text, _Loader)
        except yaml.YAMLError as error:
            raise ValueError(f"it is not yml: {error}") from error
        require_plain(data, "it", len(text), infinite=False)
        if not isinstance(data, dict) or not isinstance(data.get(env_id), dict):
            raise ValueError(f"it must have a section {env_id!r} with keys and values")
    return dict(data[env_id])


class _Loader(yaml.SafeLoader):
    """Takes a key that is given twice for a mistake; two merges could double a section's length again and again."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Put merged sections into a section, each key of which must be there once before."""
        keys = [key.value for key, _ in node.value]
        merged = [value for key, value in node.value if key.tag == "tag:yaml.org,2002:merge"]
        if len(set(map(str, keys))) < len(keys) or any(isinstance(value, yaml.SequenceNode) for value in merged):
            raise ValueError(f"a section must have each key once, and merge one other at most, got {keys}")
        super().flatten_mapping(node)


def algorithm_arguments(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the algorithm, `policy` among them, that a section of a file means.

    Dictionaries are written as such: RL Zoo evaluates texts in the place of them, which would run any code.
    """
    # The algorithms write into policy_kwargs.
    arguments = copy.deepcopy({key: value for key, value in raw.items() if key not in _OF_THE_RUN})
    for key, value in arguments.items():
        if isinstance(value, str) and value.startswith(_LINEAR):
            arguments[key] = LinearSchedule(float(value.removeprefix(_LINEAR)), 0.0, 1.0)
    return arguments


def normalization_arguments(raw: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the arguments of VecNormalize that a section of a file means; None for no normalisation."""
    given = raw.get("normalize", False)
    if given is False:
        return None
    # Rewards are scaled by the spread of the returns that the learner sees.
    return {**({} if given is True else given), **({"gamma": raw["gamma"]} if "gamma" in raw else {})}
