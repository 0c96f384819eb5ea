"""Facts about training by gradients: what it lowers, and in which scenarios."""

import math
from collections import Counter

import numpy as np
import pytest
import torch

from agents.gradient import Failures, GradientPolicy, Hyperparameters, costs_of, descend, loss_of
from agents.run import draw
from wtg_gym import get_suite
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.gradients.torch import TorchEpisodes

V1 = {"version": "v1"}
#: How far an episode has failed at a limit.
SHARE = 1.0 / (1.0 + math.exp(-1.0))


@pytest.mark.parametrize(("hidden", "lstm", "settings"), [((8,), 0, V1), ((), 8, {})])
def test_loss_falls_on_the_scenarios_that_it_is_of(hidden, lstm, settings):
    torch.manual_seed(0)
    episodes = TorchEpisodes(EnvSettings(**{"version": "v0", **settings}), 4, 1)
    batch, failures, h = episodes.tape.batch, Failures(episodes), Hyperparameters(hidden=hidden, lstm=lstm)
    policy = GradientPolicy(batch.n_observation, batch.n_action, hidden, lstm)
    optimizer = torch.optim.Adam(policy.parameters(), lr=h.learning_rate)
    scenarios = batch.scenarios(range(1_000_000, 1_000_004))
    losses, n_steps = [], round(10.0 / batch.settings.step_s)
    for _ in range(10):
        costs, _ = costs_of(episodes, policy, scenarios, n_steps, failures)
        loss = loss_of(costs, batch.suite, scenarios)
        losses.append(descend(policy, optimizer, loss, h.max_grad_norm))
    assert losses[-1] < losses[0] - 0.01


def watched(settings) -> tuple[Failures, torch.Tensor, torch.Tensor, list[str]]:
    """Failures, the terms of an episode that costs 40, outputs far from any limit, and the outputs' names."""
    tape = TorchEpisodes(EnvSettings(**settings), 4, 1)
    names = list(tape.tape.output_names)
    alive = torch.tensor([[40.0] + [0.0] * 6], dtype=torch.float64)
    return Failures(tape), alive, torch.full((1, len(names)), 1.1, dtype=torch.float64), names


@pytest.mark.parametrize(
    ("settings", "name", "limit"),
    [(V1, "frequency_pu", 0.95), ({**V1, "on_failure": "terminate"}, "rotor_1_speed_pu", 0.5)],
)
def test_a_failure_comes_gradually_of_a_slow_rotor_where_rotors_end_the_episode(settings, name, limit):
    failures, alive, outputs, names = watched(settings)
    # A failure of another kind, or load that is not served, keeps its charge.
    charged = alive + torch.tensor([0.0] * 6 + [1000.0], dtype=torch.float64)
    falling = outputs.clone()
    falling[0, names.index(name)] = limit
    for terms in (alive, charged):
        assert failures.costs(terms, failures.watched(outputs)).item() == pytest.approx(terms.sum().item())
        result = failures.costs(terms, failures.watched(falling)).item()
        assert result == pytest.approx(40.0 + SHARE * (250.0 * 181.0 - 40.0))


def test_what_trips_or_is_shed_changes_the_gradient_alone():
    failures, alive, outputs, names = watched(V1)
    stages = EnvSettings(**V1).resolved_plant.shedding

    def slope(distance: float) -> float:
        safe = 1.0 / (1.0 + math.exp(1.0 - distance))
        return safe * (1.0 - safe)

    # A slow rotor: what is capped costs its cap for a minute. The stages shed load, which costs 300/s as a whole.
    at_stages = sum(stage.share * slope((0.98 - stage.frequency_pu) / 0.001) for stage in stages)
    for name, limit, expected in (
        ("rotor_2_speed_pu", 0.5, -15.0 * 60.0 * slope(0.0) / 0.02),
        ("frequency_pu", 0.98, -300.0 * 60.0 * at_stages / 0.001),
    ):
        near = outputs.clone()
        near[0, names.index(name)] = limit
        near.requires_grad_()
        cost = failures.costs(alive, failures.watched(near))
        assert cost.item() == pytest.approx(40.0)
        cost.sum().backward()
        assert near.grad[0, names.index(name)].item() == pytest.approx(expected)


def test_the_loss_counts_every_stratum_by_its_offset_and_all_by_one_scale():
    costs = torch.tensor([30.0, 400.0, 2000.0], dtype=torch.float64)
    suite, v0 = get_suite("standard-v1"), get_suite("standard")
    scenarios = suite.scenarios([1_000_002, 1_000_000, 1_000_001], duration_s=1.0)
    offsets, scale = (40.0, 200.0, 1000.0), suite.task.scale or 1.0
    for weight in (0.0, 0.5):
        parts = [
            (math.log(cost + offset) + weight * cost / offset) / scale
            for cost, offset in zip(costs.tolist(), offsets, strict=True)
        ]
        assert loss_of(costs, suite, scenarios, weight).item() == pytest.approx(sum(parts) / 3.0)
    # v0 has one offset, and no scale.
    own = v0.scenarios([1_000_000], duration_s=1.0)
    assert loss_of(costs[:1], v0, own).item() == pytest.approx(math.log(35.0))


def test_a_batch_of_v1_holds_as_many_of_each_stratum():
    batch = EnvBatch(EnvSettings(**V1, duration_s=1.0), 30)
    scenarios = draw(batch, np.random.default_rng(0), 30)
    strata = Counter(batch.suite.stratum(scenario.seed or 0) for scenario in scenarios)
    assert strata == {"ample": 10, "tight": 10, "short": 10}
    assert all(scenario.seed in batch.suite.train for scenario in scenarios)
    same, other = (draw(batch, np.random.default_rng(seed), 30)[0].seed for seed in (0, 1))
    assert same == scenarios[0].seed != other
