"""Policies without any thought: constant actions, and actions that jump with the sign of one observation.

Neither constant ones nor those that jump between the limits (bang-bang) may beat the reference by much, else the
benchmark would reward a mere change of its settings. Those that jump by a part of that (relays) are the crudest form of
feedback.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from agents.rollouts import Candidates, Rollouts
from wtg_gym.cli.output import Progress
from wtg_gym.envs.task import N_LOCAL
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float64]

_ACTIONS = ("k", "tau")
_CONSTANTS = {
    "k": (-0.5, -0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2, 0.5),
    "tau": (-1, -0.5, -0.25, 0, 0.25, 0.5, 1),
}
_AMPLITUDES = (0.05, 0.2, 1.0)
#: Quantiles of an observation under the reference at which a bang-bang action jumps.
_JUMPS = (0.25, 0.5, 0.75)
_AT_ONCE = 24


@dataclass(frozen=True)
class SimplePolicy:
    """What a policy does, and its mean pinned cost."""

    family: str
    description: str
    cost: float


def simple_policies(
    suite: str, split: str, n_scenarios: int | None = None, n_threads: int | None = None
) -> tuple[float, list[SimplePolicy]]:
    """Return the reference's mean cost on scenarios, and all simple policies, the cheapest first.

    Args:
        suite, split: which scenarios.
        n_scenarios: how many, the first ones; None for all.
        n_threads: threads to step with; None for one per processor.

    Raises:
        ValueError: there is no such suite, or not that many scenarios.
    """
    seeds = list(get_suite(suite).seeds(split))
    if n_scenarios is not None and not 1 <= n_scenarios <= len(seeds):
        raise ValueError(f"--scenarios = {n_scenarios} is outside the allowed range 1 … {len(seeds)}")
    seeds = seeds[:n_scenarios]
    rollouts = Rollouts(suite, split, seeds, _AT_ONCE, n_threads)
    try:
        reference = float(rollouts.pinned(rollouts.reference()).mean())
        found = _constants(rollouts) + _bang_bangs(rollouts)
    finally:
        rollouts.close()
    return reference, sorted(found, key=lambda policy: policy.cost)


def _constants(rollouts: Rollouts) -> list[SimplePolicy]:
    grid = np.array(list(itertools.product(*_CONSTANTS.values())))
    costs = _costs(rollouts, "constant actions", len(grid), lambda which: _constant(grid[which]))
    return [
        SimplePolicy(
            "constant", ", ".join(f"{name} {value:+g}" for name, value in zip(_ACTIONS, row, strict=True)), cost
        )
        for row, cost in zip(grid.tolist(), costs, strict=True)
    ]


def _constant(actions: Floats) -> Candidates:
    """The candidates' actions (n_candidates, n_action), at all times."""
    return lambda _step, own: np.broadcast_to(actions[:, None, :], (*own.shape[:3], actions.shape[1]))


def _bang_bangs(rollouts: Rollouts) -> list[SimplePolicy]:
    thresholds = np.quantile(_seen(rollouts), _JUMPS, axis=0)
    names = [name.split(".", 1)[1] for name in rollouts.lanes.observation_names[:N_LOCAL]]
    grid = list(itertools.product(range(N_LOCAL), range(len(_JUMPS)), (1.0, -1.0), _AMPLITUDES, range(len(_ACTIONS))))

    def candidates(which: npt.NDArray[np.int64]) -> Candidates:
        observed, jump, sign, amplitude, action = (
            np.array(column) for column in zip(*(grid[i] for i in which), strict=True)
        )
        limits, each = thresholds[jump, observed], np.arange(len(which))

        def act(_step: int, own: Floats) -> Floats:
            actions = np.zeros((*own.shape[:3], len(_ACTIONS)))
            values = own[:, each, :, observed]
            actions[:, each, :, action] = (sign * amplitude)[:, None, None] * np.sign(values - limits[:, None, None])
            return actions

        return act

    costs = _costs(rollouts, "bang-bang actions", len(grid), candidates)
    return [
        SimplePolicy(
            "bang-bang" if amplitude == 1.0 else "relay",
            f"{_ACTIONS[a]} {sign * amplitude:+g} · sign({names[i]} − {thresholds[jump, i]:.2f})",
            cost,
        )
        for (i, jump, sign, amplitude, a), cost in zip(grid, costs, strict=True)
    ]


def _seen(rollouts: Rollouts) -> Floats:
    """What a group sees under the reference, every second, (n_samples, N_LOCAL)."""
    seen: list[Floats] = []
    alone = rollouts.with_candidates(1)

    def act(step: int, own: Floats) -> Floats:
        if step % 10 == 0:
            seen.append(own[..., :N_LOCAL].reshape(-1, N_LOCAL))
        return np.zeros((*own.shape[:3], alone.n_action))

    try:
        alone.play(act)
    finally:
        alone.close()
    return np.concatenate(seen)


def _costs(rollouts: Rollouts, name: str, n: int, candidates: Any) -> list[float]:
    """Mean pinned costs of n candidates, as many at a time as the rollouts have room for."""
    costs: list[float] = []
    with Progress("policies") as progress:
        for first in range(0, n, rollouts.n_candidates):
            # The last ones are repeated to fill the room.
            which = np.minimum(np.arange(first, first + rollouts.n_candidates), n - 1)
            played = rollouts.pinned(rollouts.play(candidates(which))).mean(axis=0)
            costs += played[: n - first].tolist()
            progress.update(name, len(costs), n)
    return costs


__all__ = ["SimplePolicy", "simple_policies"]
