"""Facts about learners: what gradients and evolution lower, and from where; all repeat, and refuse wrong options."""

import functools
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

from agents import dagger, evolution, gradient, planner
from agents.export import export
from agents.gradient import Failures, GradientPolicy, Hyperparameters, costs_of, descend, loss_of
from agents.run import Run, RunSettings, draw, folders
from tests.agents.small import actions_of
from tests.interruption import interrupted
from wtg_gym import get_suite, load_entries, tasks
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.gradients.torch import TorchEpisodes
from wtg_gym.policies.torch_export import TorchPolicy, export_onnx
from wtg_gym.tasks.episode import ACTION_MODES

V1 = {"version": "v1"}
LIMITS = [(V1, "frequency_pu", 0.95), ({**V1, "on_failure": "terminate"}, "rotor_1_speed_pu", 0.5)]
#: How far an episode has failed at a limit.
SHARE = 1.0 / (1.0 + math.exp(-1.0))
POLICIES = Path(__file__).parents[2] / "agents" / "policies"
FREE = {"suite": "standard-v1", "strategy": "coordinated-free"}
EVOLUTION = functools.partial(RunSettings, algo="evolution", hyperparameters={}, timesteps=1, n_envs=1, **FREE)
SHIPPED = ["--start", str(POLICIES / "dagger-v1-0")]
ACTS = ["--action-mode", "k", "--strategy", "coordinated-free"]
SMALL = "--suite standard --n-envs 2 --validation-episodes 2"
#: Runs with a validation before, between and after their rounds, and in which function they are interrupted.
RUNS = {
    gradient: (f"{SMALL} --timesteps 2400 --interval 1200 --hidden 8 --lstm 4", gradient, "descend"),
    evolution: (
        f"{SMALL} --timesteps 19200 --interval 9600 --hidden 3 --population 4 --spread 0.2",
        *(evolution.EvolutionLearner, "tell"),
    ),
    # Its plans are made by then, and numbers drawn.
    dagger: (
        "--action-mode k --strategy coordinated-free --timesteps 2160 --interval 1080 --n-envs 3 "
        "--validation-episodes 3 --hidden 4 --lstm 4 --updates 2 --horizon-s 60 --interval-s 60 --iterations 1",
        *(dagger.DaggerLearner, "fit"),
    ),
}
LEARNERS = {gradient: gradient.GradientLearner, evolution: evolution.EvolutionLearner, dagger: dagger.DaggerLearner}
WRONG = [
    (gradient, ["--hidden", "8", "0"], "hidden must be a whole number"),
    (gradient, ["--lstm", "-1"], "lstm must"),
    (planner, ["--episodes", "3", "--interval-s", "0.1"], "interval_s"),
    (planner, ["--episodes", "3", "--horizon-s", "5"], "horizon_s = 5 s must reach to the next plan, in 10 s"),
    (evolution, ["--population", "3"], "population must be a whole number in 4 … 10000, got 3"),
    (evolution, [*SHIPPED, *ACTS[:2]], "has strategy = 'coordinated-free', not 'coordinated-piecewise'"),
    (evolution, ["--start", str(POLICIES / "ppo-v1-0"), *ACTS[2:]], "has per_group = false: its policy sees all"),
    (evolution, ["--start", "no-such-folder", *ACTS], "no-such-folder"),
    (evolution, [*SHIPPED, "--hidden", "8", *ACTS], "leave out --hidden and --lstm"),
    (evolution, ["--observation-mode", "privileged"], "leave out --observation-mode"),
]


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


@pytest.mark.parametrize(("settings", "name", "limit"), LIMITS)
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
    of_rotor, of_load = -15.0 * 60.0 * slope(0.0) / 0.02, -300.0 * 60.0 * at_stages / 0.001
    for name, limit, expected in (("rotor_2_speed_pu", 0.5, of_rotor), ("frequency_pu", 0.98, of_load)):
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
    offsets, scale = np.array([40.0, 200.0, 1000.0]), suite.task.scale or 1.0
    for weight in (0.0, 0.5):
        parts = (np.log(costs.numpy() + offsets) + weight * costs.numpy() / offsets) / scale
        assert loss_of(costs, suite, scenarios, weight).item() == pytest.approx(parts.mean())
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


@pytest.mark.parametrize("name", ["dagger-v1-0", "gradient-v1-0"])
def test_search_begins_at_the_policy_of_the_file(name):
    (entry,) = load_entries(POLICIES / name)
    settings = EVOLUTION(action_mode=entry.action_mode)
    policy = TorchPolicy(evolution.read_policy(POLICIES / name, settings))
    n = 6 + sum(ACTION_MODES[entry.action_mode])
    assert actions_of(policy, n) == pytest.approx(actions_of(entry.policy, n), abs=1e-6)


def test_network_with_other_actions_is_refused(tmp_path):
    other = GradientPolicy(7, 1, (4,))
    other.layers[1], other.per_group = torch.nn.ReLU(), True
    export_onnx(other, tmp_path, name="mine", per_group=True, action_mode="k", strategy="coordinated-free")
    with pytest.raises(ValueError, match=r"holds no single network of .*: its actions are others"):
        evolution.read_policy(tmp_path, EVOLUTION(action_mode="k"))


def test_joined_policies_begin_at_the_mean_of_theirs_before_the_tanh():
    settings = EVOLUTION(action_mode="k+tau")
    names = ("dagger-v1-0", "gradient-v1-0")  # of k, of k and τ
    policies = [evolution.read_policy(POLICIES / name, settings) for name in names]
    of_k, of_both = (np.arctanh(actions_of(TorchPolicy(policy), 8)) for policy in policies)
    joined = np.arctanh(actions_of(TorchPolicy(evolution.JoinedPolicy(policies, 2)), 8))
    assert joined[..., :1] == pytest.approx((of_k + of_both[..., :1]) / 2.0, abs=1e-5)
    assert joined[..., 1:] == pytest.approx(of_both[..., 1:] / 2.0, abs=1e-5)


def test_unreliable_candidates_are_charged_besides():
    settings = EnvSettings(version="v1", duration_s=60.0)
    plain, charged = (evolution.Population(settings, 3, 4, reliability) for reliability in (0.0, 50.0))
    scenarios = plain.batch.scenarios(range(1_000_011, 1_000_014))
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
    population = evolution.Population(EnvSettings(version="v1", duration_s=40.0), 3, 4)
    batch, policy = population.batch, GradientPolicy(8, 2)
    scenarios = batch.scenarios(range(1_000_057, 1_000_060))
    candidates = np.random.default_rng(0).normal(0.0, 0.1, (4, 18))
    result = population.objectives(policy, candidates, scenarios)
    costs = batch.cost_sums().sum(axis=1).reshape(4, 3)
    strata = [batch.suite.stratum(scenario.seed or 0) for scenario in scenarios]
    offsets = np.array([{"ample": 40.0, "tight": 200.0, "short": 1000.0}[name] for name in strata])
    expected = np.mean(np.log(costs + offsets), axis=1) / tasks.V1.scale
    assert result == pytest.approx(expected) and np.unique(result).size == 4
    # The first candidate alone, in the same scenarios.
    torch.nn.utils.vector_to_parameters(torch.from_numpy(candidates[0]).float(), policy.last.parameters())
    alone = evolution.Population(EnvSettings(version="v1", duration_s=40.0), 3, 1)
    assert alone.objectives(policy, candidates[:1], scenarios) == pytest.approx(result[:1], rel=1e-6)


def test_policy_is_the_mean_of_what_was_found():
    policy = GradientPolicy(4, 1)
    before = policy.last.weight.detach().clone()
    learner = evolution.EvolutionLearner(EVOLUTION(), evolution.Hyperparameters(population=6, spread=0.5))
    learner.network = policy
    candidates = learner.search.ask()
    learner.tell(candidates, ((candidates - 1.0) ** 2).sum(axis=1))
    assert learner.average == pytest.approx(learner.search.mean)
    assert policy.last.weight.detach().numpy().ravel() == pytest.approx(learner.average[:4], abs=1e-6)
    assert (policy.last.weight - 1.0).norm().item() < (before - 1.0).norm().item()


def name_of(value) -> str:
    return getattr(value, "__name__", str(value))


@pytest.mark.parametrize("module", RUNS, ids=name_of)
def test_run_repeats_also_after_an_interruption_and_is_exported(module, tmp_path, monkeypatch):
    (words, owner, step), one, two = RUNS[module], tmp_path / "one", tmp_path / "two"
    # The last policies count: the first are the law itself.
    monkeypatch.setattr(Run, "best", property(lambda run: run.curve[-1]))
    assert module.main([*words.split(), "--output", str(one)]) == 0
    with monkeypatch.context() as patch:
        # After the second validation.
        stop = interrupted(getattr(owner, step), lambda *_: len(Run.read(two).curve) == 2)
        patch.setattr(owner, step, stop)
        assert module.main([*words.split(), "--output", str(two)]) == 130
    for _ in range(2):
        assert module.main(["--resume", str(two)]) == 0
    run, resumed = Run.read(one), Run.read(two)
    curves = [[{**row, "wall_time_s": 0.0} for row in each.curve] for each in (run, resumed)]
    assert curves[0] == curves[1] and len(curves[0]) == 3
    assert [(each.finished, len(each.resumptions)) for each in (run, resumed)] == [(True, 0), (True, 1)]
    networks = []
    for folder in (one, two):
        learner = LEARNERS[module](run.settings, module.Hyperparameters(**run.settings.hyperparameters))
        learner.load(folders(folder / "checkpoints")[0])
        networks.append(learner.network)
    states = [network.state_dict() for network in networks]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])
    files = [(folders(folder / "best")[-1] / "policy.onnx").read_bytes() for folder in (one, two)]
    assert files[0] == files[1]
    export(one, tmp_path / "entry", name="mine")
    (entry,) = load_entries(tmp_path / "entry")
    n = entry.policy.widths[0]
    assert actions_of(TorchPolicy(networks[0]), n) == pytest.approx(actions_of(entry.policy, n), abs=1e-6)
    assert actions_of(entry.policy, n).any() and entry.per_group == (module is not gradient)


@pytest.mark.parametrize(("module", "words", "message"), WRONG, ids=name_of)
def test_wrong_options_are_refused(module, words, message, tmp_path, capsys):
    output = [] if module is planner else ["--output", str(tmp_path / "run")]
    assert module.main([*words, *output]) == 2
    assert message in capsys.readouterr().err
