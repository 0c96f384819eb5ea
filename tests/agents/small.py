"""Training runs small enough for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from agents.folders import folders
from agents.runs import Run
from agents.train import main, train
from tests.interruption import interrupted

ENV_ID = "GFMWTG-14bus-v0"
V0 = ("--suite", "standard")

SHARED: dict[str, Any] = {"policy": "MlpPolicy", "n_timesteps": 768, "n_envs": 16, "normalize": True}
ON_POLICY = {**SHARED, "n_steps": 8, "batch_size": 64, "n_epochs": 1, "policy_kwargs": "dict(net_arch=[8])"}
OFF_POLICY = {
    **SHARED,
    "learning_starts": 64,
    "buffer_size": 2000,
    "batch_size": 32,
    "train_freq": 1,
    "gradient_steps": 2,
    "n_steps": 3,
    "policy_kwargs": "dict(net_arch=[8])",
}
CONFIGS: dict[str, dict[str, Any]] = {
    "ppo": {**ON_POLICY, "use_sde": True, "sde_sample_freq": 3},
    "recurrent_ppo": {
        **ON_POLICY,
        "policy": "MlpLstmPolicy",
        "policy_kwargs": "dict(net_arch=[8], lstm_hidden_size=4, n_lstm_layers=2)",
    },
    "sac": {**OFF_POLICY, "use_sde": True, "train_freq": 4, "gradient_steps": 8},
    "td3": {**OFF_POLICY, "noise_type": "normal", "noise_std": 0.1},
    "tqc": OFF_POLICY,
}


def config_file(folder: Path, algo: str, **changes: Any) -> str:
    """Write the configuration of a small run and return its path."""
    path = folder / f"{algo}.yml"
    path.write_text(yaml.safe_dump({ENV_ID: {**CONFIGS[algo], **changes}}))
    return str(path)


def options(folder: Path, algo: str) -> list[str]:
    """Return the options of a small run that validates after every 256 of its 768 steps."""
    given = [*V0, "--algo", algo, "--config", config_file(folder, algo)]
    return [*given, "--interval", "256", "--validation-episodes", "2"]


def trained(folder: Path, algo: str, name: str) -> Path:
    """Return the folder of a small run, finished."""
    assert main([*options(folder, algo), "--output", str(folder / name)]) == 0
    return folder / name


def stopped_after(timesteps: int, like: Path, folder: Path) -> Path:
    """Begin a run like another one, and interrupt it when its checkpoint of a step has been written."""
    stop = interrupted(lambda done, score: None, when=lambda done, score: done == timesteps)
    with pytest.raises(KeyboardInterrupt):
        train(Run.new(Run.read(like).settings), folder, stop)
    assert [int(path.name) for path in folders(folder / "checkpoints")] == [timesteps]
    return folder
