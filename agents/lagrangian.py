"""`python -m agents.lagrangian`: PPO under a bound on the violation of constraints, by a Lagrange multiplier.

The bound is on the share of steps with `info["cost"]` = 1. Every such step costs the multiplier, which rises while the
share in training is above the bound and falls while it is below: reward-constrained policy optimisation (Tessler,
Mankowitz and Mannor, "Reward Constrained Policy Optimization", 2019) on top of agents.ppo.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from agents.command import Parser, Progress, check_page, print_table, run_command, update_page
from agents.ppo import Agent, Collector, Hyperparameters, update
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.evaluation import Results, evaluate
from wtg_gym.files import markdown_table
from wtg_gym.policies.torch_export import export_onnx

_SUITE, _ENVIRONMENT = "standard-v1", "GFMWTG-14bus-v1"
#: The published law violates less than the tuned one, and learning from it is a trade between violations and score.
_STRATEGY, _TUNED = "coordinated-piecewise", "coordinated-tuned"
#: The multiplier at the start [% of an episode's cost for a violating step], and its rise in a rollout, per unit of the
#: share of violating steps above the bound.
_START, _RATE = 0.2, 10.0
_NAME = "Lagrangian PPO"

_DESCRIPTION = f"""\
Trains PPO on {_SUITE} under a bound on the share of steps that violate a constraint, exports it as an entry, and
compares score and share on validation scenarios with the zero action, the tuned law, and the trained PPO."""
_EXAMPLES = """\
examples:
  python -m agents.lagrangian --bound 3.5 --output runs/lagrangian
  wtg-gym evaluate --suite standard-v1 --entries runs/lagrangian PPO"""


class CountingEnvs(GFMWTGVectorEnv):
    """A batch that counts the steps that violate a constraint."""

    #: Of the last step, (num_envs,): 1 where a constraint was violated.
    costs: npt.NDArray[np.float64]
    #: Steps so far, and those that violated a constraint.
    n_steps_made, n_violated = 0, 0

    def step(self, actions: Any) -> Any:
        """Hold the actions for one control interval in every lane."""
        observations, rewards, terminated, truncated, infos = super().step(actions)
        self.costs, over = np.asarray(infos["cost"], dtype=np.float64).copy(), terminated | truncated
        if over.any():
            # The other infos are already those of the next episode.
            self.costs[over] = infos["final_info"]["cost"][over]
        self.n_steps_made += self.costs.size
        self.n_violated += int(self.costs.sum())
        return observations, rewards, terminated, truncated, infos

    def share_since_last(self) -> float:
        """Return the share of violating steps since the last call."""
        share = self.n_violated / max(1, self.n_steps_made)
        self.n_steps_made = self.n_violated = 0
        return share


class LagrangianCollector(Collector):
    """A collector whose gains are less by a multiplier in every step that violates a constraint."""

    multiplier = _START

    def _scaled(self, rewards: Any, done: Any) -> tuple[Tensor, Tensor]:
        assert isinstance(self._envs, CountingEnvs)
        return super()._scaled(rewards - self.multiplier * self._envs.costs, done)


class Mean(nn.Module):
    """The deterministic action of an agent."""

    def __init__(self, agent: Agent) -> None:
        super().__init__()
        self.agent = agent

    def forward(self, observation: Tensor) -> Tensor:
        """Return the actions (batch, n_action)."""
        actions: Tensor = self.agent.actor(self.agent.normalized(observation))
        return actions


def train(bound: float, timesteps: int, n_envs: int, seed: int) -> tuple[Agent, list[tuple[float, float]]]:
    """Train under a bound.

    Args:
        bound: on the share of steps that violate a constraint.
        timesteps, n_envs, seed: environment steps, episodes side by side, and the seed of everything random.

    Returns:
        the agent, and the share and the multiplier of every rollout.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    h = Hyperparameters(log_std_init=-2.5)
    envs = CountingEnvs(n_envs, autoreset_mode="SameStep", suite=_SUITE, strategy=_STRATEGY)
    agent = Agent(envs.lanes.n_observation, envs.lanes.n_action, h)
    optimizer = torch.optim.Adam(agent.parameters(), lr=h.learning_rate, eps=1e-5)
    collector = LagrangianCollector(envs, agent, h, seed)
    # What the start of the lanes, without an agent, violated.
    envs.share_since_last()
    n_rollouts = -(-timesteps // (h.n_steps * n_envs))
    course = []
    with Progress("rollouts") as progress:
        for index in range(n_rollouts):
            optimizer.param_groups[0]["lr"] = h.learning_rate * (1.0 - index / n_rollouts)
            batch, _ = collector.rollout()
            share = envs.share_since_last()
            course.append((share, collector.multiplier))
            collector.multiplier = max(0.0, collector.multiplier + _RATE * (share - bound))
            update(agent, optimizer, batch, h)
            progress.update(
                f"violating {100 * share:.2f} %, multiplier {collector.multiplier:.2f}", index + 1, n_rollouts
            )
    collector.close()
    return agent, course


def violated_percent(results: Results, name: str) -> float:
    """Return the share of an entry's steps in which a constraint was violated, over all scenarios [%]."""
    episodes = results.episodes_of(name)
    violated, survived = (
        sum(each.metrics[metric] or 0.0 for each in episodes) for metric in ("constraint_time_s", "survived_s")
    )
    return 100.0 * violated / survived


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.lagrangian", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument(
        "--bound", type=float, default=3.5, metavar="X", help="on the share of steps [%%] (default: 3.5)"
    )
    parser.add_argument("--timesteps", type=int, default=3_000_000, metavar="N", help="in all (default: 3000000)")
    parser.add_argument("--n-envs", type=int, default=512, metavar="N", help="episodes side by side (default: 512)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of everything random (default: 0)")
    parser.add_argument("--scenarios", type=int, default=200, metavar="N", help="to compare on (default: 200)")
    parser.add_argument("--page", metavar="FILE", help="put the table between this file's markers")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder of the entry")

    def work() -> None:
        given = parser.parse_args(argv)
        page = check_page("--page", given.page, "lagrangian")
        if not 0.0 < given.bound < 100.0:
            raise ValueError(f"--bound must be between 0 and 100 %, got {given.bound:g}")
        agent, course = train(given.bound / 100.0, given.timesteps, given.n_envs, given.seed)
        folder = export_onnx(
            Mean(agent),
            Path(given.output),
            name=_NAME,
            environment=_ENVIRONMENT,
            strategy=_STRATEGY,
            training_seed=given.seed,
            description=f"PPO under a bound of {given.bound:g} % of violating steps.",
            trained_on=f"{_SUITE}, split train, {given.timesteps} steps",
        )
        seeds = range(10_000, 10_000 + given.scenarios)
        results = evaluate([folder, _STRATEGY, _TUNED, "PPO"], _SUITE, "validation", seeds=seeds)
        rows = []
        for name in (_STRATEGY, _TUNED, "PPO", _NAME):
            failed = 100.0 * sum(each.failed for each in results.episodes_of(name)) / len(results.episodes_of(name))
            score = results.scores[name].value
            rows.append([name, f"{score:.1f}", f"{violated_percent(results, name):.2f}", f"{failed:.1f}"])
        header = ["entry", "score", f"violating [%], bound {given.bound:g}", "failures [%]"]
        print_table(header, rows)
        if page is not None:
            steps = f"{given.timesteps:,} steps, seed {given.seed}; {given.scenarios} validation scenarios:"
            update_page(page, {"lagrangian": f"{steps}\n\n{markdown_table(header, rows, right=(1, 2, 3))}"})
        print_table(["multiplier at the end", "violating in the last rollout [%]"], [_last(course)], left=())

    return run_command(work)


def _last(course: Sequence[tuple[float, float]]) -> list[str]:
    share, multiplier = course[-1]
    return [f"{multiplier:.2f}", f"{100 * share:.2f}"]


if __name__ == "__main__":
    sys.exit(main())
