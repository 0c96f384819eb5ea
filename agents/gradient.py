"""`python -m agents.gradient`: trains a policy by back-propagation through whole episodes of the environment itself.

The gradients are those of wtg_gym.gradients. Nothing is explored and no value function is learned: Adam lowers what the
score pays, the mean over training scenarios of ln(J + J0), in every stratum in units of its Λ, and if you like the mean
cost besides, which the worst scenarios decide. Failures by slow rotors or low frequency are steps without a gradient:
in the loss they come gradually.
"""

import itertools
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from cyclopts import Parameter
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from agents import run as runs
from agents.run import RunSettings, Whole, Widths
from wtg_gym.envs import EnvSettings
from wtg_gym.evaluation.score import failure_cost
from wtg_gym.gradients.torch import TorchEpisodes
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import Checked, design
from wtg_gym.scenarios import Suite
from wtg_gym.tasks.cost import CostTerms

_FAILURE = CostTerms._fields.index("failure")
#: How gradually a failure comes, in rotor speed and in frequency [p.u.].
ROTOR_SPREAD_PU, FREQUENCY_SPREAD_PU = 0.02, 0.001
#: How long the loss of a group or of a stage's load counts in the gradient [s].
AFTERWARDS_S = 60.0
#: Largest gradient of an episode's loss with respect to an action; that of a few seconds before a trip would outweigh
#: all others.
MAX_ACTION_GRADIENT = 0.03
#: Weight in the loss of actions where the gradient knows nothing.
STRAY_WEIGHT = 5.0


@runs.options
@dataclass(frozen=True)
class Hyperparameters(Checked):
    """Hyperparameters; the learning rate falls along half a cosine to `last_rate` of it."""

    hidden: Widths = design((64, 64), "-", "widths of the hidden layers, or none", 1, 10_000)
    lstm: Whole = design(0, "-", "width of an LSTM in front of the layers; 0: none", 0, 10_000)
    learning_rate: float = design(1e-2, "-", "of Adam at the start", 0.0, 10.0)
    last_rate: float = design(0.05, "-", "of the learning rate, at the end", 0.0, 1.0)
    betas: Annotated[tuple[float, float], Parameter(negative="")] = design((0.9, 0.99), "-", "of Adam", 0.0, 1.0)
    max_grad_norm: float = design(1.0, "-", "largest norm of a gradient", 0.0, 1e6)
    mean_weight: float = design(0.0, "-", "weight of J / J0 in the loss, beside ln(J + J0)", 0.0, 100.0)
    averaged: Whole = design(30, "-", "updates that the exported weights are averaged over, exponentially", 1, 100_000)
    per_group: Annotated[bool, Parameter(negative="")] = design(
        False, "-", "the policy sees one group at a time, and plays any grid"
    )


class GradientPolicy(nn.Module):
    """An LSTM, if its width is not zero, then tanh layers to the actions; one layer alone is linear up to its tanh.

    It looks at the first `n_observation` entries of an observation.
    """

    def __init__(self, n_observation: int, n_action: int, hidden: Sequence[int] = (), lstm: int = 0) -> None:
        super().__init__()
        #: Whether it answers for one group at a time.
        self.per_group = False
        self._n_observation = n_observation
        self.lstm = nn.LSTM(n_observation, lstm) if lstm else None
        widths = [lstm or n_observation, *hidden, n_action]
        layers = [nn.Linear(n_in, n_out) for n_in, n_out in itertools.pairwise(widths)]
        for layer in layers:
            # The last layer starts almost at zero, which is the reference controller.
            nn.init.orthogonal_(layer.weight, 0.01 if layer is layers[-1] else 1.0)
            nn.init.zeros_(layer.bias)
        # Tanh at the end too: a clipped action would have no gradient to come back by.
        self.layers = nn.Sequential(*(module for layer in layers for module in (layer, nn.Tanh())))
        #: Widths of the states: hidden and cell of the LSTM.
        self.state_widths = (lstm, lstm) if lstm else ()

    @property
    def last(self) -> nn.Linear:
        """The last layer, before its tanh."""
        layer = self.layers[-2]
        assert isinstance(layer, nn.Linear)
        return layer

    def features(self, observations: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        """Return what the last layer sees (num_envs, n) and the next states; none are given before the first step."""
        observations = observations[:, : self._n_observation]
        if self.lstm is None:
            return (self.layers[:-2](observations),)
        before = tuple(state[None] for state in states) or None
        (seen,), (hidden, cell) = self.lstm(observations[None], before)
        return self.layers[:-2](seen), hidden[0], cell[0]

    def forward(self, observations: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        """Return the actions (num_envs, n_action) and the next states."""
        features, *following = self.features(observations, *states)
        return (self.layers[-2:](features), *following)

    def of_episodes(self, observations: Tensor) -> Tensor:
        """Return the actions of whole episodes (n_steps, num_envs, n_action), from their observations."""
        observations = observations[..., : self._n_observation]
        actions: Tensor = self.layers(observations if self.lstm is None else self.lstm(observations)[0])
        return actions


class Failures:
    """Costs in which failures by slow rotors or low frequency, and load shedding, come gradually.

    A logistic function of the least rotor speed and of the least frequency takes an episode's cost towards that of a
    failed one in the score. It is 0.5 a spread above the limit of the protection, and 0.73 at the limit. A slow rotor
    that disconnects its group alone, and every stage of load shedding, leave the cost as it is and add to its gradient:
    what the capped terms cost at their cap, or what the stage's load costs, for a while. Failures of other kinds keep
    their constant charge.
    """

    def __init__(self, episodes: TorchEpisodes) -> None:
        settings = episodes.tape.batch.settings
        plant, weights = settings.resolved_plant, settings.cost_weights()
        names = list(episodes.tape.output_names)
        ends = [(names.index("frequency_pu"), plant.protection.frequency_min_pu, FREQUENCY_SPREAD_PU)]
        rotor = plant.protection.rotor_speed_min_pu, ROTOR_SPREAD_PU
        rotors = [(index, *rotor) for index, name in enumerate(names) if name.startswith("rotor")]
        stages = [(ends[0][0], stage.frequency_pu, FREQUENCY_SPREAD_PU) for stage in plant.shedding]
        open_ended, trips = settings.task.failure_costs_whole_episode, plant.trips_groups
        adding = [*(rotors if trips else ()), *(stages if open_ended else ())]
        charges = [weights.cap * AFTERWARDS_S] * (trips * len(rotors))
        charges += [weights.unserved * stage.share * AFTERWARDS_S for stage in plant.shedding] * open_ended
        if not trips:
            ends += rotors
        self._n_ends, self._charges = len(ends), torch.tensor(charges, dtype=torch.float64)
        columns, limits, spreads = zip(*ends, *adding, strict=True)
        self._columns = list(columns)
        self._limits, self._spreads = (torch.tensor(values, dtype=torch.float64) for values in (limits, spreads))
        rate = weights.failure if open_ended else weights.cap
        self._cost = failure_cost(settings.episode_duration_s(), rate)

    def watched(self, outputs: Tensor) -> Tensor:
        """Return the outputs that failures depend on, (num_envs, n), of all outputs of a step."""
        return outputs[:, self._columns]

    def costs(self, terms: Tensor, least: Tensor) -> Tensor:
        """Return costs (num_envs,), from the sums of their terms and the least of what is watched (num_envs, n)."""
        safe = torch.sigmoid((least - self._limits) / self._spreads - 1.0)
        survives, keeps = safe[:, : self._n_ends].prod(dim=1), safe[:, self._n_ends :]
        spent = terms.sum(dim=1) - torch.where(survives < 0.5, terms[:, _FAILURE], 0.0)
        added = ((1.0 - keeps) * self._charges).sum(dim=1)
        spent = spent + added - added.detach()
        return survives * spent + (1.0 - survives) * self._cost


def costs_of(
    episodes: TorchEpisodes, policy: GradientPolicy, scenarios: Sequence[Scenario], n_steps: int, failures: Failures
) -> tuple[Tensor, Tensor]:
    """Return what the first steps of a scenario in every environment cost, and how far actions stray (num_envs,).

    Where load is shed, a little support more only puts that off. The gradient knows no timing and would mislead: there
    costs have none, and what strays is the mean square of the actions, which begin at the law's.
    """
    observations = episodes.start(scenarios)
    states, spent, watched, most = list[Tensor](), [], [], MAX_ACTION_GRADIENT / len(scenarios)
    served, strays = torch.ones(len(scenarios), dtype=torch.bool), torch.zeros(len(scenarios))
    n_rows = len(scenarios) * (episodes.tape.batch.n_wtg if policy.per_group else 1)
    for _ in range(n_steps):
        answer, *states = policy(observations.reshape(n_rows, -1), *states)
        actions = answer.reshape(len(scenarios), -1)
        actions.register_hook(lambda gradient: gradient.clamp(-most, most))
        observations, terms = episodes.step(actions)
        strays = strays + torch.where(served, 0.0, actions.square().mean(dim=1)) / n_steps
        served = served & (terms.detach()[:, _FAILURE] == 0.0)
        spent.append(torch.where(served[:, None], terms, terms.detach()))
        watched.append(failures.watched(episodes.outputs))
    return failures.costs(torch.stack(spent).sum(dim=0), torch.stack(watched).amin(dim=0)), strays


def loss_of(costs: Tensor, suite: Suite, scenarios: Sequence[Scenario], mean_weight: float = 0.0) -> Tensor:
    """Return what the score pays for, to be lowered: the mean over scenarios of ln(J + J0), in units of Λ."""
    offsets = torch.tensor([suite.cost_offset(scenario) for scenario in scenarios], dtype=costs.dtype)
    loss = torch.log(costs + offsets) + mean_weight * costs / offsets
    return loss.mean() / (suite.task.scale or 1.0)


def descend(policy: nn.Module, optimizer: torch.optim.Optimizer, loss: Tensor, max_grad_norm: float) -> float:
    """Take one step of the optimiser against a loss, and return the loss before it."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(policy.parameters(), max_grad_norm)
    optimizer.step()
    return loss.item()


class GradientLearner(runs.RoundLearner):
    """A policy, its average and its optimiser."""

    def __init__(self, settings: RunSettings, h: Hyperparameters) -> None:
        if h.per_group:
            runs.require_local(settings)
        self._h, self._episodes = h, TorchEpisodes(EnvSettings(**settings.env_arguments), settings.n_envs)
        self._failures, self.batch = Failures(self._episodes), self._episodes.tape.batch
        self.timesteps = self.batch.n_steps_of_episode * settings.n_envs
        n_parts = self.batch.n_wtg if h.per_group else 1
        widths = self.batch.n_observation // n_parts, self.batch.n_action // n_parts
        self.policy = policy = GradientPolicy(*widths, h.hidden, h.lstm)
        policy.per_group = h.per_group
        #: Every update pulls towards its own scenarios; their average does not.
        mean: Callable[..., None] = get_ema_multi_avg_fn(1.0 - 1.0 / h.averaged)  # type: ignore[no-untyped-call]
        self.average = AveragedModel(policy, multi_avg_fn=mean)
        self.network = self.average.module
        self.optimizer = torch.optim.Adam(policy.parameters(), lr=h.learning_rate, betas=(h.betas[0], h.betas[1]))
        self.parts = {"policy": policy, "average": self.average, "optimizer": self.optimizer}

    def learn(self, scenarios: Sequence[Scenario], rng: np.random.Generator, index: int, n_rounds: int) -> float:
        h, batch, fallen = self._h, self.batch, 0.5 + 0.5 * math.cos(math.pi * index / n_rounds)
        self.optimizer.param_groups[0]["lr"] = h.learning_rate * (h.last_rate + (1.0 - h.last_rate) * fallen)
        costs, strays = costs_of(self._episodes, self.policy, scenarios, batch.n_steps_of_episode, self._failures)
        loss = loss_of(costs, batch.suite, scenarios, h.mean_weight) + STRAY_WEIGHT * strays.mean()
        value = descend(self.policy, self.optimizer, loss, h.max_grad_norm)
        self.average.update_parameters(self.policy)
        return value


main = runs.main_in_rounds(
    "gradient",
    "Train a policy by back-propagation through whole episodes of the environment itself.",
    Hyperparameters,
    GradientLearner,
    timesteps=1_920_000,
    n_envs=32,
)

if __name__ == "__main__":
    sys.exit(main())
