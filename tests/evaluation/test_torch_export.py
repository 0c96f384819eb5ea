"""Facts about policies as ONNX files: what they answer, and how any policy of torch becomes one."""

import os

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch import nn

from tests.submissions import models
from wtg_gym import export_onnx, load_entries
from wtg_gym.evaluation import OnnxPolicy, PolicyError, evaluate
from wtg_gym.policies.gate import check_submission, read_submission

M = 8
ENTRY = {"name": "mine", "authors": ["Jane Doe"], "environment": "GFMWTG-14bus-v1"}
REFUSED = {
    "no module": (lambda n: lambda x: x, "takes a torch.nn.Module, got function"),
    "other width": (lambda n: nn.Linear(n + 1, M), "cannot answer inputs of shapes .* give the environment"),
    "too few actions": (lambda n: nn.Linear(n, M - 1), r"of shapes \[\(2, 8\)\], got \[\(2, 7\)\]"),
    "undeclared states": (lambda n: Answers(n, lambda y, x: (y, x)), r"of shapes \[\(2, 8\)\], got \[\(2, 8\), "),
    "random": (lambda n: Answers(n, lambda y, x: y + torch.randn(x.shape[0], M)), "draws random numbers"),
    "branch": (lambda n: Answers(n, lambda y, x: y if x.sum() < 0.5 else -y), "branches on its input"),
    "no operator": (lambda n: Answers(n, lambda y, x: torch.special.airy_ai(y)), "cannot export the module .*airy_ai"),
    "not a number": (lambda n: Answers(n, lambda y, x: y / 0.0 * 0.0), "differ by inf"),
    # Before the work: the module is none that can be exported.
    "unknown key": (lambda n: nn.Linear(1, 1), "argument 'author'; did you mean 'authors'", {"author": "A"}),
    "unknown mode": (lambda n: nn.Linear(1, 1), "action_mode must be one of", {"action_mode": "nothing"}),
    "too large": (lambda n: nn.Sequential(nn.Linear(n, 35_000), nn.Linear(35_000, M)), "allowed are 5000000"),
}


@pytest.fixture(autouse=True)
def _seeded(one_thread, few_scenarios):
    torch.manual_seed(0)


def observation_width() -> int:
    (width,) = gym.make("wtg_gym:GFMWTG-14bus-v1").observation_space.shape
    return int(width)


class Memory(nn.Module):
    """A GRU beside a network with what libraries like: layer norms, dropout, SiLU; a double in between."""

    state_widths = (6,)

    def __init__(self, n: int) -> None:
        super().__init__()
        self.cell = nn.GRUCell(n, 6)
        self.head = nn.Sequential(nn.LayerNorm(6), nn.Linear(6, 16), nn.SiLU(), nn.Dropout(0.5), nn.Linear(16, M))

    def forward(self, observation, state):
        state = self.cell(observation.double().clamp(-2.0, 2.0).float(), state)
        return 3.0 * self.head(state), state


def test_plain_module_becomes_one_file_that_the_gate_accepts(tmp_path):
    n = observation_width()
    module = nn.Sequential(nn.Linear(n, 32), nn.ELU(), nn.Linear(32, 32), nn.GELU(), nn.Linear(32, M), nn.Tanh())
    folder = export_onnx(module, tmp_path / "mine", training_seed=3, trained_on="nothing", **ENTRY)
    assert sorted(path.name for path in folder.iterdir()) == ["entry.toml", "policy.onnx"]
    report = check_submission(folder)
    assert report.accepted, report.refusal
    assert (report.entry.training_seed, report.entry.trained_on) == (3, "nothing")
    (entry,) = load_entries(folder)
    assert (entry.name, entry.environment) == ("mine", "GFMWTG-14bus-v1")
    observations = np.random.default_rng(1).normal(size=(5, n)).astype(np.float32)
    assert isinstance(entry.policy, OnnxPolicy)
    with entry.policy as policy, torch.no_grad():
        actions, _ = policy.predict(observations)
        assert np.abs(actions - module(torch.as_tensor(observations)).numpy()).max() < 1e-6
        assert actions.std() > 0.01


def test_module_with_memory_keeps_it_and_stays_in_its_mode(tmp_path):
    n = observation_width()
    module = Memory(n).train()
    folder = export_onnx(module, tmp_path / "mine", **ENTRY)
    assert check_submission(folder).accepted and module.training and module.head[3].training
    module.eval()
    observations = torch.as_tensor(np.random.default_rng(1).normal(size=(4, 3, n)).astype(np.float32))
    state, other = torch.zeros(3, 6), None
    with OnnxPolicy(folder / "policy.onnx") as policy, torch.no_grad():
        for each in observations:
            action, state = module(each, state)
            actions, other = policy.predict(each.numpy(), other)
            assert np.abs(action.clamp(-1.0, 1.0).numpy() - actions).max() < 1e-6
    assert state.abs().max() > 0.1


class Answers(nn.Linear):
    """A linear module whose answer goes through a function of it and the observation."""

    def __init__(self, n: int, answer) -> None:
        super().__init__(n, M)
        self.answer = answer

    def forward(self, observation):
        return self.answer(super().forward(observation), observation)


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(case, tmp_path):
    make, message, *keys = REFUSED[case]
    with pytest.raises(TypeError if case == "unknown key" else ValueError, match=message):
        export_onnx(make(observation_width()), tmp_path / "mine", **ENTRY, **dict(*keys))
    assert not (tmp_path / "mine").exists()


def test_export_leaves_authors_to_fill_in_and_replaces_no_other_description(tmp_path):
    module = nn.Linear(observation_width(), M)
    folder = export_onnx(module, tmp_path / "mine", name="mine")
    assert "authors must be a list of 1" in read_submission(folder).refusal.reason
    assert export_onnx(module, folder, name="mine") == folder
    with pytest.raises(ValueError, match="choose another folder, or give overwrite=True"):
        export_onnx(module, folder, **ENTRY)
    assert read_submission(export_onnx(module, folder, overwrite=True, **ENTRY)).accepted


RANDOM = {
    "normal": models.after("action = RandomNormalLike(linear)"),
    "uniform, with a seed": models.after("action = RandomUniformLike<seed = 1.0>(linear)"),
    "without input": models.after("drawn = RandomNormal<shape = [1, 4]>(); action = Add(linear, drawn)"),
    "Bernoulli": models.after("chance = Sigmoid(linear); action = Bernoulli(chance)"),
    "Multinomial": models.after("drawn = Multinomial<sample_size = 4>(linear); action = Cast<to = 1>(drawn)"),
    "dropout": models.after("action = Dropout(linear, half, yes)", half=0.5, yes=True),
    "within a condition": models.branch("drawn = RandomNormalLike(linear);"),
    "a function called like an operator": models.with_function("y = RandomNormalLike(x);", "own"),
}
SIGNATURES = [
    ([models.info("observation", 2, models.N)], [models.info("action", 2, 4)], r"\(batch, n\) with any batch"),
    ([models.info("observation", "batch", "n")], [models.ACTION], "observation must be float32"),
    ([models.OBSERVATION, models.info("memory", "batch", 2)], [models.ACTION], "must take observation, state_0"),
    ([models.OBSERVATION, models.info("state_0", "batch", 2)], [models.ACTION], "must take observation, state_0"),
    ([models.OBSERVATION], [], "must take observation, state_0"),
]


def counter() -> OnnxPolicy:
    """A policy that adds up the first four entries of the observations: the sum is its state and its action."""
    nodes = """
    first = Slice(observation, starts, ends, axes); next_state_0 = Add(first, state_0); action = Identity(next_state_0)
    """
    return OnnxPolicy(models.with_state(nodes, 4, starts=[0], ends=[4], axes=[1]).SerializeToString())


def test_memory_goes_on_and_is_cleared_where_an_episode_starts():
    policy = counter()
    ones = np.ones((2, models.N), dtype=np.float32)
    first, state = policy.predict(ones)
    second, state = policy.predict(ones, state)
    third, _ = policy.predict(ones, state, np.array([True, False]))
    assert [values[:, 0].tolist() for values in (first, second, third)] == [[1, 1], [2, 2], [1, 3]]


def test_file_that_is_missing_or_may_have_no_end_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for name, reason in (("none", ""), ("pipe", "it is no plain file"), ("link", "it is no plain file")):
        with pytest.raises(ValueError, match=f"cannot read the policy .*{name}.*{reason}"):
            OnnxPolicy(tmp_path / name)


@pytest.mark.parametrize(("inputs", "outputs", "text"), SIGNATURES)
def test_wrong_signature_is_refused_when_loaded(inputs, outputs, text):
    with pytest.raises(PolicyError, match=text):
        OnnxPolicy(models.model([models.LINEAR], inputs, outputs).SerializeToString()).predict(np.zeros((1, models.N)))


def test_wrong_shapes_are_named():
    policy = counter()
    with pytest.raises(PolicyError, match=r"shape \(num_envs, 20\), got \(2, 18\).*action_mode"):
        policy.predict(np.zeros((2, 18)))
    with pytest.raises(PolicyError, match=r"states of shapes \[\(3, 4\)\], got \[\(2, 4\)\]"):
        policy.predict(np.zeros((3, models.N)), (np.zeros((2, 4), dtype=np.float32),))


def test_policy_of_another_action_mode_is_named(tmp_path):
    (tmp_path / "entry.toml").write_text('name = "still"\naction_mode = "k"\nenvironment = "GFMWTG-14bus-v0"\n')
    (tmp_path / "policy.onnx").write_bytes(models.make_bytes())
    (entry,) = load_entries(tmp_path)
    with pytest.raises(PolicyError, match=r"entry 'still', step 0: .*trained with another action_mode"):
        evaluate([entry], "standard", "test", seeds=[20_000], duration_s=1.0)


@pytest.mark.parametrize("content", RANDOM.values(), ids=RANDOM)
def test_random_answers_repeat_in_every_order_and_batch(content):
    """A scenario's first two answers are the same, whatever was played before and is played beside it."""
    answers: dict[int, set[bytes]] = {0: set(), 1: set(), 2: set()}
    observations = np.random.default_rng(0).normal(0.0, 1.0, (3, models.N)).astype(np.float32)
    with OnnxPolicy(content.SerializeToString()) as policy:
        for order in ([0, 1, 2], [0, 1, 2], [2, 0, 1], [1], [0], [2, 1]):
            first, _ = policy.predict(observations[order], None, np.ones(len(order), bool))
            second, _ = policy.predict(observations[order], None, np.zeros(len(order), bool))
            for index, scenario in enumerate(order):
                answers[scenario].add(first[index].tobytes() + second[index].tobytes())
    assert [len(played) for played in answers.values()] == [1, 1, 1]


@pytest.mark.parametrize(("size", "most"), [(1, 64), (2**23, 64), (2**24, 32), (2**26, 8)])
def test_large_policies_play_fewer_episodes_at_a_time(size, most):
    assert OnnxPolicy(bytes(size)).most_episodes == most
