"""The model that is judged is the one that is played: answers repeat in any order and batch, however it is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from onnx import GraphProto, ModelProto, TensorProto, helper

from tests.submissions import models
from tests.submissions.models import M, N, after, branch, constant, external, field, make_bytes, varint, with_function
from wtg_gym.policies import OnnxPolicy, PolicyError
from wtg_gym.policies.onnx_worker import stateless

POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"
DRAW = "drawn = RandomNormalLike(linear)"
DRAWING, CALM = after("action = RandomNormalLike(linear)"), after("action = Tanh(linear)")


def with_last_node(*fields: bytes) -> bytes:
    """The model that draws, with its last node's fields written by hand."""
    graph = GraphProto()
    graph.CopyFrom(DRAWING.graph)
    del graph.node[-1]
    return models.rewritten(DRAWING, field(7, graph.SerializeToString() + field(1, b"".join(fields))))


def in_two_graphs() -> bytes:
    """Readers put both graphs together: the second one has the node that draws."""
    graph = GraphProto()
    graph.node.append(DRAWING.graph.node[-1])
    rest = GraphProto()
    rest.CopyFrom(DRAWING.graph)
    del rest.node[-1]
    return models.rewritten(DRAWING, field(7, rest.SerializeToString()), field(7, graph.SerializeToString()))


GRAPH = DRAWING.graph.SerializeToString()
NAMES = field(1, b"linear"), field(2, b"action")
OPERATOR = b"RandomNormalLike"
#: Models that draw random numbers, by operator and by how they are written.
RANDOM: dict[str, ModelProto | bytes] = {
    "normal": DRAWING,
    "uniform": after("action = RandomUniformLike(linear)"),
    "with a seed": after("action = RandomUniformLike<seed = 1.0>(linear)"),
    "without input": after(f"drawn = RandomNormal<shape = [1, {M}]>(); action = Add(linear, drawn)"),
    "without input, with a seed": after(
        f"drawn = RandomUniform<shape = [1, {M}], seed = 2.0>(); action = Add(linear, drawn)"
    ),
    "Bernoulli": after("chance = Sigmoid(linear); action = Bernoulli(chance)"),
    "Multinomial": after(f"drawn = Multinomial<sample_size = {M}>(linear); action = Cast<to = 1>(drawn)"),
    "dropout": after("action = Dropout(linear, half, yes)", half=0.5, yes=True),
    "domain by its long name": after("action = ai.onnx.RandomNormalLike(linear)"),
    "within a condition": branch(f"{DRAW};"),
    "a function called like an operator": with_function("y = RandomNormalLike(x);", ""),
    "a function called like an operator, of a domain": with_function("y = RandomNormalLike(x);", "own"),
    "a key of 33 bits: graph": models.unseen(DRAWING),
    "a key of 33 bits: operator": with_last_node(*NAMES, field(4, b"Tanh"), field(4, OPERATOR, far=True)),
    "a calm graph, and one behind a key of 33 bits": CALM.SerializeToString() + field(7, GRAPH, far=True),
    "two graphs": in_two_graphs(),
    "two names of an operator": with_last_node(*NAMES, field(4, b"Tanh"), field(4, OPERATOR)),
    "two names, the calm one last": with_last_node(*NAMES, field(4, OPERATOR), field(4, b"Tanh")),
    "a long way to write a length": models.rewritten(
        DRAWING, b"\x3a", bytes([len(GRAPH) & 127 | 128, len(GRAPH) >> 7 | 128, 0]), GRAPH
    ),
    "a long way to write a key": models.rewritten(DRAWING, b"\xba\x80\x80\x00", varint(len(GRAPH)), GRAPH),
    "a group that nobody knows": models.rewritten(DRAWING, b"\xa3\x06", field(7, GRAPH), b"\xa4\x06", field(7, GRAPH)),
    "a group that does not end": DRAWING.SerializeToString() + b"\xa3\x06",
}
_OBSERVATIONS = np.random.default_rng(0).normal(0.0, 1.0, (3, N)).astype(np.float32)


@pytest.mark.parametrize("content", RANDOM.values(), ids=RANDOM)
def test_answers_repeat_in_every_order_and_batch_or_the_file_is_refused(content: ModelProto | bytes) -> None:
    """A scenario's first two answers are the same, whatever was played before and is played beside it."""
    answers: dict[int, list[bytes]] = {0: [], 1: [], 2: []}
    with OnnxPolicy(content if isinstance(content, bytes) else content.SerializeToString()) as policy:
        for order in ([0, 1, 2], [0, 1, 2], [2, 0, 1], [1], [0], [2, 1]):
            try:
                first, _ = policy.predict(_OBSERVATIONS[order], None, np.ones(len(order), bool))
                second, _ = policy.predict(_OBSERVATIONS[order], None, np.zeros(len(order), bool))
            except PolicyError as error:
                assert str(error).isprintable() and not any(answers.values())
                return
            for index, scenario in enumerate(order):
                answers[scenario].append(first[index].tobytes() + second[index].tobytes())
    assert all(len(set(played)) == 1 for played in answers.values())


def test_shipped_policies_are_proven_and_played_as_they_are() -> None:
    files = sorted(POLICIES.glob("*/policy.onnx"))
    assert len(files) > 25 and all(stateless(path.read_bytes()) == path.read_bytes() for path in files)


def test_what_is_played_is_what_was_judged() -> None:
    """What readers may take in two ways is written again in one."""
    twice = RANDOM["two names, the calm one last"]
    assert isinstance(twice, bytes) and OPERATOR in twice
    judged = stateless(twice)
    assert judged is not None and OPERATOR not in judged and stateless(judged) == judged


def changed(**fields: object) -> ModelProto:
    """The calm model with other fields of its graph."""
    content = after("action = Tanh(linear)")
    for name, value in fields.items():
        getattr(content.graph, name).append(value)
    return content


_SEQUENCE = helper.make_tensor_sequence_value_info("kept", TensorProto.FLOAT, [1, M])
_SPARSE = helper.make_sparse_tensor(constant("more", [1.0]), helper.make_tensor("at", TensorProto.INT64, [1], [0]), [M])


@pytest.mark.parametrize(
    "content",
    [
        after("action = Tanh(linear)", ModelProto().graph),
        after("text = Cast<to = 8>(linear); action = Cast<to = 1>(text)"),
        after('text = Constant<value_string = "1">(); action = Tanh(linear)'),
        after("action = com.microsoft.Tanh(linear)"),
        external("weights"),
        changed(value_info=_SEQUENCE),
        changed(sparse_initializer=_SPARSE),
        CALM.SerializeToString() + field(20, b""),
        make_bytes() + field(99, b"unknown"),
        b"\xff" * 20,
    ],
    ids=["graph", "texts", "text", "domain", "weights elsewhere", "sequence", "sparse", "training", "unknown", "none"],
)
def test_scenarios_share_no_session_of_what_is_not_proven(content: ModelProto | bytes) -> None:
    assert stateless(content if isinstance(content, bytes) else content.SerializeToString()) is None
