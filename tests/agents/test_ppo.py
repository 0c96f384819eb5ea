"""Facts about the PPO in one file: its formulas are right, it learns, and its policy is exported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from agents.export import export
from agents.folders import folders
from agents.ppo import Agent, Batch, Collector, Hyperparameters, RunningMoments, load, main, update
from agents.runs import Run
from wtg_gym.envs import GFMWTGVectorEnv

H = Hyperparameters(n_steps=8, hidden=8, log_std_init=-1.5)


def test_policy_moves_to_where_the_advantage_is_and_the_value_to_the_return() -> None:
    torch.manual_seed(0)
    agent = Agent(3, 2, H)
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-2)
    target = torch.tensor([0.3, -0.2])
    errors = []
    for _ in range(25):
        with torch.no_grad():
            seen = torch.randn(256, 3)
            actions = agent.sample(seen)
            batch = Batch(
                seen, actions, agent.log_prob(seen, actions), -(actions - target).square().sum(-1), seen.sum(-1)
            )
        errors.append(update(agent, optimizer, batch, H))
    assert errors[-1] < 0.05 * errors[0]
    assert agent.actor(torch.randn(256, 3)).mean(dim=0).tolist() == pytest.approx(target.tolist(), abs=0.05)


def test_advantages_are_discounted_sums_of_errors() -> None:
    env = GFMWTGVectorEnv(2, autoreset_mode="SameStep", duration_s=1.0, version="v0")
    collector = Collector(env, Agent(env.lanes.n_observation, env.lanes.n_action, H), H, seed=0)
    generator = torch.Generator().manual_seed(1)
    values, rewards = torch.randn(2, 6, 2, generator=generator)
    done = (torch.rand(6, 2, generator=generator) < 0.3).float()
    last = torch.randn(2, generator=generator)
    found = collector._advantages(values, rewards, done, last)
    for lane in range(2):
        for first in range(6):
            expected, weight = 0.0, 1.0
            for step in range(first, 6):
                following = last[lane] if step == 5 else values[step + 1, lane]
                goes_on = 1.0 - done[step, lane]
                expected += weight * (rewards[step, lane] + H.gamma * goes_on * following - values[step, lane])
                weight *= H.gamma * H.gae_lambda * goes_on
            assert float(found[first, lane]) == pytest.approx(float(expected), abs=1e-5)
    env.close()


def test_moments_are_those_of_all_rows() -> None:
    rows = torch.randn(50, 3, dtype=torch.float64) * 4.0 + 2.0
    moments = RunningMoments(3)
    for part in rows.split([1, 20, 29]):
        moments.update(part)
    assert moments.mean.numpy() == pytest.approx(rows.mean(dim=0).numpy(), abs=1e-4)
    assert moments.var.numpy() == pytest.approx(rows.var(dim=0, correction=0).numpy(), rel=1e-4)


def test_run_is_reproducible_and_exported(tmp_path: Path) -> None:
    agents = []
    for name in ("one", "two"):
        arguments = ["--suite", "standard", "--timesteps", "4096", "--n-envs", "16", "--validation-episodes", "2"]
        assert main([*arguments, "--output", str(tmp_path / name)]) == 0
        agents.append(load(folders(tmp_path / name / "best")[-1]).state_dict())
    assert all(torch.equal(agents[0][key], agents[1][key]) for key in agents[0])
    run = Run.read(tmp_path / "one")
    assert run.finished and [row["timesteps"] for row in run.curve] == [0, 2400, 4800]
    assert export(tmp_path / "one", tmp_path / "entry") <= 1e-6
    assert np.isfinite([row["score"] for row in run.curve]).all()
