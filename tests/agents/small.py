"""Training runs small enough for tests."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from stable_baselines3.common.base_class import BaseAlgorithm

from agents.run import Run, RunSettings, folders
from agents.train import main, train
from tests.changes import write
from tests.interruption import interrupted
from wtg_gym.envs import GFMWTGVectorEnv

ENV_ID = "GFMWTG-14bus-v0"
V0 = ("--suite", "standard")

_ALL = {"policy": "MlpPolicy", "n_timesteps": 768, "n_envs": 16, "normalize": True}
_PPO = {**_ALL, "n_steps": 8, "batch_size": 64, "n_epochs": 1, "use_sde": True, "sde_sample_freq": 3}
_SAC = {**_ALL, "learning_starts": 64, "buffer_size": 2000, "batch_size": 32, "n_steps": 3, "use_sde": True}
_LSTM = {"policy_kwargs": {"net_arch": [8], "lstm_hidden_size": 4, "n_lstm_layers": 2}, "policy": "MlpLstmPolicy"}
_SMALL = {"policy_kwargs": {"net_arch": [8]}}
CONFIGS = {
    "ppo": {**_PPO, **_SMALL},
    # Its small network learns too little with another rate to differ from the law itself, which the gate refuses.
    "recurrent_ppo": {**_PPO, **_LSTM, "learning_rate": 0.02, "use_sde": False},
    "sac": {**_SAC, **_SMALL, "train_freq": 4, "gradient_steps": 8},
}


def config_file(folder: Path, algo: str, **changes) -> str:
    return str(write(folder / f"{algo}.yml", yaml.safe_dump({ENV_ID: {**CONFIGS[algo], **changes}})))


def options(folder: Path, algo: str) -> list[str]:
    """Return the options of a small run that validates after every 256 of its 768 steps."""
    given = [*V0, "--algo", algo, "--config", config_file(folder, algo)]
    return [*given, "--interval", "256", "--validation-episodes", "2"]


def trained(folder: Path, algo: str) -> Path:
    """Return the folder of a finished small run, whose last policy counts as its best: the first are the law itself."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "best", property(lambda run: run.curve[-1]))
        assert main([*options(folder, algo), "--output", str(folder / "run")]) == 0
    return folder / "run"


def stopped_after(timesteps: int, like: Path, folder: Path) -> Path:
    """Begin a run like another one, and interrupt it once it has a checkpoint of a step."""
    there = folder / "checkpoints" / f"{timesteps:012d}"
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Run, "take_stock", interrupted(Run.take_stock, when=lambda *_, **__: there.exists()))
        train(Run.new(folder, Run.read(like).settings))
    assert [int(path.name) for path in folders(folder / "checkpoints")] == [timesteps]
    return folder


class Normalized:
    def __init__(self, model: BaseAlgorithm) -> None:
        self._model, self._normalize = model, model.get_vec_normalize_env()

    def predict(self, observation, *more, deterministic: bool):
        return self._model.predict(self._normalize.normalize_obs(observation), *more, deterministic=deterministic)


def largest_difference(policy, other, settings: RunSettings) -> float:
    """Return the largest difference between two policies' actions over 1000 observations of random episodes.

    The first one acts, with some noise so that the episodes differ; episodes start anew within.
    """
    envs = GFMWTGVectorEnv(4, autoreset_mode="SameStep", duration_s=20.0, **settings.env_arguments)
    rng, largest, one, two, start = np.random.default_rng(0), 0.0, None, None, np.ones(4, dtype=np.bool_)
    observations, _ = envs.reset(seed=0)
    for _ in range(250):
        actions, one = policy.predict(observations, one, start, deterministic=True)
        others, two = other.predict(observations, two, start, deterministic=True)
        largest = max(largest, float(np.abs(actions - others).max()))
        noise = rng.normal(0.0, 0.3, actions.shape)
        observations, _, terminated, truncated, _ = envs.step((actions + noise).astype(np.float32))
        start = terminated | truncated
    envs.close()
    return largest


def actions_of(policy, n_observation: int) -> np.ndarray:
    """Return actions in random observations, 30 steps of 8 groups; two episodes begin within."""
    rng, state, actions = np.random.default_rng(0), None, []
    for step in range(30):
        start = np.full(8, step in (0, 11, 20))
        action, state = policy.predict(rng.normal(size=(8, n_observation)).astype(np.float32), state, start)
        actions.append(action)
    return np.array(actions)
