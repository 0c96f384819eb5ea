"""Facts about policies as ONNX files and the folders that make them entries."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from wtg_gym.evaluation import OnnxPolicy, PolicyError, evaluate, load_entries

FLOAT = TensorProto.FLOAT
POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"
#: Width of the local observation of two groups with both actions.
N = 20


def write(path: Path, nodes: list[Any], inputs: list[Any], outputs: list[Any]) -> Path:
    make = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes, "g", [make(*given) for given in inputs], [make(*given) for given in outputs], CONSTANTS
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


CONSTANTS = [
    numpy_helper.from_array(np.zeros((N, 4), dtype=np.float32), "weights"),
    helper.make_tensor("starts", TensorProto.INT64, [1], [0]),
    helper.make_tensor("ends", TensorProto.INT64, [1], [4]),
    helper.make_tensor("axes", TensorProto.INT64, [1], [1]),
]
STILL = [helper.make_node("MatMul", ["observation", "weights"], ["action"])]
OBSERVATION, ACTION = ("observation", FLOAT, ["batch", N]), ("action", FLOAT, ["batch", 4])


def still(path: Path) -> Path:
    return write(path, STILL, [OBSERVATION], [ACTION])


def counter(path: Path) -> Path:
    """A policy that adds up the first four entries of the observations: the sum is its state and its action."""
    nodes = [
        helper.make_node("Slice", ["observation", "starts", "ends", "axes"], ["first"]),
        helper.make_node("Add", ["first", "state_0"], ["next_state_0"]),
        helper.make_node("Identity", ["next_state_0"], ["action"]),
    ]
    return write(
        path, nodes, [OBSERVATION, ("state_0", FLOAT, ["batch", 4])], [ACTION, ("next_state_0", FLOAT, ["batch", 4])]
    )


def test_memory_goes_on_and_is_cleared_where_an_episode_starts(tmp_path: Path) -> None:
    policy = OnnxPolicy(counter(tmp_path / "a.onnx"))
    ones = np.ones((2, N), dtype=np.float32)
    first, state = policy.predict(ones)
    second, state = policy.predict(ones, state)
    third, _ = policy.predict(ones, state, np.array([True, False]))
    assert [values[:, 0].tolist() for values in (first, second, third)] == [[1, 1], [2, 2], [1, 3]]


def test_file_that_is_no_policy_is_named_when_it_is_played(tmp_path: Path) -> None:
    path = tmp_path / "a.onnx"
    for content in (b"", b"no model", b"\x80\x04."):
        with pytest.raises(PolicyError, match="onnxruntime cannot load the policy"):
            OnnxPolicy(content).predict(np.zeros((1, N)))
    with pytest.raises(ValueError, match="cannot read the policy"):
        OnnxPolicy(tmp_path / "none.onnx")
    # Weights in another file, which a path could point anywhere with.
    model = onnx.load(still(path))
    onnx.save(model, path, save_as_external_data=True, location="weights.bin", size_threshold=0)
    with pytest.raises(PolicyError, match="onnxruntime cannot load the policy"):
        OnnxPolicy(path).predict(np.zeros((1, N)))


def test_file_that_may_have_no_end_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for name in ("pipe", "link"):
        with pytest.raises(ValueError, match=f"cannot read the policy .*{name}: it is no plain file"):
            OnnxPolicy(tmp_path / name)


@pytest.mark.parametrize(
    ("inputs", "outputs", "text"),
    [
        ([("observation", FLOAT, [2, N])], [("action", FLOAT, [2, 4])], r"\(batch, n\) with any batch or one of 1"),
        ([("observation", FLOAT, ["batch", "n"])], [ACTION], "observation must be float32"),
        ([OBSERVATION, ("memory", FLOAT, ["batch", 2])], [ACTION], "must take observation, state_0"),
        ([OBSERVATION, ("state_0", FLOAT, ["batch", 2])], [ACTION], "must take observation, state_0"),
        ([OBSERVATION], [], "must take observation, state_0"),
    ],
)
def test_wrong_signature_is_refused_when_loaded(inputs: list[Any], outputs: list[Any], text: str, tmp_path: Path):
    path = write(tmp_path / "a.onnx", STILL, inputs, outputs)
    with pytest.raises(PolicyError, match=text):
        OnnxPolicy(path).predict(np.zeros((1, N)))


def test_wrong_shapes_are_named(tmp_path: Path) -> None:
    policy = OnnxPolicy(counter(tmp_path / "a.onnx"))
    with pytest.raises(PolicyError, match=r"shape \(lanes, 20\), got \(2, 18\).*action_mode"):
        policy.predict(np.zeros((2, 18)))
    with pytest.raises(PolicyError, match=r"states of shapes \[\(3, 4\)\], got \[\(2, 4\)\]"):
        policy.predict(np.zeros((3, N)), (np.zeros((2, 4), dtype=np.float32),))


def test_random_numbers_start_alike_in_every_scenario(tmp_path: Path) -> None:
    nodes = [
        helper.make_node("MatMul", ["observation", "weights"], ["still"]),
        helper.make_node("RandomNormalLike", ["still"], ["action"]),
    ]
    path = write(tmp_path / "a.onnx", nodes, [OBSERVATION], [ACTION])
    courses = []
    for n_lanes in (3, 1):
        with OnnxPolicy(path) as policy:
            goes_on = np.zeros(n_lanes, bool)
            courses.append(
                [policy.predict(np.ones((n_lanes, N)), None, ~goes_on if i == 0 else goes_on)[0] for i in range(2)]
            )
            # Where an episode starts, they start again.
            again, _ = policy.predict(np.ones((n_lanes, N)), None, ~goes_on)
        assert np.array_equal(again, courses[-1][0]) and not np.array_equal(*courses[-1])
    for many, one in zip(*courses, strict=True):
        assert np.array_equal(many, np.repeat(one, 3, axis=0))


def test_costs_in_a_scenario_are_the_same_to_the_last_bit_whatever_is_played_beside_it() -> None:
    (entry,) = load_entries(POLICIES / "sac-k+tau-4")
    together = evaluate([entry], "standard", "test", duration_s=5.0).episodes_of(entry.name)
    assert len(together) == 200
    alone = evaluate([entry], "standard", "test", seeds=[20_117], duration_s=5.0)
    assert alone.episodes_of(entry.name) == [episode for episode in together if episode.seed == 20_117]


def test_missing_policy_and_other_action_mode_are_named(tmp_path: Path) -> None:
    (tmp_path / "entry.toml").write_text('name = "still"\naction_mode = "k"\nenvironment = "GFMWTG-14bus-v0"\n')
    with pytest.raises(ValueError, match=r"cannot read the policy .*policy\.onnx"):
        load_entries(tmp_path)
    still(tmp_path / "policy.onnx")
    (entry,) = load_entries(tmp_path)
    with pytest.raises(PolicyError, match=r"entry 'still', step 0: .*trained with another action_mode"):
        evaluate([entry], "standard", "test", seeds=[20_000], duration_s=1.0)
