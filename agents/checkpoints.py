"""Saving a training run so that it goes on from there as if nothing had happened.

A checkpoint holds the learner with its optimisers, the replay buffer, the environments in the middle of their episodes,
the normalisation and every random generator. It is made of pickles, which run code when they are read: load your own
only. What is passed on to others is the export.
"""

from __future__ import annotations

import pickle
import random
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize, unwrap_vec_wrapper

from agents.hyperparameters import ALGORITHMS
from agents.runs import loading
from wtg_gym.policies.load import ARCHIVE_FILE
from wtg_gym.policies.sb3_archive import CUSTOM_OBJECTS

_NORMALIZE = "vec_normalize.pkl"
_REPLAY_BUFFER = "replay_buffer.pkl"
_STATE = "state.pkl"


def save_policy(folder: Path, model: BaseAlgorithm) -> None:
    """Write the learner and its normalisation, as :func:`wtg_gym.policies.sb3_archive.load_archive` takes them."""
    model.save(folder / ARCHIVE_FILE)
    normalize = model.get_vec_normalize_env()
    if normalize is not None:
        normalize.save(str(folder / _NORMALIZE))


def save_checkpoint(folder: Path, model: BaseAlgorithm, extra: Any) -> None:
    """Write everything that training goes on from.

    Args:
        folder: an empty folder.
        model: the learner, between two rollouts.
        extra: what the caller wants back.
    """
    save_policy(folder, model)
    if isinstance(model, OffPolicyAlgorithm):
        model.save_replay_buffer(folder / _REPLAY_BUFFER)
    env, normalize = model.get_env(), model.get_vec_normalize_env()
    assert env is not None
    monitor = unwrap_vec_wrapper(env, VecMonitor)
    assert isinstance(monitor, VecMonitor)
    state = {
        "environments": monitor.venv,
        "monitor": (monitor.episode_returns, monitor.episode_lengths, monitor.episode_count),
        # VecNormalize leaves it out of its own file.
        "discounted_returns": None if normalize is None else normalize.returns,
        "lstm_states": getattr(model, "_last_lstm_states", None),
        "random": _random_states(model),
        "extra": extra,
    }
    (folder / _STATE).write_bytes(pickle.dumps(state))


def load_checkpoint(folder: Path, algo: str, device: str) -> tuple[BaseAlgorithm, Any]:
    """Return the learner, in its environments and with every generator as it was, and the caller's extra.

    Raises:
        ValueError: a file is missing or damaged; the message names it.
    """
    with loading(folder / _STATE):
        state = pickle.loads((folder / _STATE).read_bytes())
        monitor = VecMonitor(state["environments"])
        monitor.episode_returns, monitor.episode_lengths, monitor.episode_count = state["monitor"]
    env: VecEnv = monitor
    if state["discounted_returns"] is not None:
        with loading(folder / _NORMALIZE):
            normalize = VecNormalize.load(str(folder / _NORMALIZE), monitor)
            normalize.returns = state["discounted_returns"]
            env = normalize
    with loading(folder / ARCHIVE_FILE):
        model = ALGORITHMS[algo].load(
            folder / ARCHIVE_FILE, env=env, device=device, custom_objects=CUSTOM_OBJECTS, force_reset=False
        )
    if isinstance(model, OffPolicyAlgorithm):
        with loading(folder / _REPLAY_BUFFER):
            model.load_replay_buffer(folder / _REPLAY_BUFFER)
    with loading(folder / _STATE):
        if state["lstm_states"] is not None:
            model._last_lstm_states = state["lstm_states"]  # type: ignore[attr-defined]
        # Last, because making the learner seeds the generators anew.
        _set_random_states(model, state["random"])
        return model, state["extra"]


def _random_states(model: BaseAlgorithm) -> dict[str, Any]:
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all(),
        "action_space": model.action_space.np_random.bit_generator.state,
    }


def _set_random_states(model: BaseAlgorithm, states: dict[str, Any]) -> None:
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])
    torch.set_rng_state(states["torch"])
    torch.cuda.set_rng_state_all(states["cuda"])
    model.action_space.np_random.bit_generator.state = states["action_space"]


__all__ = ["load_checkpoint", "save_checkpoint", "save_policy"]
