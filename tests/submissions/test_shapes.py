"""The shapes that are worked out are those that onnxruntime computes, and lanes are apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime
import pytest
from onnx import ModelProto, helper

from tests.submissions.models import OBSERVATION, M, N, constant, node
from tests.submissions.models import model as make
from wtg_gym.submissions.graph import _File
from wtg_gym.submissions.shapes import _ELEMENTWISE, _REDUCTIONS, _UNARY, BATCH, RULES, Shape

CONSTANTS = [
    constant("half", 0.5),
    constant("row", np.ones(N)),
    constant("zero", [0], np.int64),
    constant("one", [1], np.int64),
    constant("two", [2], np.int64),
    constant("ten", [10], np.int64),
    constant("split", [-1, 4, 5], np.int64),
    constant("split_0", [0, 5, -1], np.int64),
    constant("unsplit", [1, -1, 20], np.int64),
    constant("uneven", [3, 17], np.int64),
    constant("picked", [[0, -1], [3, 4]], np.int64),
    constant("matrix", np.ones((N, 3))),
    constant("turned", np.ones((3, N))),
    constant("stack", np.ones((2, N, 3))),
    constant("w4", np.ones((2, 24, N))),
    constant("r4", np.ones((2, 24, 6))),
    constant("b4", np.ones((2, 48))),
    constant("w3", np.ones((1, 18, N))),
    constant("r3", np.ones((1, 18, 6))),
    constant("w1", np.ones((1, 6, N))),
    constant("r1", np.ones((1, 6, 6))),
]
_BOOLEAN = {"And", "Or", "Xor", "Not"}
_SEQUENCE = node("Unsqueeze", ["observation", "zero"], "x")
_CUBE = node("Reshape", ["observation", "split"], "cube")


def chain(operator: str) -> list[Any]:
    """Nodes that end in an operator with one input, or two."""
    if operator in _BOOLEAN:
        compared = node("Greater", ["observation", "half"], "a")
        return [compared, node(operator, ["a"] if operator == "Not" else ["a", "a"], "out")]
    if operator == "Where":
        return [node("Less", ["observation", "half"], "a"), node("Where", ["a", "observation", "half"], "out")]
    if operator in _UNARY.split():
        return [node(operator, ["observation"], "out", **({"to": 11} if operator == "Cast" else {}))]
    if operator in _ELEMENTWISE.split():
        return [node(operator, ["observation", "row"], "out", **({"fmod": 1} if operator == "Mod" else {}))]
    keep = len(operator) % 2
    if operator == "ReduceSum":
        return [_CUBE, node(operator, ["cube", "two"], "out", keepdims=keep)]
    return [_CUBE, node(operator, ["cube"], "out", axes=[-1], keepdims=keep)]


CASES: dict[str, list[Any]] = {
    **{operator: chain(operator) for operator in f"{_UNARY} {_ELEMENTWISE} {_REDUCTIONS}".split()},
    "Clip": [node("Clip", ["observation", "half"], "out")],
    "Concat": [node("Concat", ["observation", "observation"], "out", axis=-1)],
    "Flatten": [_CUBE, node("Flatten", ["cube"], "out")],
    "Flatten x": [_SEQUENCE, node("Flatten", ["x"], "out", axis=2)],
    "Gather": [node("Gather", ["observation", "picked"], "out", axis=1)],
    "Gemm": [node("Gemm", ["observation", "turned"], "out", transB=1)],
    "MatMul": [node("MatMul", ["observation", "matrix"], "out")],
    "MatMul x": [_SEQUENCE, node("MatMul", ["x", "stack"], "out")],
    "LayerNormalization": [_CUBE, node("LayerNormalization", ["cube", "half"], "out", axis=-2)],
    "Softmax": [_CUBE, node("Softmax", ["cube"], "out", axis=1)],
    "LogSoftmax": [node("LogSoftmax", ["observation"], "out")],
    "Reshape": [_CUBE, node("Reshape", ["cube", "split_0"], "a"), node("Reshape", ["a", "unsplit"], "out")],
    "Slice": [node("Slice", ["observation", "one", "ten", "one", "two"], "out")],
    "Split": [helper.make_node("Split", ["observation", "uneven"], ["first", "out"], axis=1)],
    "Split x": [helper.make_node("Split", ["observation"], ["first", "b", "c", "out"], axis=1)],
    "Squeeze": [_SEQUENCE, node("Squeeze", ["x", "zero"], "out")],
    "Transpose": [_CUBE, node("Transpose", ["cube"], "out")],
    "Transpose x": [_CUBE, node("Transpose", ["cube"], "out", perm=[1, 0, 2])],
    "Unsqueeze": [node("Unsqueeze", ["observation", "two"], "out")],
    "LSTM": [
        _SEQUENCE,
        helper.make_node("LSTM", ["x", "w4", "r4", "b4"], ["out", "h", "c"], hidden_size=6, direction="bidirectional"),
    ],
    "GRU": [_SEQUENCE, helper.make_node("GRU", ["x", "w3", "r3"], ["y", "out"], hidden_size=6)],
    "RNN": [_SEQUENCE, helper.make_node("RNN", ["x", "w1", "r1"], ["out"], hidden_size=6)],
}
#: Newer than the opset of the others.
_OPSETS = {"Gelu": 20, "Mish": 18, "LayerNormalization": 17}


def content(name: str) -> ModelProto:
    return make(CASES[name], [OBSERVATION], [helper.ValueInfoProto(name="out")], CONSTANTS, _OPSETS.get(name, 17))


def worked_out(file: ModelProto) -> Shape:
    found = _File(file.SerializeToString(), N, M)
    for step in (found.parse, found.check_model, found.read_constants, found.follow_nodes):
        step()
    return found._values["out"].shape


def computed(file: ModelProto, observations: Any) -> Any:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(file.SerializeToString(), options, providers=["CPUExecutionProvider"])
    return session.run(["out"], {"observation": observations})[0]


def test_every_operator_has_a_case() -> None:
    assert {name.split()[0] for name in CASES} == set(RULES)


@pytest.mark.parametrize("name", CASES)
def test_shapes_are_those_of_onnxruntime_and_lanes_are_apart(name: str) -> None:
    shape = worked_out(content(name))
    assert shape.count(BATCH) == 1
    rng = np.random.default_rng(0)
    for n_lanes in (1, 7):
        observations = rng.uniform(-0.9, 0.9, (n_lanes, N)).astype(np.float32)
        values = computed(content(name), observations)
        assert values.shape == tuple(n_lanes if length == BATCH else length for length in shape)
    # Another last lane changes nothing in the first six.
    other = observations.copy()
    other[-1] = 0.5
    first = [np.take(values, range(6), shape.index(BATCH)) for values in (values, computed(content(name), other))]
    assert np.array_equal(*first, equal_nan=first[0].dtype.kind == "f")
