"""Facts about the search of a last layer by evolution: where it begins and what it lowers."""

from pathlib import Path

import numpy as np
import pytest
import torch

from agents.evolution import EvolutionLearner, Hyperparameters, JoinedPolicy, Population, read_policy
from agents.gradient import GradientPolicy
from agents.run import RunSettings
from tests.agents.small import actions_of
from wtg_gym.envs import EnvSettings
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.policies.torch_export import TorchPolicy, export_onnx
from wtg_gym.tasks import V1
from wtg_gym.tasks.episode import ACTION_MODES

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["dagger-v1-0", "gradient-v1-0"])
def test_search_begins_at_the_policy_of_the_file(name):
    (entry,) = load_entries(ROOT / "agents" / "policies" / name)
    modes = {"action_mode": entry.action_mode, "strategy": "coordinated-free"}
    settings = RunSettings(algo="evolution", hyperparameters={}, timesteps=1, n_envs=1, suite="standard-v1", **modes)
    policy = TorchPolicy(read_policy(ROOT / "agents" / "policies" / name, settings))
    n = 6 + sum(ACTION_MODES[entry.action_mode])
    assert actions_of(policy, n) == pytest.approx(actions_of(entry.policy, n), abs=1e-6)


class Other(torch.nn.Module):
    """What is built alike, but has another function between its layers."""

    def __init__(self) -> None:
        super().__init__()
        self.per_group = True
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(7, 4), torch.nn.ReLU(), torch.nn.Linear(4, 1), torch.nn.Tanh()
        )

    def forward(self, observations):
        return self.layers(observations)


def test_network_with_other_actions_is_refused(tmp_path):
    modes = {"action_mode": "k", "strategy": "coordinated-free"}
    export_onnx(Other(), tmp_path, name="mine", per_group=True, **modes)
    settings = RunSettings(algo="evolution", hyperparameters={}, timesteps=1, n_envs=1, suite="standard-v1", **modes)
    with pytest.raises(ValueError, match=r"holds no single network of .*: its actions are others"):
        read_policy(tmp_path, settings)


def test_joined_policies_begin_at_the_mean_of_theirs_before_the_tanh():
    modes = {"action_mode": "k+tau", "strategy": "coordinated-free"}
    settings = RunSettings(algo="evolution", hyperparameters={}, timesteps=1, n_envs=1, suite="standard-v1", **modes)
    names = ("dagger-v1-0", "gradient-v1-0")  # of k, of k and τ
    policies = [read_policy(ROOT / "agents" / "policies" / name, settings) for name in names]
    of_k, of_both = (np.arctanh(actions_of(TorchPolicy(policy), 8)) for policy in policies)
    joined = np.arctanh(actions_of(TorchPolicy(JoinedPolicy(policies, 2)), 8))
    assert joined[..., :1] == pytest.approx((of_k + of_both[..., :1]) / 2.0, abs=1e-5)
    assert joined[..., 1:] == pytest.approx(of_both[..., 1:] / 2.0, abs=1e-5)


def test_unreliable_candidates_are_charged_besides():
    settings = EnvSettings(version="v1", duration_s=60.0)
    plain, charged = (Population(settings, 3, 4, reliability) for reliability in (0.0, 50.0))
    scenarios = plain.batch.scenarios(range(1_000_056, 1_000_059))
    candidates, policy = np.random.default_rng(0).normal(0.0, 0.1, (4, 18)), GradientPolicy(8, 2)
    candidates[1:, 16] = [-3.0, -1.0, 1.0]  # on k of every group: held back, or spent
    more = charged.objectives(policy, candidates, scenarios) - plain.objectives(policy, candidates, scenarios)
    batch = charged.batch
    lost = batch.ended()[0].reshape(4, 3)
    far = 50.0 * np.abs(batch.simulator.env_values("coi_min") - 1.0).reshape(4, 3)
    certainly = lost | (far > 0.85)
    assert certainly.any() and not certainly.all()
    assert (more >= 0.5 * certainly.mean(axis=1) - 1e-12).all() and (more <= 0.5).all()


def test_what_is_lowered_is_minus_the_score_in_hundreds():
    population = Population(EnvSettings(version="v1", duration_s=40.0), 3, 4)
    batch, policy = population.batch, GradientPolicy(8, 2)
    scenarios = batch.scenarios(range(1_000_057, 1_000_060))
    candidates = np.random.default_rng(0).normal(0.0, 0.1, (4, 18))
    result = population.objectives(policy, candidates, scenarios)
    costs = batch.cost_sums().sum(axis=1).reshape(4, 3)
    strata = [batch.suite.stratum(scenario.seed or 0) for scenario in scenarios]
    offsets = np.array([{"ample": 40.0, "tight": 200.0, "short": 1000.0}[name] for name in strata])
    assert result == pytest.approx(np.mean(np.log(costs + offsets), axis=1) / V1.scale) and np.unique(result).size == 4
    # The first candidate alone, in the same scenarios.
    torch.nn.utils.vector_to_parameters(torch.from_numpy(candidates[0]).float(), policy.last.parameters())
    alone = Population(EnvSettings(version="v1", duration_s=40.0), 3, 1)
    assert alone.objectives(policy, candidates[:1], scenarios) == pytest.approx(result[:1], rel=1e-6)


def test_policy_is_the_mean_of_what_was_found():
    policy = GradientPolicy(4, 1)
    before = policy.last.weight.detach().clone()
    learner = EvolutionLearner(lambda: policy, 0, Hyperparameters(population=6, spread=0.5))
    candidates = learner.search.ask()
    learner.tell(candidates, ((candidates - 1.0) ** 2).sum(axis=1))
    assert learner.average == pytest.approx(learner.search.mean)
    assert policy.last.weight.detach().numpy().ravel() == pytest.approx(learner.average[:4], abs=1e-6)
    assert (policy.last.weight - 1.0).norm().item() < (before - 1.0).norm().item()
