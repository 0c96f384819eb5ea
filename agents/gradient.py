"""`python -m agents.gradient`: trains a policy by back-propagation through whole episodes of the environment itself.

The gradients are those of wtg_gym.gradients. Nothing is explored and no value function is learned: Adam lowers the mean
over training scenarios of log(cost + J0), which the score rewards. Failures by slow rotors or low frequency are steps
without a gradient: in the loss they come gradually.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents.command import (
    Parser,
    Progress,
    add_folder_options,
    add_training_options,
    given_options,
    opened_run,
    run_command,
    settings_of,
)
from agents.folders import CHECKPOINTS, folders, loading
from agents.onnx_graph import PolicyNetwork, flat_layers
from agents.runs import Run, RunSettings
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.task_records import CostTerms
from wtg_gym.evaluation.score import COST_OFFSET, pinned_cost
from wtg_gym.gradients.torch import TorchEpisodes
from wtg_gym.physics.scenario import Scenario

#: The algorithm's name in run.json.
NAME = "gradient"
_WEIGHTS, _STATE = "weights.pt", "state.pt"
_TIMESTEPS, _N_ENVS = 1_920_000, 32
_FAILURE = CostTerms._fields.index("failure")
#: How gradually a failure comes, in rotor speed and in frequency [p.u.].
ROTOR_SPREAD_PU, FREQUENCY_SPREAD_PU = 0.02, 0.001


@dataclass(frozen=True)
class Hyperparameters:
    """Hyperparameters; the learning rate falls along half a cosine to `last_rate` of it."""

    hidden: Sequence[int] = (64, 64)
    lstm: int = 0
    loss: str = "log"
    failures: str = "gradual"
    learning_rate: float = 1e-2
    last_rate: float = 0.05
    betas: Sequence[float] = (0.9, 0.99)
    max_grad_norm: float = 1.0

    def __post_init__(self) -> None:
        if any(type(width) is not int or width < 1 for width in self.hidden):
            raise ValueError(f"hidden must be positive whole numbers, got {list(self.hidden)}")
        if type(self.lstm) is not int or self.lstm < 0:
            raise ValueError(f"lstm must be a whole number, 0 for none, got {self.lstm!r}")


class GradientPolicy(nn.Module):
    """An LSTM, if its width is not zero, then tanh layers to the actions; one layer alone is linear up to its tanh."""

    def __init__(self, n_observation: int, n_action: int, hidden: Sequence[int] = (), lstm: int = 0) -> None:
        super().__init__()
        self.n_observation = n_observation
        self.lstm = nn.LSTM(n_observation, lstm) if lstm else None
        widths = [lstm or n_observation, *hidden, n_action]
        layers = [nn.Linear(n_in, n_out) for n_in, n_out in itertools.pairwise(widths)]
        for layer in layers:
            # The last layer starts almost at zero, which is the reference controller.
            nn.init.orthogonal_(layer.weight, 0.01 if layer is layers[-1] else 1.0)
            nn.init.zeros_(layer.bias)
        # Tanh at the end too: a clipped action would have no gradient to come back by.
        self.layers = nn.Sequential(*(module for layer in layers for module in (layer, nn.Tanh())))

    def forward(self, observations: Tensor, state: Any = None) -> tuple[Tensor, Any]:
        """Return the actions (n_lanes, n_action) and the state of the LSTM, which is None before the first step."""
        seen = observations
        if self.lstm is not None:
            (seen,), state = self.lstm(seen[None], state)
        return self.layers(seen), state

    @torch.no_grad()
    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), state), in the manner of Stable-Baselines3."""
        if state is not None and episode_start is not None:
            goes_on = torch.as_tensor(~np.asarray(episode_start, dtype=np.bool_), dtype=torch.float32)[:, None]
            state = tuple(part * goes_on for part in state)
        actions, state = self(torch.as_tensor(observation, dtype=torch.float32), state)
        return actions.numpy(), state

    def network(self) -> PolicyNetwork:
        """Return the policy for the export."""
        return PolicyNetwork(self.n_observation, None, lstm=self.lstm, layers=flat_layers([self.layers]))


class Failures:
    """Costs in which failures by slow rotors or low frequency come gradually.

    A logistic function of the least rotor speed and of the least frequency takes an episode's cost towards that of a
    failed one in the score. It is 0.5 a spread above the limit of the protection, and 0.73 at the limit. Failures of
    other kinds keep their constant charge.
    """

    def __init__(self, episodes: TorchEpisodes) -> None:
        settings = episodes.tape.lanes.settings
        protection, cap = settings.plant().protection, settings.cost_weights().cap
        frequency = (protection.frequency_min_pu, FREQUENCY_SPREAD_PU)
        rotor = (protection.rotor_speed_min_pu, ROTOR_SPREAD_PU)
        watched = {
            index: frequency if name == "frequency_pu" else rotor
            for index, name in enumerate(episodes.tape.output_names)
            if name == "frequency_pu" or name.startswith("rotor")
        }
        self._columns = list(watched)
        self._limits, self._spreads = torch.tensor(list(watched.values()), dtype=torch.float64).T
        self._cost = pinned_cost(0.0, failed=True, duration_s=settings.episode_duration_s(), cap=cap)

    def watched(self, outputs: Tensor) -> Tensor:
        """Return the outputs that failures depend on, (n_lanes, n), of all outputs of a step."""
        return outputs[:, self._columns]

    def costs(self, terms: Tensor, least: Tensor) -> Tensor:
        """Return costs (n_lanes,), from the sums of their terms and the least of what is watched (n_lanes, n)."""
        survives = torch.sigmoid((least - self._limits) / self._spreads - 1.0).prod(dim=1)
        charge = terms[:, _FAILURE]
        spent = terms.sum(dim=1) - torch.where(survives < 0.5, charge, 0.0)
        return survives * spent + (1.0 - survives) * self._cost


def costs_of(
    episodes: TorchEpisodes,
    policy: GradientPolicy,
    scenarios: Sequence[Scenario],
    n_steps: int,
    failures: Failures | None = None,
) -> Tensor:
    """Return what the first steps of a scenario in every lane cost (n_lanes,), by `failures` if they are given."""
    observations = episodes.start(scenarios)
    state, spent, watched = None, [], []
    for _ in range(n_steps):
        actions, state = policy(observations, state)
        observations, terms = episodes.step(actions)
        spent.append(terms)
        if failures is not None:
            watched.append(failures.watched(episodes.outputs))
    costs = torch.stack(spent).sum(dim=0)
    if failures is None:
        return costs.sum(dim=1)
    return failures.costs(costs, torch.stack(watched).amin(dim=0))


def descend(policy: nn.Module, optimizer: torch.optim.Optimizer, costs: Tensor, h: Hyperparameters) -> float:
    """Take one step of the optimiser against what episodes cost, and return the loss before it."""
    loss = torch.log(costs + COST_OFFSET).mean() if h.loss == "log" else costs.mean()
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(policy.parameters(), h.max_grad_norm)
    optimizer.step()
    return loss.item()


def train(run: Run, folder: Path, h: Hyperparameters) -> None:
    """Train from the last checkpoint, if there is one, to the end; checkpoints and run.json go to `folder`."""
    if run.finished:
        return
    settings = run.settings
    # One thread, so that sums do not depend on which thread ends first; more would only wait for each other.
    torch.set_num_threads(1)
    torch.manual_seed(settings.seed)
    episodes = TorchEpisodes(EnvSettings(**settings.env_arguments), settings.n_envs)
    lanes = episodes.tape.lanes
    failures = Failures(episodes) if h.failures == "gradual" else None
    policy = GradientPolicy(lanes.n_observation, lanes.n_action, h.hidden, h.lstm)
    optimizer = torch.optim.Adam(policy.parameters(), lr=h.learning_rate, betas=(h.betas[0], h.betas[1]))
    n_steps = round(lanes.duration_s / lanes.settings.control_dt)
    per_batch = n_steps * settings.n_envs
    n_batches, first = -(-settings.timesteps // per_batch), 0
    if saved := folders(folder / CHECKPOINTS):
        first = int(saved[-1].name) // per_batch
        load_state(saved[-1], policy, optimizer)
    run.write(folder)
    began = time.monotonic() - (run.curve[-1]["wall_time_s"] if run.curve else 0.0)
    with Progress("batches") as progress:
        for index in range(first, n_batches + 1):
            steps, run.finished = index * per_batch, index == n_batches
            if run.is_due(steps) or run.finished:
                run.validate(policy, steps, time.monotonic() - began)
                run.keep(folder, lambda path: save(path, policy), lambda path: save_state(path, policy, optimizer))
            if not run.finished:
                fallen = 0.5 + 0.5 * math.cos(math.pi * index / n_batches)
                optimizer.param_groups[0]["lr"] = h.learning_rate * (h.last_rate + (1.0 - h.last_rate) * fallen)
                # A generator of its own for each batch: a resumed run draws what an undisturbed one would have drawn.
                rng = np.random.default_rng((settings.seed, index))
                costs = costs_of(episodes, policy, lanes.draw([rng] * settings.n_envs), n_steps, failures)
                loss = descend(policy, optimizer, costs, h)
                name = f"loss {loss:.3f}, score {run.curve[-1]['score']:.1f}"
                progress.update(name, index + 1 - first, n_batches - first)


def save_state(folder: Path, policy: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    torch.save({"policy": policy.state_dict(), "optimizer": optimizer.state_dict()}, folder / _STATE)


def load_state(folder: Path, policy: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Set policy and optimiser to those that :func:`save_state` wrote.

    Raises:
        ValueError: the file is missing or damaged; the message names it.
    """
    with loading(folder / _STATE):
        state = torch.load(folder / _STATE, weights_only=True)
        policy.load_state_dict(state["policy"])
        optimizer.load_state_dict(state["optimizer"])


def save(folder: Path, policy: GradientPolicy) -> None:
    torch.save(policy.state_dict(), folder / _WEIGHTS)


def load(folder: Path) -> GradientPolicy:
    """Return the policy of a folder that :func:`save` wrote; no code in it is run.

    Raises:
        ValueError: the file is missing or damaged; the message names it.
    """
    with loading(folder / _WEIGHTS):
        weights: Mapping[str, Tensor] = torch.load(folder / _WEIGHTS, weights_only=True)
        shapes = [value.shape for key, value in weights.items() if key.endswith("weight")]
        n_observation, lstm = shapes[0][1], 0
        if "lstm.weight_ih_l0" in weights:
            gates, n_observation = weights["lstm.weight_ih_l0"].shape
            lstm = gates // 4
        policy = GradientPolicy(n_observation, shapes[-1][0], [shape[0] for shape in shapes[:-1]], lstm)
        policy.load_state_dict(weights)
        return policy


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.gradient", description=__doc__)
    add_training_options(parser, timesteps=str(_TIMESTEPS))
    parser.add_argument("--n-envs", type=int, metavar="N", help=f"episodes per gradient (default: {_N_ENVS})")
    parser.add_argument(
        "--hidden",
        type=int,
        nargs="*",
        metavar="N",
        help="widths of the hidden layers; --hidden alone: no hidden layer (default: 64 64)",
    )
    parser.add_argument(
        "--lstm", type=int, metavar="N", help="width of an LSTM in front of the hidden layers (default: 0, none)"
    )
    parser.add_argument("--loss", choices=("log", "mean"), help="mean of log(cost + J0) or of the cost (default: log)")
    parser.add_argument(
        "--failures",
        choices=("gradual", "charged"),
        help="in the loss: gradual, or a constant charge (default: gradual)",
    )
    add_folder_options(parser)

    def work() -> None:
        given = given_options(parser.parse_args(argv))

        def settings() -> RunSettings:
            h = Hyperparameters(**{key: given[key] for key in ("hidden", "lstm", "loss", "failures") if key in given})
            n_envs = given.get("n_envs", _N_ENVS)
            return settings_of(given, NAME, dataclasses.asdict(h), timesteps=_TIMESTEPS, n_envs=n_envs)

        with opened_run(given, (NAME,), settings) as (run, folder):
            train(run, folder, Hyperparameters(**run.settings.hyperparameters))

    return run_command(work, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
