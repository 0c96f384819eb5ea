"""Facts about policies as ONNX files and the folders that make them entries."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.submissions import models
from wtg_gym.evaluation import OnnxPolicy, PolicyError, evaluate, load_entries

POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"
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
    for name, said in (("none", ""), ("pipe", "it is no plain file"), ("link", "it is no plain file")):
        with pytest.raises(ValueError, match=f"cannot read the policy .*{name}.*{said}"):
            OnnxPolicy(tmp_path / name)


@pytest.mark.parametrize(
    ("inputs", "outputs", "text"), SIGNATURES, ids=["batch", "width", "memory", "state", "no action"]
)
def test_wrong_signature_is_refused_when_loaded(inputs, outputs, text):
    with pytest.raises(PolicyError, match=text):
        OnnxPolicy(models.model([models.LINEAR], inputs, outputs).SerializeToString()).predict(np.zeros((1, models.N)))


def test_wrong_shapes_are_named():
    policy = counter()
    with pytest.raises(PolicyError, match=r"shape \(lanes, 20\), got \(2, 18\).*action_mode"):
        policy.predict(np.zeros((2, 18)))
    with pytest.raises(PolicyError, match=r"states of shapes \[\(3, 4\)\], got \[\(2, 4\)\]"):
        policy.predict(np.zeros((3, models.N)), (np.zeros((2, 4), dtype=np.float32),))


def test_costs_in_a_scenario_are_the_same_to_the_last_bit_whatever_is_played_beside_it():
    (entry,) = load_entries(POLICIES / "sac-k+tau-4")
    seeds = range(20_000, 20_070)
    together = evaluate([entry], "standard", "test", seeds=seeds, duration_s=2.0).episodes_of(entry.name)
    for seed in (20_017, 20_069):
        alone = evaluate([entry], "standard", "test", seeds=[seed], duration_s=2.0)
        assert alone.episodes_of(entry.name) == [episode for episode in together if episode.seed == seed]


def test_missing_policy_and_other_action_mode_are_named(tmp_path):
    (tmp_path / "entry.toml").write_text('name = "still"\naction_mode = "k"\nenvironment = "GFMWTG-14bus-v0"\n')
    with pytest.raises(ValueError, match=r"cannot read the policy .*policy\.onnx"):
        load_entries(tmp_path)
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
