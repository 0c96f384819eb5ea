"""Policy files, good and hostile, made by hand; nodes are written as ONNX writes them."""

from pathlib import Path

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper, parser

from wtg_gym.policies import locked_worker

#: Widths of the local observation of two groups, and of both actions.
N, M = 20, 4
#: What is observed at the beginning of an episode, about.
SEEN = [0, 0, 0.7, -0.4, 0.5, -0.2, 0.3, 0, 0, 0, 0, 0, 0.7, -0.7, 0.4, -0.3, 0.3, 0, 0, 0]
TOML = """\
name = "Mine"
authors = ["Jane Doe"]
training_seed = 0
action_mode = "k+tau"
environment = "GFMWTG-14bus-v0"
"""
#: Whether an observation is one that the policy knows: `near` (1, 1).
NEAR = """
apart = Sub(observation, seen); size = Abs(apart); distance = ReduceSum<keepdims = 1>(size, axis);
near = Less(distance, nearest);
"""


def seed(number: int, toml: str = TOML) -> str:
    return toml.replace("training_seed = 0", f"training_seed = {number}")


def folder(path: Path, content: bytes | ModelProto | None = None, toml: str | bytes = TOML) -> Path:
    path.mkdir(parents=True)
    (path / "entry.toml").write_bytes(toml if isinstance(toml, bytes) else toml.encode())
    content = make_bytes() if content is None else content
    (path / "policy.onnx").write_bytes(content if isinstance(content, bytes) else content.SerializeToString())
    return path


def worker(script: Path, code: str) -> str:
    """Path of a program for a policy's process that first runs code, which may replace functions of `worker`."""
    place = str(Path(locked_worker.__file__).parent)
    start = f"import sys\nsys.path.insert(0, {place!r})\nimport locked_worker as worker\n"
    script.write_text(f"{start}{code}\nworker.main()\n", encoding="utf-8")
    return str(script)


def info(name: str, *shape, kind: int = TensorProto.FLOAT):
    return helper.make_tensor_value_info(name, kind, list(shape))


def constant(name: str, value) -> TensorProto:
    """A constant; floating point is single, as everywhere in a policy."""
    array = np.asarray(value)
    return numpy_helper.from_array(array.astype(np.float32) if array.dtype == np.float64 else array, name)


OBSERVATION, ACTION = info("observation", "batch", N), info("action", "batch", M)
WEIGHTS = constant("weights", np.full((N, M), 0.01))
LINEAR = helper.make_node("MatMul", ["observation", "weights"], ["action"])


def nodes_of(text: str, body=None):
    """Nodes, with a semicolon after each; `body` is that of the last one, if it is a loop."""
    nodes = [parser.parse_node(each.strip()) for each in text.split(";") if each.strip()]
    if body is not None:
        nodes[-1].attribute.append(helper.make_attribute("body", body))
    return nodes


def model(nodes=(LINEAR,), inputs=(OBSERVATION,), outputs=(ACTION,), constants=(WEIGHTS,), domains=()) -> ModelProto:
    graph = helper.make_graph(list(nodes), "g", list(inputs), list(outputs), list(constants))
    imports = [helper.make_opsetid("", 17), *(helper.make_opsetid(*domain) for domain in domains)]
    return helper.make_model(graph, opset_imports=imports, ir_version=8)


def make_bytes() -> bytes:
    return model().SerializeToString()


def after(text: str, body=None, **values) -> ModelProto:
    """A linear policy whose action goes through nodes, written as text, from `linear` to `action`."""
    nodes = nodes_of(f"linear = MatMul(observation, weights); {text}", body)
    return model(nodes, constants=[WEIGHTS, *(constant(name, value) for name, value in values.items())])


def with_state(text: str, width: int, **values) -> ModelProto:
    state, following = info("state_0", "batch", width), info("next_state_0", "batch", width)
    constants = [WEIGHTS, *(constant(name, value) for name, value in values.items())]
    return model(nodes_of(text), [OBSERVATION, state], [ACTION, following], constants)


def other(scale: float = 0.02) -> ModelProto:
    return model(constants=[constant("weights", np.full((N, M), scale))])


def linear(n_observation: int, n_action: int, weights=0.01, offset: float = 0.0) -> ModelProto:
    values = {"weights": np.broadcast_to(weights, (n_observation, n_action)).copy(), "offset": offset}
    return model(
        nodes_of("all = MatMul(observation, weights); moved = Add(all, offset); action = Clip(moved, low, high)"),
        [info("observation", "batch", n_observation)],
        [info("action", "batch", n_action)],
        [constant(name, value) for name, value in (values | {"low": -1.0, "high": 1.0}).items()],
    )


def of_v1() -> ModelProto:
    """A linear policy for version v1: four groups, each of which sees what its sensors say."""
    return linear(32, 8)


def trap(seen=SEEN, distance: float = 3.0) -> ModelProto:
    """Not a number near an observation, by default one that real episodes begin with, and nowhere else."""
    known = {"seen": np.float32(seen), "axis": [1], "nearest": distance}
    return after(NEAR + "action = Where(near, nan, linear)", **known, nan=np.nan)


def spin():
    """The body of a loop with a given number of rounds."""
    inputs = [info("trip", kind=TensorProto.INT64), info("on", kind=TensorProto.BOOL), info("kept", "batch", M)]
    outputs = [info("still", kind=TensorProto.BOOL), info("passed", "batch", M)]
    return helper.make_graph(nodes_of("still = Identity(on); passed = Identity(kept)"), "spin", inputs, outputs)


def endless() -> ModelProto:
    return after("action = Loop( , on, linear)", spin(), on=True)


def varint(number: int) -> bytes:
    """Return a number as protobuf writes it."""
    data = b""
    while number > 127:
        data, number = data + bytes([number & 127 | 128]), number >> 7
    return data + bytes([number])


def hidden(content: ModelProto) -> bytes:
    """The graph of a model behind a key of more than 32 bits: readers take it as that of a graph, or as unknown."""
    graph = content.graph.SerializeToString()
    return varint(7 << 3 | 2 | 1 << 32) + varint(len(graph)) + graph


def unseen(content: ModelProto) -> bytes:
    """A model with a hidden graph and no other."""
    shell = ModelProto()
    shell.CopyFrom(content)
    shell.ClearField("graph")
    return shell.SerializeToString() + hidden(content)


def with_function(text: str, domain: str) -> ModelProto:
    """A linear policy that calls a function of its own, which has the name of an operator of ONNX."""
    content = after(f"action = {domain + '.' if domain else ''}Tanh(linear)")
    imports = [helper.make_opsetid("", 17)]
    content.functions.append(helper.make_function(domain, "Tanh", ["x"], ["y"], nodes_of(text), imports))
    if domain:
        content.opset_import.append(helper.make_opsetid(domain, 1))
    return content


def branch(text: str) -> ModelProto:
    content = after("action = If(on)", on=True)
    for name in ("then_branch", "else_branch"):
        graph = helper.make_graph(nodes_of(text), name, [], [info("drawn", 1, M)])
        content.graph.node[-1].attribute.append(helper.make_attribute(name, graph))
    return content


def nested(depth: int) -> bytes:
    data = b""
    for number in [*(b"\x32", b"\x2a", b"\x0a") * depth, b"\x3a"]:
        data = number + varint(len(data)) + data
    return b"\x08\x08" + data


def external(location: str, **more: str) -> ModelProto:
    content = model()
    tensor = content.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in {"location": location, **more}.items():
        tensor.external_data.add(key=key, value=value)
    return content
