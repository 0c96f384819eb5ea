"""`python -m agents.dagger`: trains a policy of sensors to do what the planner of :mod:`agents.planner` would do.

The planner knows the exact state, the policy what a group measures. In the first round the planner drives, disturbed by
noise; from then on the policy drives, and every few seconds the planner plans from where that has led (DAgger: S. Ross,
G. Gordon, D. Bagnell, AISTATS 2011). Until it plans again the plan is what the policy should do, even if an event comes
meanwhile. After each round the policy is fitted to the plans of all rounds.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from agents import run as runs
from agents.gradient import GradientPolicy, descend
from agents.planner import Planner, PlannerOptions, drive
from agents.run import RunSettings, Whole, Widths
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import design

#: Correlation time of the noise of the first round [s].
_NOISE_S = 10.0
_MAX_GRAD_NORM = 1.0


@runs.options
@dataclass(frozen=True)
class Hyperparameters(PlannerOptions):
    """Those of the policy and its fits, and how the planner plans."""

    lstm: Whole = design(64, "-", "width of the policy's LSTM", 1, 10_000)
    hidden: Widths = design((64,), "-", "widths of the layers behind it, or none", 1, 10_000)
    updates: Whole = design(150, "-", "of a fit", 1, 1_000_000)
    batch: Whole = design(40, "-", "episodes of an update", 1, 100_000)
    learning_rate: float = design(3e-3, "-", "of Adam at the start of a fit", 0.0, 10.0)
    last_rate: float = design(0.17, "-", "of the learning rate, at the end of a fit", 0.0, 1.0)
    noise: float = design(0.15, "-", "standard deviation of the noise on the actions of the first round", 0.0, 1.0)


class Plans:
    """Observations of the policy and actions of the planner (n_steps, n_episodes, n_wtg, …), of every round."""

    def __init__(self) -> None:
        self.observations: list[Tensor] = []
        self.actions: list[Tensor] = []
        self.counts: list[Tensor] = []  # 1 while a group is connected in a running episode (n_steps, n_episodes, n_wtg)

    def add(self, observations: Sequence[Floats], actions: Sequence[Floats], counts: Sequence[Floats]) -> None:
        """Add the episodes of a round, from lists of their steps."""
        for kept, steps in ((self.observations, observations), (self.actions, actions), (self.counts, counts)):
            kept.append(torch.from_numpy(np.stack(steps).astype(np.float32)))

    def state_dict(self) -> dict[str, list[Tensor]]:
        """Return all plans."""
        return vars(self)

    def load_state_dict(self, state: Mapping[str, list[Tensor]]) -> None:
        """Take the plans that :meth:`state_dict` returned."""
        vars(self).update(state)

    def batch(self, size: int, rng: np.random.Generator) -> tuple[Tensor, ...]:
        """Return some episodes of all rounds, drawn with replacement, as many of one round as of another."""
        chosen = [rng.integers(each.shape[1], size=-(-size // len(self.counts))) for each in self.counts]
        return tuple(
            torch.cat([each[:, at] for each, at in zip(column, chosen, strict=True)], dim=1)
            for column in (self.observations, self.actions, self.counts)
        )


class DaggerLearner(runs.RoundLearner):
    """A policy and the plans that it is fitted to."""

    def __init__(self, settings: RunSettings, h: Hyperparameters) -> None:
        runs.require_local(settings)
        environment = EnvSettings(**settings.env_arguments, reward="cost")
        self._h, self.batch = h, EnvBatch(environment, settings.n_envs)
        self._planner = Planner(environment, settings.n_envs, h)
        self.timesteps = self._planner.n_steps * settings.n_envs
        # Last actions come after what is measured. A policy that sees them learns to repeat them.
        n_observation, n_action = environment.task.n_local, self.batch.n_action // self.batch.n_wtg
        self.policy = self.network = GradientPolicy(n_observation, n_action, h.hidden, h.lstm)
        self.policy.per_group = True
        self.plans = Plans()
        self.parts = {"policy": self.policy, "plans": self.plans}

    def learn(self, scenarios: Sequence[Scenario], rng: np.random.Generator, index: int, n_rounds: int) -> float:
        step_s = self.batch.settings.step_s
        driver = driven_by(self.policy, self.batch) if index else disturbed(self._h.noise, step_s, rng)
        observe(self._planner, self.batch, scenarios, self.plans, driver)
        return self.fit(self._h, rng)

    def fit(self, h: Hyperparameters, rng: np.random.Generator) -> float:
        """Fit the policy to all plans, and return the mean square of what is left in the last update."""
        policy, left = self.policy, math.nan
        optimizer = torch.optim.Adam(policy.parameters(), lr=h.learning_rate)
        for update in range(h.updates):
            optimizer.param_groups[0]["lr"] = h.learning_rate * h.last_rate ** (update / h.updates)
            observations, actions, counts = self.plans.batch(h.batch, rng)
            answers = policy.of_episodes(observations.flatten(1, 2)).reshape(actions.shape)
            errors = (answers - actions).square().mean(dim=3)[counts > 0.5]
            left = descend(policy, optimizer, errors.mean(), _MAX_GRAD_NORM)
        return left


def observe(
    planner: Planner, batch: EnvBatch, scenarios: Sequence[Scenario], plans: Plans, driver: Callable[[Floats], Floats]
) -> None:
    """Let a driver play episodes, and add what was seen and planned in them to the plans."""
    steps: tuple[list[Any], ...] = ([], [], [])

    def seen_driver(plan: Floats) -> Floats:
        terminated, truncated = batch.ended()
        seen, planned = (each.reshape(batch.num_envs, batch.n_wtg, -1).copy() for each in (batch.observations, plan))
        running = ~(terminated | truncated)[:, np.newaxis]
        counts = running & (batch.simulator.wtg_values("connected") > 0.5)
        for kept, now in zip(steps, (seen, planned, counts), strict=True):
            kept.append(now)
        return driver(plan)

    drive(planner, batch, scenarios, seen_driver)
    plans.add(*steps)


def disturbed(noise: float, step_s: float, rng: np.random.Generator) -> Callable[[Floats], Floats]:
    """Return a driver that adds noise to the plan, the same to all actions of an episode, which stays for a while."""
    kept = np.exp(-step_s / _NOISE_S)
    value = np.zeros((1, 1))

    def driver(plan: Floats) -> Floats:
        nonlocal value
        value = kept * value + noise * np.sqrt(1.0 - kept**2) * rng.standard_normal((len(plan), 1))
        actions: Floats = plan + value
        return actions

    return driver


def driven_by(policy: GradientPolicy, batch: EnvBatch) -> Callable[[Floats], Floats]:
    """Return a driver that takes the policy's actions."""
    states: list[Tensor] = []

    def driver(plan: Floats) -> Floats:
        with torch.no_grad():
            seen = torch.from_numpy(batch.observations.reshape(batch.num_envs * batch.n_wtg, -1).copy())
            answer, *states[:] = policy(seen, *states)
        actions: Floats = answer.reshape(plan.shape).double().numpy()
        return actions

    return driver


main = runs.main_in_rounds(
    "dagger",
    "Train a policy of sensors to do what a planner with the exact state would do.",
    Hyperparameters,
    DaggerLearner,
    timesteps=172_800,
    n_envs=80,
)

if __name__ == "__main__":
    sys.exit(main())
