"""How much better than the reference can anything be? Policies found by search, with and without foresight.

    python -m agents.oracle linear --suite standard
    python -m agents.oracle foresight --suite standard --split test

`linear` tunes one linear feedback of a group's own observation on training scenarios and measures it on validation
scenarios: what a simple learner must beat. `foresight` searches for every scenario on its own, knowing all of it, for
the best actions: a course of actions over time (knots, linear in between), then the same on top of a linear feedback.
The cheaper of the two is the oracle. It is what was found, not a bound: a longer search may find better.

Both search with CMA-ES (N. Hansen, "The CMA evolution strategy: a tutorial", 2016).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cma
import numpy as np
import numpy.typing as npt

from wtg_gym.cli.output import Progress
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task import COST_TERMS, N_LOCAL, TaskRow
from wtg_gym.files import to_json, write_atomically
from wtg_gym.scenarios import SUITES, get_suite

Floats = npt.NDArray[np.float64]
#: Observations (n_scenarios, n_candidates, n_wtg, n) of a step to actions (n_scenarios, n_candidates, n_wtg, n_action).
Candidates = Callable[[int, Floats], Floats]

#: Candidates per generation and knots per action.
POPULATION = 24
N_KNOTS = 16


class Rollouts:
    """Plays many candidates through many scenarios at once.

    Args:
        suite, split, seeds: which scenarios.
        n_candidates: candidates side by side in every scenario.
        settings: further settings of the environment.
    """

    def __init__(self, suite: str, split: str, seeds: Sequence[int], n_candidates: int, **settings: Any) -> None:
        chosen = EnvSettings(suite=suite, split=split, **settings)
        self.lanes = TaskLanes(chosen, len(seeds) * n_candidates)
        self._shape = len(seeds), n_candidates, self.lanes.n_wtg
        self._episodes = self.lanes.prepare(self.lanes.scenarios(seeds))
        # One candidate's lanes after another's, each in the order of the scenarios.
        self._order = np.arange(self.lanes.n_lanes).reshape(len(seeds), n_candidates).T.ravel().tolist()
        self.n_steps = int(self._episodes.n_intervals.max())
        self.n_action = self.lanes.n_action // self.lanes.n_wtg

    def play(self, candidates: Candidates) -> Floats:
        """Return the sums of the cost's terms over an episode, (n_scenarios, n_candidates, n_terms)."""
        lanes = self.lanes
        lanes.commit(self._order, [self._episodes] * self._shape[1])
        for step in range(self.n_steps):
            own = lanes.observations.reshape(*self._shape, -1).astype(np.float64)
            actions = np.clip(candidates(step, own), -1.0, 1.0)
            lanes.step(np.ascontiguousarray(actions.reshape(lanes.n_lanes, -1)))
        sums = np.stack([lanes.task_values(TaskRow.SUM + i) for i in range(len(COST_TERMS))], axis=-1)
        return sums.reshape(*self._shape[:2], -1)

    def reference(self) -> Floats:
        """Return what :meth:`play` gives for the zero action, (n_scenarios, n_terms)."""
        zero = np.zeros((*self._shape, self.n_action))
        return self.play(lambda _step, _own: zero)[:, 0]


def linear_feedback(gains: Floats) -> Candidates:
    """Return the feedback a = G o + b of a group's own observation.

    Args:
        gains: (..., n_action, N_LOCAL + 1) per candidate, the last column is b; leading axes as for scenarios and
            candidates, or fewer.
    """

    def act(_step: int, own: Floats) -> Floats:
        actions: Floats = np.einsum("...ij,...wj->...wi", gains[..., :-1], own[..., :N_LOCAL])
        return actions + gains[..., None, :, -1]

    return act


def knots(values: Floats, n_steps: int) -> Candidates:
    """Return actions that are linear in time between knots, (n_scenarios, n_candidates, N_KNOTS, n_wtg, n_action)."""
    position = np.linspace(0.0, values.shape[2] - 1.0, n_steps)
    left = np.minimum(position.astype(np.int64), values.shape[2] - 2)
    share = position - left

    def act(step: int, _own: Floats) -> Floats:
        before, after = values[:, :, left[step]], values[:, :, left[step] + 1]
        return before + float(share[step]) * (after - before)

    return act


def _strategy(start: Floats, spread: float, seed: int) -> Any:
    options = {"popsize": POPULATION, "seed": seed + 1, "verbose": -9, "CMA_diagonal": 40}
    return cma.CMAEvolutionStrategy(start.ravel(), spread, options)


class LinearResult(NamedTuple):
    """A tuned feedback: its gains (n_action, N_LOCAL + 1), and its mean cost on what it was tuned with."""

    gains: Floats
    cost: float


def tune_linear(rollouts: Rollouts, generations: int, progress: Progress, seed: int = 0) -> LinearResult:
    """Search for the linear feedback, the same for all groups, with the smallest mean cost."""
    shape = (rollouts.n_action, N_LOCAL + 1)
    search = _strategy(np.zeros(shape), 0.15, seed)
    for generation in range(generations):
        asked = np.array(search.ask())
        costs = rollouts.play(linear_feedback(asked.reshape(-1, *shape))).sum(axis=-1).mean(axis=0)
        search.tell(list(asked), costs.tolist())
        progress.update(f"linear feedback, cost {search.result.fbest:.2f}", generation + 1, generations)
    # The mean of the search's distribution generalises better than its luckiest sample.
    gains = np.asarray(search.result.xfavorite).reshape(shape)
    return LinearResult(gains, float(search.result.fbest))


def search_with_foresight(
    rollouts: Rollouts, gains: Floats | None, generations: int, progress: Progress, seed: int = 0
) -> Floats:
    """Return the smallest cost found for every scenario, (n_scenarios,).

    Args:
        rollouts: the scenarios, with POPULATION candidates each.
        gains: of a linear feedback that the actions are added to and whose gains are searched as well; None: without.
        generations: of every scenario's search.
        progress: is told.
        seed: of the searches.
    """
    n_scenarios, n_candidates = rollouts._shape[:2]
    course = (N_KNOTS, rollouts.lanes.n_wtg, rollouts.n_action)
    n_course = int(np.prod(course))
    start = np.zeros(n_course) if gains is None else np.concatenate([np.zeros(n_course), gains.ravel()])
    searches = [_strategy(start, 0.3, seed + i) for i in range(n_scenarios)]
    best = np.full(n_scenarios, np.inf)
    for generation in range(generations):
        asked = np.array([search.ask() for search in searches])
        act = knots(asked[..., :n_course].reshape(n_scenarios, n_candidates, *course), rollouts.n_steps)
        if gains is not None:
            own_gains = asked[..., n_course:].reshape(n_scenarios, n_candidates, *gains.shape)
            course_of, feedback = act, linear_feedback(own_gains)

            def act(step: int, own: Floats, a: Candidates = course_of, b: Candidates = feedback) -> Floats:
                return a(step, own) + b(step, own)

        costs = rollouts.play(act).sum(axis=-1)
        for search, candidates, cost in zip(searches, asked, costs, strict=True):
            search.tell(list(candidates), cost.tolist())
        best = np.minimum(best, costs.min(axis=1))
        progress.update(f"oracle, mean cost {best.mean():.2f}", generation + 1, generations)
    return best


def _linear(arguments: argparse.Namespace) -> dict[str, Any]:
    suite = get_suite(arguments.suite)
    training = list(suite.train[: arguments.scenarios])
    with Progress("generations") as progress:
        rollouts = Rollouts(arguments.suite, "train", training, POPULATION, **_settings(arguments))
        found = tune_linear(rollouts, arguments.generations, progress, arguments.seed)
    unseen = Rollouts(arguments.suite, "validation", list(suite.validation), 1, **_settings(arguments))
    cost, reference = unseen.play(linear_feedback(found.gains))[:, 0], unseen.reference()
    return {
        "gains": found.gains.round(4).tolist(),
        "training": {"scenarios": len(training), "cost": found.cost, "reference": _mean(rollouts.reference())},
        "validation": {
            "scenarios": len(suite.validation),
            "cost": _mean(cost),
            "reference": _mean(reference),
            "terms": dict(zip(COST_TERMS, cost.mean(axis=0).tolist(), strict=True)),
            "reference_terms": dict(zip(COST_TERMS, reference.mean(axis=0).tolist(), strict=True)),
        },
    }


def _foresight(arguments: argparse.Namespace) -> dict[str, Any]:
    suite = get_suite(arguments.suite)
    seeds = list(suite.seeds(arguments.split)[: arguments.scenarios])
    gains = None
    if arguments.gains is not None:
        gains = np.array(json.loads(Path(arguments.gains).read_text(encoding="utf-8"))["gains"])
    rollouts = Rollouts(arguments.suite, arguments.split, seeds, POPULATION, **_settings(arguments))
    reference = rollouts.reference()
    with Progress("generations") as progress:
        costs = {"course": search_with_foresight(rollouts, None, arguments.generations, progress, arguments.seed)}
        if gains is not None:
            found = search_with_foresight(rollouts, gains, arguments.generations, progress, arguments.seed)
            costs["course and feedback"] = found
    oracle = np.minimum.reduce(list(costs.values()))
    total = reference.sum(axis=-1)
    return {
        "suite_hash": suite.hash,
        "split": arguments.split,
        "seeds": [int(seed) for seed in seeds],
        "reference": total.tolist(),
        "oracle": np.minimum(oracle, total).tolist(),
        "mean_reference": float(total.mean()),
        "mean_oracle": float(np.minimum(oracle, total).mean()),
        "mean_by_form": {name: float(cost.mean()) for name, cost in costs.items()},
    }


def _mean(terms: Floats) -> float:
    return float(terms.sum(axis=-1).mean())


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    return {"action_mode": arguments.action_mode}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m agents.oracle", description=__doc__, formatter_class=_Raw)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, run, scenarios, generations in (("linear", _linear, 64, 150), ("foresight", _foresight, 50, 150)):
        command = commands.add_parser(name, help=f"{name} search")
        command.set_defaults(run=run)
        command.add_argument("--suite", choices=tuple(SUITES), default="standard")
        command.add_argument("--action-mode", choices=("k", "tau", "k+tau"), default="k+tau")
        command.add_argument("--scenarios", type=int, default=scenarios, metavar="N", help=f"default: {scenarios}")
        command.add_argument(
            "--generations", type=int, default=generations, metavar="N", help=f"default: {generations}"
        )
        command.add_argument("--seed", type=int, default=0, help="of the search (default: 0)")
        command.add_argument("--output", type=Path, metavar="FILE", help="JSON file to write the result to")
    command.add_argument("--split", choices=("validation", "test"), default="test")
    command.add_argument("--gains", metavar="FILE", help="result of `linear`, to search on top of a feedback as well")
    return parser


class _Raw(argparse.RawDescriptionHelpFormatter):
    """Keeps the line breaks of the description."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a search and print its result as JSON."""
    given = _parser().parse_args(arguments)
    for name in ("scenarios", "generations"):
        if not 1 <= getattr(given, name) <= 100_000:
            raise SystemExit(f"--{name} = {getattr(given, name)} is outside the allowed range 1 … 100000")
    result = {"command": given.command, "suite": given.suite, "action_mode": given.action_mode, **given.run(given)}
    text = to_json(result)
    if given.output is not None:
        write_atomically(given.output, text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
