"""Facts about PPO under a bound: the penalty is in the rewards, and the multiplier follows the bound."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from agents import command, lagrangian
from agents.gains import stagger
from agents.vec_env import GainVecEnv
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.evaluation import Results, evaluate
from wtg_gym.policies.load import load_entries

N = 8


SHORT: dict[str, Any] = {"suite": "standard-v1", "strategy": "mppt", "duration_s": 20.0}


def test_violating_steps_cost_the_multiplier_also_an_episodes_last() -> None:
    plain, penalised = GainVecEnv(N, **SHORT), lagrangian.PenalisedVecEnv(N, **SHORT)
    for env in (plain, penalised):
        env.seed(0)
        env.reset()
    penalised.multiplier = 0.25
    actions = np.ones((N, 8), dtype=np.float32)
    violated = at_ends = 0.0
    for _ in range(250):
        _, gains, dones, infos = plain.step(actions)
        now = plain.vector_env.lanes.info_arrays()["cost"]
        costs = np.array([infos[lane]["cost"] if dones[lane] else now[lane] for lane in range(N)])
        # All that is left of an episode, where it failed.
        costs += [round((20.0 - infos[lane]["time_s"]) / 0.1) if dones[lane] else 0.0 for lane in range(N)]
        _, less, *_ = penalised.step(actions)
        assert less.tolist() == pytest.approx((gains - 0.25 * costs).tolist(), abs=1e-5)
        violated += costs.sum()
        at_ends += costs[dones].sum()
    assert violated > at_ends > 0
    plain.close()
    penalised.close()


def test_measure_counts_the_steps_of_the_policy_without_noise() -> None:
    class Brakes(nn.Module):
        def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, ...]:
            return (torch.ones(observation.shape[0], 4),)

    envs = GFMWTGVectorEnv(N, autoreset_mode="SameStep", suite=lagrangian._SUITE)
    measure = lagrangian.Measure(N, 3)
    envs.reset(seed=3)
    stagger(envs)
    violated = 0.0
    for _ in range(400):
        *_, terminated, truncated, infos = envs.step(np.ones((N, 4), dtype=np.float32))
        for lane in range(N):
            over = terminated[lane] or truncated[lane]
            violated += float(infos["final_info"]["cost"][lane] if over else infos["cost"][lane])
    assert violated > 0 and measure.share(Brakes(), 400) == violated / (400 * N)
    measure.close()
    envs.close()


@pytest.mark.parametrize("bound", [-0.01, 1.5])
def test_multiplier_follows_the_share_above_the_bound(bound: float, tmp_path: Path) -> None:
    # A share stays between the two limits, even with few lanes.
    (first, start), (_, multiplier) = lagrangian.train(bound, 2 * 150 * 128, 128, 0, tmp_path)
    assert start == 0.0
    assert multiplier == max(0.0, lagrangian._RATE * (first - lagrangian._AIM * bound))
    assert (multiplier > 0.0) == (bound < 0.0)


def test_share_is_that_of_the_steps_that_were_made() -> None:
    def episode(seed: int, constraint_s: float, survived_s: float) -> SimpleNamespace:
        metrics = {"constraint_time_s": constraint_s, "survived_s": survived_s}
        return SimpleNamespace(metrics=metrics, training_seed=None, seed=seed)

    results: Any = SimpleNamespace(episodes_of=lambda name: [episode(0, 1.0, 10.0), episode(1, 0.5, 5.0)])
    assert lagrangian.violated_percent(results, "mine").mean() == pytest.approx(10.0)


def test_command_writes_entries_and_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    played: list[int] = []

    def noting(*arguments: Any, seeds: list[int]) -> Results:
        played.extend(seeds)
        return evaluate(*arguments, seeds=seeds)

    monkeypatch.setattr(command, "evaluate", noting)
    page = tmp_path / "page.md"
    page.write_text("<!-- lagrangian:start -->\n<!-- lagrangian:end -->\n")
    sizes = ["--timesteps", "19200", "--n-envs", "128", "--scenarios", "4", "--page", str(page)]
    assert lagrangian.main([*sizes, "--output", str(tmp_path / "mine")]) == 0
    for folder, name in (("bound-0", "Lagrangian PPO"), ("free-0", "PPO without bound")):
        (entry,) = load_entries(tmp_path / "mine" / folder)
        assert (entry.name, entry.training_seed, entry.environment) == (name, 0, "GFMWTG-14bus-v0")
        assert page.read_text().count(f"| {name} |") == 1
    assert "| coordinated-piecewise | 100.0 (" in page.read_text()
    # Training draws from so many that it has seen none of the last ones.
    assert played == list(range(2**31 - 4, 2**31))
    # Nothing of another run is overwritten.
    assert lagrangian.main([*sizes, "--output", str(tmp_path / "mine")]) == 2
    assert "mine exists and is not an empty folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "text"),
    [
        ("--bound", "0", "--bound must be between 0 and 100 %"),
        ("--timesteps", "0", "--timesteps = 0 steps is outside the allowed range 1 … 1000000000000 steps"),
        ("--n-envs", "-1", "--n-envs = -1 episodes is outside the allowed range 1 … 100000 episodes"),
        ("--seeds", "2147483648", "--seeds = 2147483648 is outside the allowed range 0 … 2147483647"),
        ("--seeds", "-1", "--seeds = -1 is outside the allowed range 0 … 2147483647"),
        ("--scenarios", "0", "--scenarios = 0 is outside the allowed range 1 … 100000"),
        ("--page", "no-page.md", "no-page.md"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    option: str, value: str, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert lagrangian.main([option, value, "--output", str(tmp_path / "other")]) == 2
    assert text in capsys.readouterr().err and not (tmp_path / "other").exists()
