"""`python -m agents.evolution`: trains a small policy by evolution, on what the score pays.

CMA-ES (N. Hansen, "The CMA evolution strategy: a tutorial", 2016) plays many candidates through the same training
scenarios and moves towards the best. It needs neither gradients nor a value function, so that it sees load shedding,
trips and lost grids as they are: with a hundred parameters and some ms of one core for an episode that is cheap. Every
generation has other scenarios.
"""

import pickle
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cma
import numpy as np
import numpy.typing as npt
import torch
from cyclopts import Parameter
from torch import Tensor, nn

from agents import run as runs
from agents.run import RunSettings, Whole
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import Checked, design
from wtg_gym.tasks.observation import FREQUENCY_UNIT_HZ, ROTOR_SPEED_UNIT_PU

Floats = npt.NDArray[np.float64]
_STATE = "state.pickle"
#: Generations over which the weights are averaged: each pulls towards its own scenarios.
_AVERAGED = 20
#: What a policy sees besides a group's own observation: slow copies of entries of it (frequency, tip-speed ratio, rotor
#: speed), with these time constants [s], and the mean frequency of all groups.
SLOW_COLUMNS, SLOW_TIMES_S = (0, 0, 2, 2, 3), (2.0, 10.0, 3.0, 10.0, 10.0)
#: And how far frequency and rotor speed lie below these values [Hz, p.u.]: there a grid or a rotor is about to be lost.
LOW_FREQUENCY_HZ, LOW_ROTOR_PU = -0.8, 0.75
#: Largest deviations that count in part among those beyond the design deviation, from nothing to all [Hz]: of ninety
#: scenarios one or two lie so close to it that candidates differ in them.
SOFT_HZ = (0.6, 0.9)
_LOW_COLUMNS = [0, 3]
_LOW = [LOW_FREQUENCY_HZ / FREQUENCY_UNIT_HZ, (LOW_ROTOR_PU - 1.0) / ROTOR_SPEED_UNIT_PU]


@runs.options
@dataclass(frozen=True)
class Hyperparameters(Checked):
    """Hyperparameters; the first generations search the direct weights alone, which are few."""

    hidden: Whole = design(6, "-", "tanh units, or 0 for a linear policy", 0, 1000)
    population: Whole = design(20, "-", "candidates of a generation", 4, 10_000)
    first_share: float = design(0.4, "-", "of the generations, for the direct weights alone", 0.0, 1.0)
    first_spread: float = design(0.15, "-", "standard deviation of the first candidates' direct weights", 1e-6, 100.0)
    spread: float = design(0.03, "-", "standard deviation of all weights, when they are searched first", 1e-6, 100.0)
    mean_weight: float = design(0.0, "-", "weight of J / J0 beside ln(J + J0)", 0.0, 100.0)
    mark_weight: float = design(1.0, "-", "weight of the share of runs with the grid lost or beyond 0.8 Hz", 0.0, 100.0)
    history: Annotated[bool, Parameter(negative="--own-only")] = design(
        True, "-", "a group sees slow copies and the mean frequency too, or its present observation alone"
    )


class GroupPolicy(nn.Module):
    """A network that every group has alike, of what it sees, directly and through one layer of tanh units."""

    def __init__(
        self, n_wtg: int, n_own: int, n_action: int, hidden: int, control_dt: float, history: bool = True
    ) -> None:
        super().__init__()
        #: Whether it answers for one group at a time.
        self.per_group = False
        self._n_wtg, self._n_own = n_wtg, n_own
        n_seen = n_own + (len(SLOW_COLUMNS) + 3) * history
        self._shapes = ((n_seen + 1, hidden), (hidden + n_seen + 1, n_action))
        self.n_parameters = sum(a * b for a, b in self._shapes)
        #: Weights of the layer of tanh units, which come first, and places of the direct ones, which come last.
        self.n_first = self._shapes[0][0] * hidden
        self.direct = np.arange(self.n_first + hidden * n_action, self.n_parameters)
        self.weights = nn.Parameter(torch.zeros(self.n_parameters), requires_grad=False)
        self._filters = torch.tensor(-np.expm1(-control_dt / np.array(SLOW_TIMES_S)), dtype=torch.float32)
        self._low = torch.tensor(_LOW)
        self.state_widths: tuple[int, ...] = (n_wtg * len(SLOW_COLUMNS), 1) if history else ()

    def of_one(self) -> "GroupPolicy":
        """Return the policy of a single group, with the same weights, now and later."""
        _, (_, n_action) = self._shapes
        policy = GroupPolicy(1, self._n_own, n_action, self._shapes[0][1], 1.0, history=False)
        policy.weights, policy.per_group = self.weights, True
        return policy

    def forward(self, observations: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        """Return the actions (n_lanes, n_action) and the next states; zeros are given before the first step."""
        before = states or [observations.new_zeros(len(observations), width) for width in self.state_widths]
        answer = self.act(self.weights[None], observations[None], *(state[None] for state in before))
        return tuple(state[0] for state in answer)

    def act(self, weights: Tensor, observations: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        """Return the actions of candidates (n, n_lanes, n_action) with weights (n, n_parameters), and the next states.

        Observations are (n, n_lanes, n_observation); states (n, n_lanes, …) are slow copies, and whether there are any
        yet, none without history.
        """
        # The number of lanes stands nowhere: in an exported graph, what depends on it takes longer than all else.
        n, n_wtg = len(weights), self._n_wtg
        observed = observations.reshape(n, -1, n_wtg, self._n_own)
        parts, following = [observed], list[Tensor]()
        if states:
            slow, started = states
            now = observed[..., list(SLOW_COLUMNS)]
            before = torch.where(started[..., None] > 0.5, slow.reshape(n, -1, n_wtg, len(SLOW_COLUMNS)), now)
            copies = before + self._filters * (now - before)
            low = torch.clamp(observed[..., _LOW_COLUMNS] - self._low, max=0.0)
            frequency = observed[..., :1]
            parts += [copies, low, frequency.mean(dim=2, keepdim=True) + 0.0 * frequency]
            following = [copies.reshape(n, -1, self.state_widths[0]), 0.0 * started + 1.0]
        (a, b), (_, n_action) = self._shapes
        seen = torch.cat(parts, dim=-1).reshape(n, -1, a - 1)
        layers = weights[:, a * b :].reshape(n, -1, n_action)
        actions = seen @ layers[:, b:-1] + layers[:, -1:]
        if b:  # ONNX Runtime cannot multiply by a matrix without columns.
            first = weights[:, : a * b].reshape(n, a, b)
            actions = actions + torch.tanh(seen @ first[:, :-1] + first[:, -1:]) @ layers[:, :b]
        return (actions.reshape(n, -1, n_wtg * n_action), *following)


class Population:
    """Candidates that play the same training scenarios side by side."""

    def __init__(self, settings: EnvSettings, n_scenarios: int, n_candidates: int, h: Hyperparameters) -> None:
        self.lanes = TaskLanes(replace(settings, reward="cost"), n_scenarios * n_candidates)
        self._shape, self._h = (n_candidates, n_scenarios), h

    def objectives(self, policy: GroupPolicy, candidates: Floats, scenarios: Sequence[Scenario]) -> Floats:
        """Return what each candidate (n_candidates, n_parameters) should lower, mean over the scenarios."""
        lanes, (n, n_scenarios) = self.lanes, self._shape
        for candidate in range(n):
            first = candidate * n_scenarios
            lanes.start(range(first, first + n_scenarios), scenarios)
        weights = torch.from_numpy(candidates).float()
        states = [torch.zeros(n, n_scenarios, width) for width in policy.state_widths]
        with torch.no_grad():
            for _ in range(lanes.n_steps_of_episode):
                seen = torch.from_numpy(lanes.observations).reshape(n, n_scenarios, -1)
                actions, *states = policy.act(weights, seen, *states)
                clipped = actions.reshape(lanes.n_lanes, -1).clamp(-1.0, 1.0)
                lanes.step(np.ascontiguousarray(clipped.numpy().astype(np.float64)))
        offsets = np.array([lanes.suite.cost_offset(scenario) for scenario in scenarios])
        costs = lanes.cost_sums().sum(axis=1).reshape(self._shape)
        lowest, highest = (lanes.nominal_hz * lanes.simulator.lane_values(name) for name in ("coi_min", "coi_max"))
        largest_hz = np.maximum(lanes.nominal_hz - lowest, highest - lanes.nominal_hz)
        bad = np.where(lanes.statuses() != 0, 1.0, np.interp(largest_hz, SOFT_HZ, (0.0, 1.0))).reshape(self._shape)
        paid = (np.log(costs + offsets) + self._h.mean_weight * costs / offsets) / (lanes.suite.task.scale or 1.0)
        values: Floats = paid.mean(axis=1) + self._h.mark_weight * bad.mean(axis=1)
        return values


class Search:
    """CMA-ES that draws from a generator of its own: cma's is numpy's one for everybody."""

    def __init__(
        self, start: Floats, spread: float, population: int, *seed: int, bounds: Sequence[Sequence[float]] | None = None
    ) -> None:
        self._rng = np.random.default_rng(seed)
        options = {"popsize": population, "randn": self._normal, "seed": np.nan, "verbose": -9, "CMA_diagonal": 40}
        options |= {} if bounds is None else {"bounds": [list(side) for side in bounds]}
        self._search = cma.CMAEvolutionStrategy(start.ravel(), spread, options)

    def _normal(self, *shape: int) -> Floats:
        return self._rng.standard_normal(shape)

    def ask(self) -> Floats:
        """Return the next candidates, (population, n)."""
        # When cma goes over from a diagonal to a full covariance, its new sampler forgets the option.
        self._search.sm.randn = self._normal
        return np.array(self._search.ask())

    def tell(self, candidates: Floats, costs: Floats) -> None:
        self._search.tell(list(candidates), costs.tolist())

    @property
    def mean(self) -> Floats:
        """Mean of the distribution that candidates are drawn from: it generalises better than the luckiest of them."""
        return np.array(self._search.result.xfavorite)


class EvolutionLearner:
    """A policy and the search for its weights."""

    def __init__(self, policy: GroupPolicy, seed: int, h: Hyperparameters) -> None:
        self.policy, self._seed, self._h = policy, seed, h
        rng = np.random.default_rng(seed)
        #: The weights that the search goes on from; the first layer's are random, and have no effect at first.
        self.weights = 0.4 * rng.standard_normal(policy.n_parameters)
        self.weights[policy.n_first :] = 0.0
        #: The policy's: their average over some generations.
        self.average = self.weights.copy()
        policy.weights.copy_(torch.from_numpy(self.average))
        self.begin(policy.direct, h.first_spread)
        #: What is exported: where a group sees nothing of the others, the policy of one.
        self.network = policy if h.history else policy.of_one()

    def begin(self, places: npt.NDArray[np.int64], spread: float) -> None:
        """Begin a search of the weights at some places."""
        self.places = places
        self.search = Search(self.weights[places], spread, self._h.population, self._seed, len(places))

    def ask(self) -> Floats:
        """Return candidates (population, n_parameters)."""
        candidates = np.tile(self.weights, (self._h.population, 1))
        candidates[:, self.places] = self.search.ask()
        return candidates

    def tell(self, candidates: Floats, objectives: Floats) -> None:
        """Learn what candidates are worth."""
        self.search.tell(candidates[:, self.places], objectives)
        self.weights[self.places] = self.search.mean
        self.average += (self.weights - self.average) / _AVERAGED
        self.policy.weights.copy_(torch.from_numpy(self.average))

    def save(self, folder: Path) -> None:
        """Write everything that training goes on from into an empty folder."""
        (folder / _STATE).write_bytes(pickle.dumps((self.weights, self.average, self.places, self.search)))

    def load(self, folder: Path) -> None:
        """Go back to what :meth:`save` wrote; a ValueError names a folder that is damaged."""
        with runs.loading(folder) as folder:
            self.weights, self.average, self.places, self.search = pickle.loads((folder / _STATE).read_bytes())
            self.policy.weights.copy_(torch.from_numpy(self.average))


def rounds(settings: RunSettings, h: Hyperparameters) -> runs.Rounds:
    """Return the learner of a run, and its rounds."""
    if settings.observation_mode != "local":
        raise ValueError(f"observation_mode must be local, got {settings.observation_mode!r}: groups see their own")
    population = Population(EnvSettings(**settings.env_arguments), settings.n_envs, h.population, h)
    lanes = population.lanes
    control_dt, n_action = lanes.settings.step_s, lanes.n_action // lanes.n_wtg
    policy = GroupPolicy(lanes.n_wtg, lanes.n_local + n_action, n_action, h.hidden, control_dt, h.history)
    learner = EvolutionLearner(policy, settings.seed, h)

    def learn(scenarios: Sequence[Scenario], _rng: np.random.Generator, index: int, n_generations: int) -> float:
        if index == round(h.first_share * n_generations) and h.hidden:
            learner.begin(np.arange(policy.n_parameters), h.spread)
        candidates = learner.ask()
        objectives = population.objectives(policy, candidates, scenarios)
        learner.tell(candidates, objectives)
        return float(objectives.mean())

    return runs.Rounds(learner, lanes, lanes.n_steps_of_episode * settings.n_envs * h.population, learn)


main = runs.main_in_rounds(
    "evolution",
    "Train a small policy by evolution, on what the score pays.",
    Hyperparameters,
    rounds,
    timesteps=388_800_000,
    n_envs=90,
)

if __name__ == "__main__":
    sys.exit(main())
