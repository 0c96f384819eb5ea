"""Facts about offline learning that need no d3rlpy, and one that does."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch import nn

from agents import datasets, offline


def test_command_without_d3rlpy_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "d3rlpy", None)
    assert offline.main(["gfmwtg/v1/mixed-v0", "--output", str(tmp_path / "out")]) == 2
    assert "pip install d3rlpy==2.8.0" in capsys.readouterr().err


def test_command_compares_with_the_version_s_own_policy_and_checks_before_it_trains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "d3rlpy", ModuleType("d3rlpy"))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    datasets.make_dataset("v0", "reference", 1)
    trained = []

    def zero(dataset: Any, algorithm: str, n_steps: int, seed: int, output: Path) -> str:
        trained.append((dataset.spec.dataset_id, algorithm, n_steps, seed, output))
        return "coordinated-linear"

    monkeypatch.setattr(offline, "_exported", zero)
    output = tmp_path / "out"
    given = ["gfmwtg/v0/reference-v0", "--algos", "bc", "bc", "--output", str(output)]
    for option, value, text in (
        ("--steps", "0", "--steps = 0 gradient steps is outside the allowed range 1 … 1000000000 gradient steps"),
        ("--seed", "-1", "--seed = -1 is outside the allowed range 0 … "),
        ("--scenarios", "0", "--scenarios = 0 is outside the allowed range 1 … "),
    ):
        assert offline.main([*given, option, value]) == 2
        assert text in capsys.readouterr().err and not trained and not output.exists()
    assert offline.main([*given, "--scenarios", "4"]) == 0
    assert trained == [("gfmwtg/v0/reference-v0", "bc", 20_000, 0, output)]
    table = capsys.readouterr().out
    assert "PPO (k, τ)" in table and "coordinated-linear" in table


def test_actor_normalises_and_clips_as_the_data_was() -> None:
    class Sees(nn.Module):
        def forward(self, observation: torch.Tensor) -> Any:
            return SimpleNamespace(squashed_mu=observation)

    mean, std = np.array([1.0, -2.0], dtype=np.float32), np.array([2.0, 0.1], dtype=np.float32)
    seen = offline.Actor(Sees(), [0, 2], mean, std)(torch.tensor([[3.0, 7.0, -2.05], [1.0, 7.0, 5.0]]))
    assert torch.allclose(seen, torch.tensor([[1.0, -0.5], [0.0, 10.0]]), atol=1e-6)


def test_policies_do_not_see_their_last_actions() -> None:
    env = gym.make("wtg_gym:GFMWTG-14bus-v1")
    dataset = SimpleNamespace(recover_environment=lambda: env)
    assert offline.seen_columns(dataset) == [i for i in range(32) if i % 8 < 6]


def test_clone_of_the_zero_action_is_almost_the_zero_action(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("d3rlpy")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    actor = offline.train(datasets.make_dataset("v1", "reference", 2), "bc", 200, seed=0)
    observation = torch.as_tensor(np.random.default_rng(0).normal(size=(100, 32)).astype(np.float32))
    with torch.no_grad():
        assert actor(observation).abs().mean() < 0.05
