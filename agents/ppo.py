"""`python -m agents.ppo`: PPO from top to bottom in one file, for changing the algorithm itself.

The objective is that of Schulman et al., "Proximal Policy Optimization Algorithms", 2017; torch is all it needs.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.command import Parser, Progress, add_training_options, given_options, opened_run, run_command, settings_of
from agents.folders import loading
from agents.gains import Gains, stagger
from agents.onnx_graph import Normalization, PolicyNetwork, flat_layers, normalized
from agents.runs import Run, RunSettings
from wtg_gym.envs import GFMWTGVectorEnv

#: The algorithm's name in run.json.
NAME = "single_file_ppo"
_WEIGHTS = "weights.pt"
_CLIP = 10.0
_TIMESTEPS, _N_ENVS = 3_000_000, 512


@dataclass(frozen=True)
class Hyperparameters:
    """Hyperparameters; sizes are those of configs/ppo.yml.

    The noise there is held for seconds. Here it is drawn anew at every step, which keeps the file short and asks for a
    discount that looks 7 s ahead and for larger steps. A million steps reach a validation score of about 105.
    """

    n_steps: int = 150  # steps per lane in an update
    n_minibatches: int = 8  # parts of them, each learned from in turn
    n_epochs: int = 5  # times that each part is learned from
    gamma: float = 0.985  # discount per step of 0.1 s
    gae_lambda: float = 0.95  # decay of the advantage estimate
    learning_rate: float = 1e-3  # at the start; it falls linearly to zero at the last step
    clip_range: float = 0.2  # of the ratio of new to old probability
    max_grad_norm: float = 0.5
    hidden: int = 64  # width of the two layers of tanh in the policy and in the value function
    log_std_init: float = -1.0  # logarithm of the first exploration's standard deviation [full action]


class RunningMoments(nn.Module):
    """Mean and variance of all rows (n, width) seen so far, by the parallel formula of Chan et al.; float64."""

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width, dtype=torch.float64))
        self.register_buffer("var", torch.ones(width, dtype=torch.float64))
        self.register_buffer("count", torch.tensor(1e-4, dtype=torch.float64))

    def update(self, rows: Tensor) -> None:
        n, total = rows.shape[0], self.count + rows.shape[0]
        difference = rows.mean(dim=0) - self.mean
        squares = self.var * self.count + rows.var(dim=0, correction=0) * n + difference**2 * self.count * n / total
        self.mean += difference * n / total
        self.var.copy_(squares / total)
        self.count.copy_(total)

    @property
    def std(self) -> Tensor:
        """Standard deviations (width,), never zero."""
        return torch.sqrt(self.var + 1e-8)


def _network(n_in: int, hidden: int, n_out: int, last_gain: float) -> nn.Sequential:
    first, second, last = nn.Linear(n_in, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, n_out)
    for layer, gain in ((first, 2**0.5), (second, 2**0.5), (last, last_gain)):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(first, nn.Tanh(), second, nn.Tanh(), last)


class Agent(nn.Module):
    """Policy and value function with the normalisation of their observations; `h` gives size and first exploration."""

    def __init__(self, n_observation: int, n_action: int, h: Hyperparameters) -> None:
        super().__init__()
        self.moments = RunningMoments(n_observation)
        # The last layer starts almost at zero, which is the reference controller.
        self.actor = _network(n_observation, h.hidden, n_action, 0.01)
        self.critic = _network(n_observation, h.hidden, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((n_action,), h.log_std_init))

    def normalized(self, observations: Any) -> Tensor:
        return normalized(torch.as_tensor(observations), self.moments.mean, self.moments.std, _CLIP)

    def sample(self, normalized: Tensor) -> Tensor:
        mean: Tensor = self.actor(normalized)
        return mean + self.log_std.exp() * torch.randn_like(mean)

    def log_prob(self, normalized: Tensor, actions: Tensor) -> Tensor:
        # Without the constant.
        distance: Tensor = (actions - self.actor(normalized)) / self.log_std.exp()
        return -(0.5 * distance.square() + self.log_std).sum(-1)

    def value(self, normalized: Tensor) -> Tensor:
        values: Tensor = self.critic(normalized)
        return values.squeeze(-1)

    @torch.no_grad()
    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), state), in the manner of Stable-Baselines3."""
        act = self.actor if deterministic else self.sample
        actions: Tensor = act(self.normalized(observation))
        return actions.clamp(-1.0, 1.0).numpy(), state

    def network(self) -> PolicyNetwork:
        """Return the deterministic policy for the export."""
        mean, std = self.moments.mean.numpy(), self.moments.std.numpy()
        seen = Normalization(mean=mean, std=std, bound=_CLIP)
        return PolicyNetwork(mean.size, seen, lstm=None, layers=flat_layers([self.actor]))


class Batch(NamedTuple):
    """A rollout, the steps of all lanes one after the other: n = n_steps · n_envs rows."""

    observations: Tensor  # (n, n_observation), normalised
    actions: Tensor  # (n, n_action), not clipped
    log_probs: Tensor  # (n,), when they were taken
    advantages: Tensor  # (n,)
    returns: Tensor  # (n,), scaled


class Collector:
    """Plays the lanes and prepares batches to learn from; rewards are :class:`agents.gains.Gains`.

    Lane i starts with seed + i, and resets within the step in which an episode ends, so that no step is a mere reset.
    """

    def __init__(self, envs: GFMWTGVectorEnv, agent: Agent, h: Hyperparameters, seed: int) -> None:
        self._envs, self._agent, self._h = envs, agent, h
        envs.reset(seed=seed)
        self._observations = stagger(envs)
        self._gains = Gains(envs.lanes)
        self._gains.follow(range(envs.num_envs))
        self._returns = torch.zeros(envs.num_envs, dtype=torch.float64)
        self._return_moments = RunningMoments(1)

    @torch.no_grad()
    def rollout(self) -> tuple[Batch, float]:
        """Return a batch, and the mean gain of a step in it [%]."""
        agent, rows, total = self._agent, list[tuple[Tensor, ...]](), 0.0
        for _ in range(self._h.n_steps):
            agent.moments.update(torch.as_tensor(self._observations, dtype=torch.float64))
            seen = agent.normalized(self._observations)
            actions = agent.sample(seen)
            reference_costs = self._gains.reference_costs()
            self._observations, paid, terminated, truncated, infos = self._envs.step(actions.clamp(-1, 1).numpy())
            given = self._gains.of(reference_costs, paid)
            self._gains.follow(np.flatnonzero(terminated | truncated).tolist())
            rewards, done = self._scaled(given, terminated | truncated)
            if truncated.any():
                # Time ran out, the grid goes on: the value function stands for the rest of the episode.
                last = np.stack(infos["final_obs"][truncated])
                rewards[torch.as_tensor(truncated)] += self._h.gamma * agent.value(agent.normalized(last))
            rows.append((seen, actions, agent.log_prob(seen, actions), agent.value(seen), rewards, done))
            total += float(given.mean())
        seen, actions, log_probs, values, rewards, done = map(torch.stack, zip(*rows, strict=True))
        advantages = self._advantages(values, rewards, done, agent.value(agent.normalized(self._observations)))
        columns = (seen, actions, log_probs, advantages, advantages + values)
        return Batch(*(column.flatten(0, 1) for column in columns)), total / self._h.n_steps

    def _scaled(self, rewards: Any, done: Any) -> tuple[Tensor, Tensor]:
        """Return rewards in units of the spread of discounted returns, clipped to ± 10, and done as numbers; (n,)."""
        self._returns = self._returns * self._h.gamma + torch.as_tensor(rewards)
        self._return_moments.update(self._returns[:, None])
        ended = torch.as_tensor(done)
        self._returns[ended] = 0.0
        scaled = torch.as_tensor(rewards) / self._return_moments.std
        return scaled.clamp(-_CLIP, _CLIP).float(), ended.float()

    def _advantages(self, values: Tensor, rewards: Tensor, done: Tensor, last_value: Tensor) -> Tensor:
        """Return the generalised advantage estimates, (n_steps, n_envs) like the arguments."""
        advantages, advantage, following = torch.zeros_like(rewards), torch.zeros_like(last_value), last_value
        for step in reversed(range(rewards.shape[0])):
            goes_on = 1.0 - done[step]
            error = rewards[step] + self._h.gamma * goes_on * following - values[step]
            advantage = error + self._h.gamma * self._h.gae_lambda * goes_on * advantage
            advantages[step], following = advantage, values[step]
        return advantages

    def close(self) -> None:
        self._gains.close()
        self._envs.close()


def update(agent: Agent, optimizer: torch.optim.Optimizer, batch: Batch, h: Hyperparameters) -> float:
    """Improve the agent on a batch and return the value function's mean squared error in the last epoch."""
    errors: list[float] = []
    for _ in range(h.n_epochs):
        for part in torch.randperm(batch.returns.shape[0]).chunk(h.n_minibatches):
            observations, actions, log_probs, advantages, returns = (array[part] for array in batch)
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
            ratio = (agent.log_prob(observations, actions) - log_probs).exp()
            clipped = ratio.clamp(1.0 - h.clip_range, 1.0 + h.clip_range)
            policy_loss = -torch.minimum(ratio * advantages, clipped * advantages).mean()
            value_loss = (agent.value(observations) - returns).square().mean()
            optimizer.zero_grad()
            (policy_loss + value_loss).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(agent.parameters(), h.max_grad_norm)
            optimizer.step()
            errors.append(value_loss.item())
    return float(np.mean(errors[-h.n_minibatches :]))


def train(run: Run, folder: Path, h: Hyperparameters) -> None:
    """Train from start to end; the best policy and run.json go to `folder`."""
    settings = run.settings
    # One thread, so that sums do not depend on which thread ends first.
    torch.set_num_threads(1)
    torch.manual_seed(settings.seed)
    envs = GFMWTGVectorEnv(settings.n_envs, autoreset_mode="SameStep", **settings.env_arguments)
    agent = Agent(envs.lanes.n_observation, envs.lanes.n_action, h)
    optimizer = torch.optim.Adam(agent.parameters(), lr=h.learning_rate, eps=1e-5)
    collector = Collector(envs, agent, h, settings.seed)
    per_rollout = h.n_steps * settings.n_envs
    n_rollouts = -(-settings.timesteps // per_rollout)
    run.write(folder)
    began = time.monotonic()
    with Progress("rollouts") as progress:
        for index in range(n_rollouts + 1):
            steps, run.finished = index * per_rollout, index == n_rollouts
            if run.is_due(steps) or run.finished:
                run.validate(agent, steps, time.monotonic() - began)
                run.keep(folder, lambda path: save(path, agent))
            if not run.finished:
                optimizer.param_groups[0]["lr"] = h.learning_rate * (1.0 - index / n_rollouts)
                batch, gain = collector.rollout()
                error = update(agent, optimizer, batch, h)
                name = f"gain {gain:.4f} % per step, value error {error:.2g}, score {run.curve[-1]['score']:.1f}"
                progress.update(name, index + 1, n_rollouts)
    collector.close()


def save(folder: Path, agent: Agent) -> None:
    torch.save(agent.state_dict(), folder / _WEIGHTS)


def load(folder: Path) -> Agent:
    """Return the agent of a folder that :func:`save` wrote; no code in it is run.

    Raises:
        ValueError: the file is missing or damaged; the message names it.
    """
    with loading(folder / _WEIGHTS):
        return agent_of(torch.load(folder / _WEIGHTS, weights_only=True))


def agent_of(weights: Mapping[str, Tensor]) -> Agent:
    """Return the agent whose `state_dict` has these weights."""
    hidden, n_observation = weights["actor.0.weight"].shape
    agent = Agent(n_observation, weights["log_std"].numel(), Hyperparameters(hidden=hidden))
    agent.load_state_dict(weights)
    return agent


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.ppo", description=__doc__)
    parser.add_argument(
        "--output", required=True, metavar="FOLDER", help="folder of the new run, which cannot go on later"
    )
    add_training_options(parser, timesteps=str(_TIMESTEPS))
    parser.add_argument("--n-envs", type=int, metavar="N", help=f"episodes side by side (default: {_N_ENVS})")

    def work() -> None:
        given, h = given_options(parser.parse_args(argv)), Hyperparameters()

        def settings() -> RunSettings:
            n_envs = given.get("n_envs", _N_ENVS)
            return settings_of(given, NAME, dataclasses.asdict(h), timesteps=_TIMESTEPS, n_envs=n_envs)

        with opened_run(given, (NAME,), settings) as (run, folder):
            train(run, folder, h)

    return run_command(work, "the best policy stays; begin anew in another folder")


if __name__ == "__main__":
    sys.exit(main())
