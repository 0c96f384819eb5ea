"""Learners of Stable-Baselines3: made, and saved with everything that they go on from.

A checkpoint holds the learner with its optimisers, the replay buffer, the environments in the middle of their episodes,
the normalisation and every random generator. It is made of pickles, which run code when they are loaded: load your own
only.
"""

from __future__ import annotations

import pickle
import random
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize, unwrap_vec_wrapper

from agents.folders import loading
from agents.hyperparameters import ALGORITHMS, Hyperparameters
from wtg_gym.policies.load import ARCHIVE_FILE
from wtg_gym.policies.sb3_archive import CUSTOM_OBJECTS

_NORMALIZE = "vec_normalize.pkl"
_REPLAY_BUFFER = "replay_buffer.pkl"
_STATE = "state.pkl"


def build_model(algo: str, hyperparameters: Hyperparameters, env: VecEnv, *, seed: int, device: str) -> BaseAlgorithm:
    """Return an untrained learner.

    Args:
        seed: seed of the weights, of the exploration and, plus the lane's number, of the lanes' scenarios.
        device: "cpu" or "cuda".

    Raises:
        ValueError: the algorithm refuses a hyperparameter, or the device does not exist.
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


def save_checkpoint(folder: Path, model: BaseAlgorithm) -> None:
    """Write everything that training goes on from into an empty folder, between two rollouts of the learner."""
    model.save(folder / ARCHIVE_FILE)
    if isinstance(model, OffPolicyAlgorithm):
        model.save_replay_buffer(folder / _REPLAY_BUFFER)
    env, normalize = model.get_env(), model.get_vec_normalize_env()
    assert env is not None
    if normalize is not None:
        normalize.save(str(folder / _NORMALIZE))
    monitor = unwrap_vec_wrapper(env, VecMonitor)
    assert isinstance(monitor, VecMonitor)
    state = {
        "environments": monitor.venv,
        "monitor": (monitor.episode_returns, monitor.episode_lengths, monitor.episode_count),
        # VecNormalize leaves it out of its own file.
        "discounted_returns": None if normalize is None else normalize.returns,
        "lstm_states": getattr(model, "_last_lstm_states", None),
        "python": random.getstate(),
        "numpy": np.random.get_state(),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all(),
        "action_space": model.action_space.np_random.bit_generator.state,
    }
    (folder / _STATE).write_bytes(pickle.dumps(state))


def load_checkpoint(folder: Path, algo: str, device: str) -> BaseAlgorithm:
    """Return the learner, in its environments and with every random generator as it was.

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
        random.setstate(state["python"])
        np.random.set_state(state["numpy"])
        torch.set_rng_state(state["torch"])
        torch.cuda.set_rng_state_all(state["cuda"])
        model.action_space.np_random.bit_generator.state = state["action_space"]
    return model
