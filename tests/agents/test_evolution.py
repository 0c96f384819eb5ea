"""Facts about training by evolution: it begins at the law, repeats, goes on after an interruption, and is exported."""

import pickle

import numpy as np
import pytest
import torch

from agents.evolution import EvolutionLearner, GroupPolicy, Hyperparameters, Population, main
from agents.run import folders
from tests.agents.small import largest_difference, run_and_interrupted_run
from tests.interruption import interrupted
from wtg_gym.envs import EnvSettings
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.policies.torch_export import TorchPolicy, onnx_bytes
from wtg_gym.tasks import V1

#: Four generations, the last two of all weights, with a validation before, between and after them.
OPTIONS = ["--suite", "standard", "--n-envs", "2", "--population", "4", "--hidden", "3"]
OPTIONS += ["--timesteps", "19200", "--interval", "9600", "--validation-episodes", "2"]


def policy_of(hidden: int, history: bool = True) -> GroupPolicy:
    return GroupPolicy(n_wtg=4, n_own=8, n_action=2, hidden=hidden, control_dt=0.1, history=history)


def test_training_begins_at_the_law():
    policy = policy_of(5)
    learner = EvolutionLearner(policy, 0, Hyperparameters(hidden=5))
    actions, _, started = policy(torch.rand(7, 32))
    assert learner.weights.any() and not actions.any() and started.all()


def test_groups_are_alike_and_slow_copies_follow_their_time_constants():
    policy = policy_of(4)
    policy.weights.copy_(torch.from_numpy(np.random.default_rng(0).normal(size=policy.n_parameters)))
    seen = torch.rand(3, 4, 8)
    actions, slow, started = policy(seen.reshape(3, 32))
    assert slow.reshape(3, 4, 5) == pytest.approx(seen[..., [0, 0, 2, 2, 3]])
    turned, *_ = policy(seen.roll(1, dims=1).reshape(3, 32))
    assert turned.reshape(3, 4, 2) == pytest.approx(actions.reshape(3, 4, 2).roll(1, dims=1).numpy(), abs=1e-5)
    # 10 s later a step has come through by 1 - 1/e in the copy with that time constant.
    for _ in range(100):
        _, slow, started = policy(seen.reshape(3, 32) + 1.0, slow, started)
    moved = slow.reshape(3, 4, 5)[..., 1] - seen[..., 0]
    assert moved.numpy() == pytest.approx(1.0 - np.exp(-1.0), abs=1e-5)


def test_without_history_and_units_a_policy_is_a_linear_feedback():
    policy, gains = policy_of(0, history=False), np.random.default_rng(0).normal(size=(9, 2)).astype(np.float32)
    policy.weights.copy_(torch.from_numpy(gains.ravel()))
    seen = torch.rand(3, 4, 8)
    (actions,) = policy(seen.reshape(3, 32))
    assert actions.reshape(3, 4, 2).numpy() == pytest.approx(seen.numpy() @ gains[:8] + gains[8], abs=1e-5)


@pytest.mark.parametrize("history", [False, True])
def test_a_policy_without_units_is_exported(history):
    assert onnx_bytes(policy_of(0, history), 32, 8, tolerance=1e-4)


def test_what_is_lowered_is_minus_the_score_in_hundreds_and_what_the_mark_asks():
    settings = EnvSettings(version="v1", duration_s=40.0)
    plain, weighed = (
        Population(settings, 3, 4, Hyperparameters(population=4, mean_weight=w, mark_weight=w)) for w in (0.0, 1.0)
    )
    policy, scenarios = policy_of(0), plain.lanes.scenarios(range(1_000_057, 1_000_060))
    result = [each.objectives(policy, np.zeros((4, policy.n_parameters)), scenarios) for each in (plain, weighed)]
    costs = plain.lanes.cost_sums().sum(axis=1)[:3]
    strata = [plain.lanes.suite.stratum(scenario.seed or 0) for scenario in scenarios]
    offsets, scale = np.array([{"ample": 40.0, "tight": 200.0, "short": 1000.0}[name] for name in strata]), V1.scale
    assert result[0] == pytest.approx(np.mean(np.log(costs + offsets) / scale))
    extremes = [weighed.lanes.simulator.lane_values(name)[:3] for name in ("coi_min", "coi_max")]
    largest_hz = 50.0 * np.abs(np.array(extremes) - 1.0).max(axis=0)
    bad = np.clip((largest_hz - 0.6) / 0.3, 0.0, 1.0)
    assert result[1] - result[0] == pytest.approx(np.mean(costs / offsets / scale + bad)) and bad.any()


def test_run_repeats_also_after_an_interruption_and_is_exported(tmp_path):
    def interrupt(patch, when):
        patch.setattr(EvolutionLearner, "tell", interrupted(EvolutionLearner.tell, when))

    runs = run_and_interrupted_run(main, OPTIONS, interrupt, tmp_path)
    saved = [folders(run.folder / "checkpoints")[0] / "state.pickle" for run in runs]
    weights = [pickle.loads(path.read_bytes())[1] for path in saved]
    assert np.array_equal(*weights) and weights[0][-3:].any()  # direct ones, which begin at 0
    (entry,) = load_entries(tmp_path / "entry")
    policy = GroupPolicy(n_wtg=2, n_own=10, n_action=2, hidden=3, control_dt=0.1)
    policy.weights.copy_(torch.from_numpy(weights[0]))
    assert largest_difference(TorchPolicy(policy), entry.policy, runs[0].settings) <= 1e-6


def test_widths_are_checked(tmp_path, capsys):
    assert main(["--population", "3", "--output", str(tmp_path / "run")]) == 2
    assert "population must be a whole number in 4 … 10000, got 3" in capsys.readouterr().err
