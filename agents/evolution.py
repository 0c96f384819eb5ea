"""`python -m agents.evolution`: searches the last layer of a policy, or of several joined, by evolution, on the score.

CMA-ES (N. Hansen, "The CMA evolution strategy: a tutorial", 2016) plays many candidates through the same training
scenarios and moves towards the best. It needs neither gradients nor a value function, so it sees load shedding, trips
and lost grids as they are. The layers before the last one stay: those of trained policies, or random ones. Every
generation has other scenarios.
"""

import pickle
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import cma
import numpy as np
import onnx
import torch
from cyclopts import Parameter
from torch import Tensor, nn

from agents import run as runs
from agents.gradient import GradientPolicy
from agents.run import RunSettings, Whole, Widths
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.evaluation.summary import DESIGN_DEVIATION_MHZ
from wtg_gym.files import read_bytes
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies.entry_folder import POLICY_FILE, load_entry_folder
from wtg_gym.policies.torch_export import largest_difference
from wtg_gym.ranges import Checked, design

Folders = Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative="")]
_STATE = "state.pickle"
#: Generations over which the weights are averaged: each pulls towards its own scenarios.
_AVERAGED = 20
#: Where PyTorch has the four gates of an LSTM, among those of ONNX.
_GATES = [0, 2, 3, 1]
#: Largest difference of actions between a file and what was read of it.
_TOLERANCE = 1e-5
_NOT_OURS = "holds no single network of agents.dagger, agents.gradient or agents.evolution"
#: Deviation of the frequency that no run should have, and that from which on it counts, half of a lost run there [Hz].
_BEYOND_HZ, _NEAR_HZ = 1e-3 * DESIGN_DEVIATION_MHZ, 0.75


@runs.options
@dataclass(frozen=True)
class Hyperparameters(Checked):
    """Hyperparameters."""

    start: Folders = design(
        (),
        "-",
        "folders of policies whose common last layer is searched, made by agents.dagger, agents.gradient or, of one, "
        "agents.evolution; none: a new, random one",
    )
    lstm: Whole = design(0, "-", "of a new policy: width of its LSTM; 0: none", 0, 10_000)
    hidden: Widths = design((), "-", "of a new policy: widths of hidden layers; none and no LSTM: linear", 1, 10_000)
    population: Whole = design(20, "-", "candidates of a generation", 4, 10_000)
    reliability: float = design(
        0.0, "-", "points that a run costs that is lost or beyond 0.8 Hz, besides what the score pays", 0.0, 1e4
    )
    spread: float = design(0.02, "-", "standard deviation of the first candidates' weights", 1e-6, 100.0)


def read_policy(folder: Path, settings: RunSettings) -> GradientPolicy:
    """Return the network of a policy that agents.dagger, agents.gradient or this has made for every group alike.

    A ValueError says why it is none for these settings; one that acts on k may go on with k and τ.
    """
    entry = load_entry_folder(folder)
    for name in ("action_mode", "observation_mode", "strategy"):
        value, needed = getattr(entry, name), getattr(settings, name)
        if value != needed and (value, needed) != ("k", "k+tau"):
            raise ValueError(f"{folder} has {name} = {value!r}, not {needed!r}")
    if not entry.per_group:
        raise ValueError(f"{folder} has per_group = false: its policy sees all groups at once")
    content = read_bytes(folder / POLICY_FILE, "policy")
    # What the file holds may be anybody's.
    try:
        graph = onnx.load_from_string(content).graph
        policy = _network_of(graph)
        width = graph.input[0].type.tensor_type.shape.dim[1].dim_value
        difference = largest_difference(policy, content, width)
    except Exception as error:
        raise ValueError(f"{folder} {_NOT_OURS}") from error
    if not difference <= _TOLERANCE:
        raise ValueError(f"{folder} {_NOT_OURS}: its actions are others")
    return policy


def _network_of(graph: onnx.GraphProto) -> GradientPolicy:
    arrays = {each.name: torch.from_numpy(onnx.numpy_helper.to_array(each).copy()) for each in graph.initializer}
    weights = {name.removeprefix("module."): array for name, array in arrays.items() if "layers." in name}
    matrices = [array for array in weights.values() if array.ndim == 2]
    widths = [len(matrix) for matrix in matrices]
    recurrent = [list(node.input[1:4]) for node in graph.node if node.op_type == "LSTM"]
    n_observation, lstm = matrices[0].shape[1], 0
    for names in recurrent:
        of_input, of_hidden, biases = (arrays[name][0] for name in names)
        lstm, n_observation = of_hidden.shape[1], of_input.shape[1]
        parts = {"weight_ih": of_input, "weight_hh": of_hidden, "bias_ih": biases[: 4 * lstm]}
        for name, part in (parts | {"bias_hh": biases[4 * lstm :]}).items():
            weights[f"lstm.{name}_l0"] = part.reshape(4, -1)[_GATES].reshape(part.shape)
    policy = GradientPolicy(n_observation, widths[-1], widths[:-1], lstm)
    policy.load_state_dict(weights)
    return policy


class JoinedPolicy(nn.Module):
    """Policies side by side under a common last layer, which begins at the mean of theirs; those of k leave τ alone."""

    def __init__(self, policies: Sequence[GradientPolicy], n_action: int) -> None:
        super().__init__()
        self.policies = nn.ModuleList(policies)
        self.last = nn.Linear(sum(policy.last.in_features for policy in policies), n_action)
        self.state_widths = tuple(width for policy in policies for width in policy.state_widths)
        self.per_group = True
        first = 0
        with torch.no_grad():
            for parameter in self.last.parameters():
                parameter.zero_()
            for policy in policies:
                n, end = policy.last.out_features, first + policy.last.in_features
                self.last.weight[:n, first:end] = policy.last.weight / len(policies)
                self.last.bias[:n] += policy.last.bias / len(policies)
                first = end

    def features(self, observations: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        """Return what the last layer sees (num_envs, n) and the next states; none are given before the first step."""
        features, following, first = list[Tensor](), list[Tensor](), 0
        for policy in self.policies:
            assert isinstance(policy, GradientPolicy)
            before = states[first : first + len(policy.state_widths)]
            seen, *after = policy.features(observations, *before)
            features.append(seen)
            following += after
            first += len(before)
        return torch.cat(features, dim=1), *following

    def forward(self, observations: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        """Return the actions (num_envs, n_action) and the next states."""
        features, *following = self.features(observations, *states)
        return torch.tanh(self.last(features)), *following


EvolvedPolicy = GradientPolicy | JoinedPolicy


def largest_deviations_hz(batch: EnvBatch) -> Floats:
    """Return how far the frequency of the centre of inertia has been from nominal in each environment (num_envs,)."""
    lowest, highest = (batch.simulator.env_values(name) for name in ("coi_min", "coi_max"))
    deviations: Floats = batch.nominal_hz * np.maximum(1.0 - lowest, highest - 1.0)
    return deviations


class Population:
    """Candidates that play the same training scenarios side by side."""

    def __init__(self, settings: EnvSettings, n_scenarios: int, n_candidates: int, reliability: float = 0.0) -> None:
        self.batch = EnvBatch(replace(settings, reward="cost"), n_scenarios * n_candidates)
        self._shape, self._reliability = (n_candidates, n_scenarios), reliability

    def objectives(self, policy: EvolvedPolicy, candidates: Floats, scenarios: Sequence[Scenario]) -> Floats:
        """Return what each candidate should lower, in hundreds of points, mean over the scenarios (n_candidates,).

        Candidates are weights of the last layer, then its biases (n_candidates, n).
        """
        batch, (n, n_scenarios), last = self.batch, self._shape, policy.last
        for candidate in range(n):
            first = candidate * n_scenarios
            batch.start(range(first, first + n_scenarios), scenarios)
        vectors = torch.from_numpy(candidates).float()
        weights = vectors[:, : last.weight.numel()].reshape(n, *last.weight.shape).mT
        biases, states = vectors[:, None, last.weight.numel() :], list[Tensor]()
        with torch.no_grad():
            for _ in range(batch.n_steps_of_episode):
                seen = torch.from_numpy(batch.observations).reshape(batch.num_envs * batch.n_wtg, -1)
                features, *states = policy.features(seen, *states)
                actions = torch.tanh(features.reshape(n, -1, last.in_features) @ weights + biases)
                batch.step(np.ascontiguousarray(actions.reshape(batch.num_envs, -1).numpy(), dtype=np.float64))
        offsets = np.array([batch.suite.cost_offset(scenario) for scenario in scenarios])
        costs = batch.cost_sums().sum(axis=1).reshape(self._shape)
        values = np.log(costs + offsets) / (batch.suite.task.scale or 1.0)
        near = np.clip((largest_deviations_hz(batch) - _NEAR_HZ) / (2.0 * (_BEYOND_HZ - _NEAR_HZ)), 0.0, 1.0)
        bad = np.where(batch.ended()[0], 1.0, near).reshape(self._shape)
        objectives: Floats = (values + 0.01 * self._reliability * bad).mean(axis=1)
        return objectives


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
    def n_generations(self) -> int:
        """How many generations it has been told of."""
        return int(self._search.countiter)

    @property
    def mean(self) -> Floats:
        """Mean of the distribution that candidates are drawn from: it generalises better than the luckiest of them."""
        return np.array(self._search.result.xfavorite)


class EvolutionLearner(runs.RoundLearner):
    """A policy and the search for its last layer; policies to start from are read for a new run alone."""

    def __init__(self, settings: RunSettings, h: Hyperparameters) -> None:
        runs.require_local(settings)
        if h.start and (h.hidden or h.lstm):
            raise ValueError("--start brings its own layers; leave out --hidden and --lstm")
        self._settings, self._h = settings, h
        environment = EnvSettings(**settings.env_arguments)
        self._population = Population(environment, settings.n_envs, h.population, h.reliability)
        self.batch = self._population.batch
        self.timesteps = self.batch.n_steps_of_episode * self.batch.num_envs

    @cached_property
    def network(self) -> EvolvedPolicy:  # type: ignore[override]
        """The policy."""
        batch, h = self.batch, self._h
        n_observation, n_action = batch.n_observation // batch.n_wtg, batch.n_action // batch.n_wtg
        policies = [read_policy(Path(folder), self._settings) for folder in h.start]
        network: EvolvedPolicy
        if not policies:
            network = GradientPolicy(n_observation, n_action, h.hidden, h.lstm)
        elif len(policies) == 1 and policies[0].last.out_features == n_action:
            network = policies[0]
        else:
            network = JoinedPolicy(policies, n_action)
        network.per_group = True
        return network

    @cached_property
    def average(self) -> Floats:
        """The last layer's weights and biases: their average over some generations."""
        average: Floats = nn.utils.parameters_to_vector(self.network.last.parameters()).detach().double().numpy()
        return average

    @cached_property
    def search(self) -> Search:
        """The search, which begins at the policy."""
        return Search(self.average, self._h.spread, self._h.population, self._settings.seed)

    def tell(self, candidates: Floats, objectives: Floats) -> None:
        """Learn what candidates are worth."""
        self.search.tell(candidates, objectives)
        self.average += (self.search.mean - self.average) / min(self.search.n_generations, _AVERAGED)
        nn.utils.vector_to_parameters(torch.from_numpy(self.average).float(), self.network.last.parameters())

    def save(self, folder: Path) -> None:
        (folder / _STATE).write_bytes(pickle.dumps((self.network, self.average, self.search)))

    def load(self, folder: Path) -> None:
        with runs.loading(folder) as folder:
            self.network, self.average, self.search = pickle.loads((folder / _STATE).read_bytes())

    def learn(self, scenarios: Sequence[Scenario], rng: np.random.Generator, index: int, n_rounds: int) -> float:
        candidates = self.search.ask()
        objectives = self._population.objectives(self.network, candidates, scenarios)
        self.tell(candidates, objectives)
        return float(objectives.mean())


main = runs.main_in_rounds(
    "evolution",
    "Search the last layer of a policy by evolution, on the score itself.",
    Hyperparameters,
    EvolutionLearner,
    timesteps=32_400_000,
    n_envs=90,
)

if __name__ == "__main__":
    sys.exit(main())
