"""Policies as archives of Stable-Baselines3, which run code when they are loaded: for one's own files only.

An archive (model.zip) and the file of a VecNormalize are made of pickles. Loading one runs any code that its maker put
in it, with the rights of the user; no check can tell. Needs the extra `train`.
"""

from __future__ import annotations

import io
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from wtg_gym.extras import install_advice
from wtg_gym.files import sha256
from wtg_gym.policies.load import ARCHIVE_FILE

try:
    import torch
    from sb3_contrib import TQC, RecurrentPPO
    from stable_baselines3 import PPO, SAC, TD3
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import BasePolicy
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise ImportError(
        f"an archive of Stable-Baselines3 needs that and sb3-contrib; {install_advice('train')} ({error})"
    ) from error

#: The algorithms whose archives can be loaded, by the name of their class.
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {each.__name__: each for each in (PPO, SAC, TD3, TQC, RecurrentPPO)}
#: Without it, a class that the learner chose for its n_steps counts as the user's choice, with a warning.
CUSTOM_OBJECTS = {"replay_buffer_class": None}


@dataclass(frozen=True)
class NormalizedPolicy:
    """A learner's policy together with the normalisation of its observations.

    Args:
        policy: the policy; without the learner's buffers, so that it is quickly sent to another process.
        vec_normalize: the normalisation it was trained with; None for none.
    """

    policy: BasePolicy
    vec_normalize: VecNormalize | None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), next recurrent state) for raw observations (n_lanes, n_observation).

        Raises:
            ValueError: the observations are of another shape.
        """
        expected, got = self.policy.observation_space.shape, np.shape(observation)
        if got[1:] != expected:
            raise ValueError(
                f"the policy takes observations of shape (lanes, {', '.join(map(str, expected or ()))}), got {got}: "
                "was it trained with another action_mode, observation_mode or groups?"
            )
        if self.vec_normalize is not None:
            observation = self.vec_normalize.normalize_obs(observation)
        return self.policy.predict(observation, state, episode_start, deterministic)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # In another process as where it was loaded: more threads would round otherwise.
        torch.set_num_threads(1)
        self.__dict__.update(state)


def load_archive(folder: Path, algorithm: str) -> tuple[NormalizedPolicy, str]:
    """Load a folder's model.zip and, where there is one, its vecnormalize.pkl; runs any code in them.

    The one .pkl with "normalize" in its name is the normalisation, so that none is left out for its name. Torch is left
    on one thread, so that the result does not depend on the machine's load.

    Args:
        folder: with the files.
        algorithm: one of :data:`ALGORITHMS`.

    Returns:
        the policy, on the CPU, and a sha256 over all that was loaded.

    Raises:
        ValueError: the algorithm is unknown; a file is missing, damaged or of something else, or there are several
            normalisations; the message names the file.
    """
    if not isinstance(algorithm, str) or algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
    paths = [folder / ARCHIVE_FILE, *sorted(path for path in folder.glob("*.pkl") if "normalize" in path.name.lower())]
    if len(paths) > 2:
        names = ", ".join(path.name for path in paths[1:])
        raise ValueError(f"{folder} must have one file with a normalisation at most, vecnormalize.pkl; it has {names}")
    try:
        # The bytes that are hashed are those that are loaded.
        contents = [path.read_bytes() for path in paths]
    except OSError as error:
        raise ValueError(f"cannot read {error.filename}: {error.strerror}") from error
    torch.set_num_threads(1)
    try:
        model = ALGORITHMS[algorithm].load(io.BytesIO(contents[0]), device="cpu", custom_objects=CUSTOM_OBJECTS)
    # A file of something else can raise anything.
    except Exception as error:
        raise ValueError(
            f"{paths[0]} is no archive of {algorithm} that can be loaded: {type(error).__name__}: {error}"
        ) from error
    observation, action = getattr(model, "observation_space", None), getattr(model, "action_space", None)
    fits = all(isinstance(space, Box) and len(space.shape) == 1 for space in (observation, action))
    if not fits or not (np.all(action.low == -1.0) and np.all(action.high == 1.0)):  # type: ignore[union-attr]
        raise ValueError(
            f"the policy in {paths[0]} must take a list of observations and give a list of actions, -1 … 1; "
            f"its spaces are {observation!s:.80} and {action!s:.80}"
        )
    normalize = _normalization(contents[1], paths[1], model) if len(paths) == 2 else None
    parts = [algorithm, *(sha256(content) for content in contents)]
    return NormalizedPolicy(model.policy, normalize), sha256(" ".join(parts).encode())


def _normalization(content: bytes, path: Path, model: BaseAlgorithm) -> VecNormalize:
    try:
        found = pickle.loads(content)
    except Exception as error:
        raise ValueError(f"{path} is no VecNormalize that can be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(found, VecNormalize) or found.observation_space.shape != model.observation_space.shape:
        raise ValueError(
            f"{path} must be the VecNormalize that the policy was trained with, for observations of shape "
            f"{model.observation_space.shape}; it holds {type(found).__name__}"
            + (f" for {found.observation_space.shape}" if isinstance(found, VecNormalize) else "")
        )
    found.training = False
    # Without an environment it has none of these, but pickles only with them.
    found.class_attributes, found.returns = {}, np.zeros(0)
    return found
