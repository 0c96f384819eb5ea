"""`python -m agents.evolution`: searches the last layer of a policy by evolution, on the score itself.

CMA-ES (N. Hansen, "The CMA evolution strategy: a tutorial", 2016) plays many candidates through the same training
scenarios and moves towards the best. It needs neither gradients nor a value function, so it sees load shedding, trips
and lost grids as they are. The layers before the last one stay: those of a trained policy, or random ones. Every
generation has other scenarios.
"""

import pickle
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cma
import numpy as np
import numpy.typing as npt
import onnx
import torch
from torch import Tensor, nn

from agents import run as runs
from agents.gradient import GradientPolicy
from agents.run import RunSettings, Whole, Widths
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.files import read_bytes
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies.entry_folder import POLICY_FILE, load_entry_folder
from wtg_gym.policies.torch_export import largest_difference
from wtg_gym.ranges import Checked, design

Floats = npt.NDArray[np.float64]
_STATE = "state.pickle"
#: Generations over which the weights are averaged: each pulls towards its own scenarios.
_AVERAGED = 20
#: Where PyTorch has the four gates of an LSTM, among those of ONNX.
_GATES = [0, 2, 3, 1]
#: Largest difference of actions between a file and what was read of it.
_TOLERANCE = 1e-5
_NOT_OURS = "holds no network of agents.dagger, agents.gradient or agents.evolution"


@runs.options
@dataclass(frozen=True)
class Hyperparameters(Checked):
    """Hyperparameters."""

    start: str = design(
        "",
        "-",
        "folder of a policy whose last layer is searched, made by agents.dagger, agents.gradient or agents.evolution; "
        "none: a new, random one",
    )
    lstm: Whole = design(0, "-", "of a new policy: width of its LSTM; 0: none", 0, 10_000)
    hidden: Widths = design((), "-", "of a new policy: widths of hidden layers; none and no LSTM: linear", 1, 10_000)
    population: Whole = design(20, "-", "candidates of a generation", 4, 10_000)
    spread: float = design(0.02, "-", "standard deviation of the first candidates' weights", 1e-6, 100.0)


def read_policy(folder: Path, settings: RunSettings) -> GradientPolicy:
    """Return the network of a policy that agents.dagger, agents.gradient or this has made for every group alike.

    A ValueError says that it is another one, or acts on another law or in another mode than the settings say.
    """
    entry = load_entry_folder(folder)
    for name in ("action_mode", "observation_mode", "strategy"):
        if getattr(entry, name) != getattr(settings, name):
            raise ValueError(f"{folder} has {name} = {getattr(entry, name)!r}, not {getattr(settings, name)!r}")
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


class Population:
    """Candidates that play the same training scenarios side by side."""

    def __init__(self, settings: EnvSettings, n_scenarios: int, n_candidates: int) -> None:
        self.batch = EnvBatch(replace(settings, reward="cost"), n_scenarios * n_candidates)
        self._shape = n_candidates, n_scenarios

    def objectives(self, policy: GradientPolicy, candidates: Floats, scenarios: Sequence[Scenario]) -> Floats:
        """Return what the score pays each candidate for lowering, mean over the scenarios (n_candidates,).

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
        values: Floats = (np.log(costs + offsets) / (batch.suite.task.scale or 1.0)).mean(axis=1)
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
    def n_generations(self) -> int:
        """How many generations it has been told of."""
        return int(self._search.countiter)

    @property
    def mean(self) -> Floats:
        """Mean of the distribution that candidates are drawn from: it generalises better than the luckiest of them."""
        return np.array(self._search.result.xfavorite)


class EvolutionLearner:
    """A policy and the search for its last layer; `make` is called for a new run alone."""

    def __init__(self, make: Callable[[], GradientPolicy], seed: int, h: Hyperparameters) -> None:
        self._make, self._seed, self._h = make, seed, h

    @cached_property
    def network(self) -> GradientPolicy:
        """The policy."""
        network = self._make()
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
        return Search(self.average, self._h.spread, self._h.population, self._seed)

    def tell(self, candidates: Floats, objectives: Floats) -> None:
        """Learn what candidates are worth."""
        self.search.tell(candidates, objectives)
        self.average += (self.search.mean - self.average) / min(self.search.n_generations, _AVERAGED)
        nn.utils.vector_to_parameters(torch.from_numpy(self.average).float(), self.network.last.parameters())

    def save(self, folder: Path) -> None:
        """Write everything that training goes on from into an empty folder."""
        (folder / _STATE).write_bytes(pickle.dumps((self.network, self.average, self.search)))

    def load(self, folder: Path) -> None:
        """Go back to what :meth:`save` wrote; a ValueError names a folder that is damaged."""
        with runs.loading(folder) as folder:
            self.network, self.average, self.search = pickle.loads((folder / _STATE).read_bytes())


def rounds(settings: RunSettings, h: Hyperparameters) -> runs.Rounds:
    """Return the learner of a run, and its rounds."""
    runs.require_local(settings)
    if h.start and (h.hidden or h.lstm):
        raise ValueError("--start brings its own layers; leave out --hidden and --lstm")
    population = Population(EnvSettings(**settings.env_arguments), settings.n_envs, h.population)
    batch = population.batch

    def make() -> GradientPolicy:
        if h.start:
            return read_policy(Path(h.start), settings)
        return GradientPolicy(batch.n_observation // batch.n_wtg, batch.n_action // batch.n_wtg, h.hidden, h.lstm)

    learner = EvolutionLearner(make, settings.seed, h)

    def learn(scenarios: Sequence[Scenario], _rng: np.random.Generator, index: int, n_generations: int) -> float:
        candidates = learner.search.ask()
        objectives = population.objectives(learner.network, candidates, scenarios)
        learner.tell(candidates, objectives)
        return float(objectives.mean())

    return runs.Rounds(learner, batch, batch.n_steps_of_episode * settings.n_envs * h.population, learn)


main = runs.main_in_rounds(
    "evolution",
    "Search the last layer of a policy by evolution, on the score itself.",
    Hyperparameters,
    rounds,
    timesteps=32_400_000,
    n_envs=90,
)

if __name__ == "__main__":
    sys.exit(main())
