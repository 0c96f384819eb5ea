"""Facts about PPO under a bound: the penalty is in the rewards, and the multiplier follows the bound."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents import lagrangian
from agents.ppo import Collector
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.policies.load import load_entries

N = 8


def test_every_violating_step_is_counted_also_an_episodes_last() -> None:
    plain = GFMWTGVectorEnv(N, autoreset_mode="SameStep", suite="standard-v1", duration_s=5.0)
    envs = lagrangian.CountingEnvs(N, autoreset_mode="SameStep", suite="standard-v1", duration_s=5.0)
    plain.reset(seed=0)
    envs.reset(seed=0)
    actions = np.ones((N, plain.lanes.n_action), dtype=np.float32)
    violated = n_ends = 0.0
    for _ in range(120):
        observations, rewards, terminated, truncated, infos = plain.step(actions)
        others, same, *_ = envs.step(actions)
        over = terminated | truncated
        costs = np.where(over, infos["final_info"]["cost"] if over.any() else 0.0, infos["cost"])
        assert np.array_equal(observations, others) and np.array_equal(rewards, same)
        assert np.array_equal(envs.costs, costs)
        violated += costs.sum()
        n_ends += over.sum()
    assert violated > 0 and n_ends >= 2 * N
    assert envs.share_since_last() == violated / (120 * N) and envs.share_since_last() == 0.0
    plain.close()
    envs.close()


def test_violating_steps_cost_the_multiplier(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Collector, "_scaled", lambda self, rewards, done: rewards)
    envs = object.__new__(lagrangian.CountingEnvs)
    envs.costs = np.array([0.0, 1.0, 1.0])
    collector: Any = object.__new__(lagrangian.LagrangianCollector)
    collector._envs, collector.multiplier = envs, 0.25
    assert collector._scaled(np.array([0.5, 0.5, -1.0]), None).tolist() == [0.5, 0.25, -1.25]


def test_multiplier_follows_the_share_above_the_bound() -> None:
    # No share is below it, so that the multiplier must rise whatever the few lanes do.
    bound = -0.01
    _, course = lagrangian.train(bound, 2 * 150 * N, N, seed=0)
    (first, start), (_, multiplier) = course
    assert (start, multiplier) == (lagrangian._START, lagrangian._START + lagrangian._RATE * (first - bound))
    assert multiplier > start


def test_share_is_that_of_the_steps_that_were_made() -> None:
    def episode(constraint_s: float, survived_s: float) -> SimpleNamespace:
        return SimpleNamespace(metrics={"constraint_time_s": constraint_s, "survived_s": survived_s})

    results: Any = SimpleNamespace(episodes_of=lambda name: [episode(1.0, 10.0), episode(0.5, 5.0)])
    assert lagrangian.violated_percent(results, "mine") == 10.0


def test_command_writes_an_entry_and_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- lagrangian:start -->\n<!-- lagrangian:end -->\n")
    sizes = ["--timesteps", "1200", "--n-envs", "8", "--scenarios", "4", "--page", str(page)]
    assert lagrangian.main([*sizes, "--output", str(tmp_path / "mine")]) == 0
    (entry,) = load_entries(tmp_path / "mine")
    assert (entry.name, entry.environment, entry.law.name) == (
        "Lagrangian PPO",
        "GFMWTG-14bus-v1",
        lagrangian._STRATEGY,
    )
    assert page.read_text().count("| Lagrangian PPO |") == 1 and "| coordinated-tuned | 100.0 |" in page.read_text()
    assert lagrangian.main(["--bound", "0", "--output", str(tmp_path / "other")]) == 2
    assert "--bound must be between 0 and 100 %" in capsys.readouterr().err
