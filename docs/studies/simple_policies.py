"""`python docs/studies/simple_policies.py`: constant actions, and actions that jump with one observation's sign."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np
from rollouts import Candidates, Rollouts, difference_percent

from agents.command import Parser, Progress, add_threads_option, print_table, run_command, say, suite_name
from wtg_gym.evaluation.score import COST_OFFSET
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import get_suite

_DESCRIPTION = """\
Plays the simplest policies: a grid of constant actions; actions that jump where one observation crosses a quartile of
its values under the zero action, from limit to limit (bang-bang) or by a part of that (relay); and actions in
proportion to one observation's distance from its median. If these beat the reference by much, the benchmark would
reward a mere change of settings."""
_ACTIONS = ("k", "tau")
_CONSTANTS = {
    "k": (-0.5, -0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2, 0.5),
    "tau": (-1, -0.5, -0.25, 0, 0.25, 0.5, 1),
}
_AMPLITUDES = (0.05, 0.2, 1.0)
_GAINS = (0.2, 0.6, 2.0)
#: Quantiles of an observation under the reference at which an action jumps.
_JUMPS = (0.25, 0.5, 0.75)
_AT_ONCE = 24


class SimplePolicy(NamedTuple):
    """A policy in words, its mean pinned cost, and the mean of ln(J + J0), which decides the score."""

    family: str
    description: str
    cost: float
    log_cost: float


def simple_policies(
    suite: str,
    split: str,
    n_scenarios: int | None = None,
    n_threads: int | None = None,
    *,
    strategy: str = REFERENCE_STRATEGY,
) -> tuple[float, list[SimplePolicy]]:
    """Return the zero action's mean cost on scenarios, and all simple policies, the cheapest first.

    Raises:
        ValueError: the suite is unknown, or has fewer scenarios.
    """
    seeds = list(get_suite(suite).seeds(split))
    if n_scenarios is not None and not 1 <= n_scenarios <= len(seeds):
        raise ValueError(f"--scenarios = {n_scenarios} is outside the allowed range 1 … {len(seeds)}")
    with closing(Rollouts(suite, split, seeds[:n_scenarios], _AT_ONCE, n_threads, strategy=strategy)) as rollouts:
        reference = float(rollouts.pinned(rollouts.reference()).mean())
        found = _constants(rollouts) + _jumping(rollouts) + _proportional(rollouts)
    return reference, sorted(found, key=lambda policy: policy.cost)


def _constants(rollouts: Rollouts) -> list[SimplePolicy]:
    grid = np.array(list(itertools.product(*_CONSTANTS.values())))

    def candidates(which: list[int]) -> Candidates:
        actions = grid[which][:, None, :]
        return lambda _step, own: np.broadcast_to(actions, (*own.shape[:3], len(_ACTIONS)))

    words = [", ".join(f"{name} {value:+g}" for name, value in zip(_ACTIONS, row, strict=True)) for row in grid]
    costs = _costs(rollouts, "constant actions", len(grid), candidates)
    return [SimplePolicy("constant", text, *own) for text, own in zip(words, costs, strict=True)]


def _jumping(rollouts: Rollouts) -> list[SimplePolicy]:
    thresholds = np.quantile(_seen(rollouts), _JUMPS, axis=0)
    names = [name.split(".", 1)[1] for name in rollouts.lanes.observation_names[: rollouts.lanes.n_local]]
    grid = list(
        itertools.product(range(len(names)), range(len(_JUMPS)), (1.0, -1.0), _AMPLITUDES, range(len(_ACTIONS)))
    )

    def candidates(which: list[int]) -> Candidates:
        observed, jump, sign, amplitude, action = map(np.array, zip(*(grid[i] for i in which), strict=True))
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
            *cost,
        )
        for (i, jump, sign, amplitude, a), cost in zip(grid, costs, strict=True)
    ]


def _proportional(rollouts: Rollouts) -> list[SimplePolicy]:
    medians = np.median(_seen(rollouts), axis=0)
    names = [name.split(".", 1)[1] for name in rollouts.lanes.observation_names[: rollouts.lanes.n_local]]
    grid = list(itertools.product(range(len(names)), (1.0, -1.0), _GAINS, range(len(_ACTIONS))))

    def candidates(which: list[int]) -> Candidates:
        observed, sign, gain, action = map(np.array, zip(*(grid[i] for i in which), strict=True))
        each = np.arange(len(which))

        def act(_step: int, own: Floats) -> Floats:
            actions = np.zeros((*own.shape[:3], len(_ACTIONS)))
            values = own[:, each, :, observed]
            actions[:, each, :, action] = (sign * gain)[:, None, None] * (values - medians[observed][:, None, None])
            return actions

        return act

    costs = _costs(rollouts, "proportional actions", len(grid), candidates)
    return [
        SimplePolicy("proportional", f"{_ACTIONS[a]} {sign * gain:+g} · ({names[i]} − {medians[i]:.2f})", *cost)
        for (i, sign, gain, a), cost in zip(grid, costs, strict=True)
    ]


def _seen(rollouts: Rollouts) -> Floats:
    """Return a group's observations under the reference, every second, (n_samples, n_local)."""
    seen: list[Floats] = []
    n_local = rollouts.lanes.n_local

    def act(step: int, own: Floats) -> Floats:
        if step % 10 == 0:
            seen.append(own[..., :n_local].reshape(-1, n_local))
        return np.zeros((*own.shape[:3], rollouts.n_action))

    with closing(rollouts.with_candidates(1)) as alone:
        alone.play(act)
    return np.concatenate(seen)


def _costs(
    rollouts: Rollouts, name: str, n: int, candidates: Callable[[list[int]], Candidates]
) -> list[tuple[float, float]]:
    """Return the mean pinned costs of n candidates and those of ln(J + J0), as many at a time as there is room for."""
    costs: list[tuple[float, float]] = []
    with Progress("policies") as progress:
        for first in range(0, n, rollouts.n_candidates):
            # The last ones are repeated to fill the room.
            which = [min(i, n - 1) for i in range(first, first + rollouts.n_candidates)]
            played = rollouts.pinned(rollouts.play(candidates(which)))
            means = played.mean(axis=0).tolist(), np.log(played + COST_OFFSET).mean(axis=0).tolist()
            costs += list(zip(*means, strict=True))[: n - first]
            progress.update(name, len(costs), n)
    return costs


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python docs/studies/simple_policies.py", description=_DESCRIPTION)
    parser.add_argument("--suite", type=suite_name, metavar="NAME", default="standard", help="(default: standard)")
    parser.add_argument("--split", choices=("validation", "test"), default="validation", help="(default: validation)")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    add_threads_option(parser)

    def work() -> None:
        given = parser.parse_args(argv)
        reference, policies = simple_policies(given.suite, given.split, given.scenarios, given.threads)
        head = f"suite {given.suite}, {given.split}: mean cost of the reference {reference:.2f}"
        say(f"{head}; the best three of each kind", "")
        rows: list[tuple[str, ...]] = []
        for family in ("constant", "bang-bang", "relay", "proportional"):
            own = [policy for policy in policies if policy.family == family]
            for policy in own[:3]:
                difference = difference_percent(policy.cost, reference)
                rows.append((family, str(len(own)), policy.description, f"{policy.cost:.2f}", difference))
        print_table(("kind", "tried", "policy", "mean cost", "difference [%]"), rows)

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
