"""Policy files, good and hostile, made by hand."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper

#: Widths of the local observation of two groups, and of both actions.
N, M = 20, 4
#: What is observed at the beginning of an episode, about.
SEEN = [0, 0, 0.7, -0.4, 0.5, -0.2, 0.3, 0, 0, 0, 0, 0, 0.7, -0.7, 0.4, -0.3, 0.3, 0, 0, 0]
TOML = """\
name = "Mine"
authors = ["Jane Doe"]
training_seed = 0
action_mode = "k+tau"
"""


def info(name: str, *shape: Any, kind: int = TensorProto.FLOAT) -> Any:
    return helper.make_tensor_value_info(name, kind, list(shape))


OBSERVATION, ACTION = info("observation", "batch", N), info("action", "batch", M)


def constant(name: str, value: Any, dtype: Any = np.float32) -> TensorProto:
    return numpy_helper.from_array(np.asarray(value, dtype=dtype), name)


WEIGHTS = constant("weights", np.full((N, M), 0.01))
LINEAR = helper.make_node("MatMul", ["observation", "weights"], ["action"])


def node(operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> Any:
    return helper.make_node(operator, list(inputs), [output], **attributes)


def model(
    nodes: Sequence[Any] = (LINEAR,),
    inputs: Sequence[Any] = (OBSERVATION,),
    outputs: Sequence[Any] = (ACTION,),
    constants: Sequence[Any] = (WEIGHTS,),
    opset: int = 17,
    ir_version: int = 8,
    domains: Sequence[tuple[str, int]] = (),
) -> ModelProto:
    graph = helper.make_graph(list(nodes), "g", list(inputs), list(outputs), list(constants))
    imports = [helper.make_opsetid("", opset), *(helper.make_opsetid(*domain) for domain in domains)]
    return helper.make_model(graph, opset_imports=imports, ir_version=ir_version)


def after(*nodes: Any, constants: Sequence[Any] = ()) -> ModelProto:
    """A linear policy whose action goes through nodes from `linear` to `action`."""
    first = helper.make_node("MatMul", ["observation", "weights"], ["linear"])
    return model([first, *nodes], constants=[WEIGHTS, *constants])


def folder(path: Path, content: bytes | ModelProto | None = None, toml: str | bytes = TOML) -> Path:
    path.mkdir(parents=True)
    (path / "entry.toml").write_bytes(toml if isinstance(toml, bytes) else toml.encode())
    if content is None:
        content = model()
    (path / "policy.onnx").write_bytes(content if isinstance(content, bytes) else content.SerializeToString())
    return path


def make_bytes() -> bytes:
    """The file of a linear policy."""
    return model().SerializeToString()


# --- hostile ---------------------------------------------------------------------------------------------------------


def zip_bomb() -> bytes:
    """A zip whose one file is fifty megabytes of nothing."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("policy.pth", bytes(50_000_000))
    return buffer.getvalue()


def varint(number: int) -> bytes:
    """Return a number as protobuf writes it."""
    data = b""
    while number > 127:
        data, number = data + bytes([number & 127 | 128]), number >> 7
    return data + bytes([number])


def field(number: bytes, data: bytes) -> bytes:
    """Return a field of protobuf with a length."""
    return number + varint(len(data)) + data


def nested(depth: int) -> bytes:
    """A graph in a node's attribute, in a graph in a node's attribute, and so on."""
    data = b""
    for _ in range(depth):
        for number in (b"\x32", b"\x2a", b"\x0a"):
            data = field(number, data)
    return b"\x08\x08" + field(b"\x3a", data)


def noise(size: int) -> bytes:
    """Bytes without a meaning, the same every time."""
    return np.random.default_rng(0).bytes(size)


def external(location: str = "../../../../etc/passwd") -> ModelProto:
    """Weights that are said to lie in another file."""
    content = model()
    tensor = content.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)
    return content


def external_in_constant() -> ModelProto:
    """The same within a node."""
    content = model([helper.make_node("Constant", [], ["weights"], value=external().graph.initializer[0]), LINEAR])
    content.graph.ClearField("initializer")
    return content


def with_function() -> ModelProto:
    """An operator of the file's own."""
    content = model()
    function = helper.make_function(
        "evil", "f", ["a"], ["b"], [node("Identity", ["a"], "b")], [helper.make_opsetid("", 17)]
    )
    content.functions.append(function)
    return content


def body() -> Any:
    """The inside of a loop."""
    return helper.make_graph([node("Identity", ["c"], "d")], "b", [info("c", 1)], [info("d", 1)])


def own_domain(operator: str) -> ModelProto:
    """An operator of a library that is not ONNX."""
    return model([helper.make_node(operator, ["observation"], ["action"], domain="evil")])


def many_values() -> ModelProto:
    """A few weights that make a hundred thousand values of each of four, in every lane."""
    nodes = [
        node("Unsqueeze", ["linear", "two"], "a"),
        node("MatMul", ["a", "wide"], "b"),
        node("ReduceSum", ["b", "two"], "action", keepdims=0),
    ]
    return after(*nodes, constants=[constant("two", [2], np.int64), constant("wide", np.ones((1, 100_000)))])


def many_products() -> ModelProto:
    """Few weights used many times over."""
    nodes = [node("MatMul", ["linear" if i == 0 else f"v{i - 1}", "square"], f"v{i}") for i in range(60)]
    nodes += [node("Gemm", ["v59", "back"], "action")]
    first = node("MatMul", ["observation", "up"], "linear")
    constants = [
        constant("up", np.zeros((N, 400))),
        constant("square", np.zeros((400, 400))),
        constant("back", np.zeros((400, M))),
    ]
    return model([first, *nodes], constants=constants)


def slow() -> ModelProto:
    """Within every limit of size, but of an operator that takes its time."""
    nodes = [node("Unsqueeze", ["linear", "two"], "a"), node("Add", ["a", "wide"], "v0")]
    nodes += [node("Softplus", [f"v{i}"], f"v{i + 1}") for i in range(4)]
    nodes += [node("ReduceMean", ["v4"], "action", axes=[2], keepdims=0)]
    return after(*nodes, constants=[constant("two", [2], np.int64), constant("wide", np.ones((1, 1, 10_800)))])


def growing() -> ModelProto:
    """A state that doubles in every step."""
    nodes = [LINEAR, node("Mul", ["state_0", "two"], "a"), node("Add", ["a", "one"], "next_state_0")]
    state, following = info("state_0", "batch", 1), info("next_state_0", "batch", 1)
    constants = [WEIGHTS, constant("two", 2.0), constant("one", 1.0)]
    return model(nodes, [OBSERVATION, state], [ACTION, following], constants)


def trap(seen: Any = SEEN, near: float = 3.0) -> ModelProto:
    """Not a number only where a real episode leads: near what is observed at its beginning, and nowhere else."""
    nodes = [
        node("Sub", ["observation", "seen"], "a"),
        node("Abs", ["a"], "b"),
        node("ReduceSum", ["b", "one"], "c", keepdims=1),
        node("Sub", ["c", "near"], "d"),
        node("Sqrt", ["d"], "e"),
        node("Mul", ["e", "nought"], "f"),
        node("Add", ["linear", "f"], "action"),
    ]
    constants = [
        constant("seen", seen),
        constant("one", [1], np.int64),
        constant("near", near),
        constant("nought", 0.0),
    ]
    return after(*nodes, constants=constants)


def disguised() -> ModelProto:
    """The plain policy in other bytes: other names, its weights scaled and scaled back."""
    nodes = [node("MatMul", ["observation", "w"], "hidden"), node("Mul", ["hidden", "back"], "action")]
    return model(nodes, constants=[constant("w", np.full((N, M), 0.03)), constant("back", 1.0 / 3.0)])


def other(scale: float = 0.02) -> ModelProto:
    """Another policy than the plain one."""
    return model(constants=[constant("weights", np.full((N, M), scale))])


def privileged() -> ModelProto:
    """A policy that sees the state of the grid as well."""
    return model(inputs=[info("observation", "batch", 35)], constants=[constant("weights", np.full((35, M), 0.02))])
