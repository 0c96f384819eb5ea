"""Policy files, good and hostile, made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.policies import Entry
from wtg_gym.policies.play import started_lanes

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


def first_observation(suite: str, seed: int, duration_s: float | None = None) -> Any:
    """What a policy observes at the beginning of a test scenario, (N,)."""
    settings = EnvSettings(suite=suite, split="test", duration_s=duration_s)
    with started_lanes(Entry(name="any"), settings, [seed]) as (lanes, _):
        return lanes.observations[0].copy()


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


def seed(number: int, toml: str = TOML) -> str:
    """An entry.toml of another training seed."""
    return toml.replace("training_seed = 0", f"training_seed = {number}")


def make_bytes() -> bytes:
    """The file of a linear policy."""
    return model().SerializeToString()


def near(seen: Any, distance: float) -> tuple[list[Any], list[Any]]:
    """Nodes and constants of `near` (1, 1), whether an observation is one that the policy knows."""
    nodes = [
        node("Sub", ["observation", "seen"], "apart"),
        node("Abs", ["apart"], "size"),
        node("ReduceSum", ["size", "axis"], "distance", keepdims=1),
        node("Less", ["distance", "nearest"], "near"),
    ]
    return nodes, [constant("seen", seen), constant("axis", [1], np.int64), constant("nearest", distance)]


def trap(seen: Any = SEEN, distance: float = 3.0) -> ModelProto:
    """Not a number near an observation, by default one that real episodes begin with, and nowhere else."""
    nodes, constants = near(seen, distance)
    nodes += [node("Where", ["near", "nan", "linear"], "action")]
    return after(*nodes, constants=[*constants, constant("nan", np.nan)])


def later(seen: Any, distance: float, *nodes: Any, constants: Sequence[Any] = (), steps: float = 20.0) -> ModelProto:
    """A linear policy that knows an episode by its beginning, and turns `fire` (1, 1) to true some steps later.

    Its nodes make `action` of `linear` and `fire`.
    """
    known, own = near(seen, distance)
    known += [
        node("Cast", ["near"], "started", to=TensorProto.FLOAT),
        node("Sign", ["state_0"], "running"),
        node("Max", ["started", "running"], "counted"),
        node("Add", ["state_0", "counted"], "next_state_0"),
        node("Greater", ["next_state_0", "steps"], "fire"),
        node("MatMul", ["observation", "weights"], "linear"),
    ]
    state, following = info("state_0", "batch", 1), info("next_state_0", "batch", 1)
    own += [WEIGHTS, constant("steps", steps), *constants]
    return model([*known, *nodes], [OBSERVATION, state], [ACTION, following], own)


def turns_nan(seen: Any, distance: float) -> ModelProto:
    """Not a number in the middle of an episode that it knows."""
    return later(
        seen, distance, node("Where", ["fire", "nan", "linear"], "action"), constants=[constant("nan", np.nan)]
    )


def divides(seen: Any, distance: float, operator: str, number: int, by: int) -> ModelProto:
    """Divides whole numbers in the middle of an episode that it knows; elsewhere it divides by 1."""
    nodes = [
        node("Where", ["fire", "by", "one"], "divisor"),
        node(operator, ["number", "divisor"], "quotient"),
        node("Cast", ["quotient"], "as_float", to=TensorProto.FLOAT),
        node("Mul", ["as_float", "nought"], "nothing"),
        node("Add", ["linear", "nothing"], "action"),
    ]
    own = [constant("number", [[number]], np.int32), constant("by", by, np.int32), constant("one", 1, np.int32)]
    return later(seen, distance, *nodes, constants=[*own, constant("nought", 0.0)])


def hangs(seen: Any, distance: float) -> ModelProto:
    """A loop that does not end in the middle of an episode that it knows; elsewhere it ends at once."""
    nodes = [
        node("Where", ["fire", "many", "one"], "trips"),
        node("Reshape", ["trips", "one"], "trip"),
        node("Loop", ["trip", "", "linear"], "action", body=spin()),
    ]
    return later(
        seen, distance, *nodes, constants=[constant("many", [2**62], np.int64), constant("one", [1], np.int64)]
    )


def grows(seen: Any, distance: float) -> ModelProto:
    """Asks for 10¹¹ numbers in the middle of an episode that it knows; elsewhere for one."""
    nodes = [
        node("Where", ["fire", "many", "one"], "sizes"),
        node("Reshape", ["sizes", "one"], "length"),
        node("Expand", ["nought", "length"], "much"),
        node("ReduceMax", ["much"], "most", keepdims=0),
        node("Add", ["linear", "most"], "action"),
    ]
    own = [constant("many", [10**11], np.int64), constant("one", [1], np.int64), constant("nought", [0.0])]
    return later(seen, distance, *nodes, constants=own)


def changes_shape(seen: Any, distance: float) -> ModelProto:
    """Gives actions of two scenarios in the middle of an episode that it knows."""
    nodes = [
        node("Where", ["fire", "two", "one"], "repeats"),
        node("Reshape", ["repeats", "as_two"], "repeated"),
        node("Tile", ["linear", "repeated"], "action"),
    ]
    own = [constant("two", [[2, 1]], np.int64), constant("one", [[1, 1]], np.int64)]
    return later(seen, distance, *nodes, constants=[*own, constant("as_two", [2], np.int64)])


def points_outside(seen: Any, distance: float) -> ModelProto:
    """Gathers from a place outside of its weights in the middle of an episode that it knows."""
    nodes = [
        node("Where", ["fire", "far", "first"], "places"),
        node("Reshape", ["places", "as_one"], "place"),
        node("Gather", ["linear", "place"], "gathered", axis=0),
        node("Reshape", ["gathered", "shape"], "action"),
    ]
    own = [constant("far", [[10**9]], np.int64), constant("first", [[0]], np.int64)]
    own += [constant("as_one", [1], np.int64), constant("shape", [1, M], np.int64)]
    return later(seen, distance, *nodes, constants=own)


def spin() -> Any:
    """The body of a loop with a given number of rounds."""
    inputs = [info("trip", kind=TensorProto.INT64), info("on", kind=TensorProto.BOOL), info("kept", "batch", M)]
    outputs = [info("still", kind=TensorProto.BOOL), info("passed", "batch", M)]
    nodes = [node("Identity", ["on"], "still"), node("Identity", ["kept"], "passed")]
    return helper.make_graph(nodes, "spin", inputs, outputs)


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


def external(location: str, **more: str) -> ModelProto:
    """Weights that are said to lie in another file."""
    content = model()
    tensor = content.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in {"location": location, **more}.items():
        tensor.external_data.add(key=key, value=value)
    return content


def external_in_constant(location: str) -> ModelProto:
    """The same within a node."""
    tensor = external(location).graph.initializer[0]
    content = model([helper.make_node("Constant", [], ["weights"], value=tensor), LINEAR])
    content.graph.ClearField("initializer")
    return content


def mislabelled(name: str, kind: int, **values: Any) -> ModelProto:
    """A constant whose attribute has the name of one kind of value and the type of another."""
    wrong = helper.make_node("Constant", [], ["axes"])
    attribute = wrong.attribute.add()
    attribute.name, attribute.type = name, kind
    for key, value in values.items():
        given = getattr(attribute, key)
        if isinstance(value, list):
            given.extend(value)
        elif isinstance(value, TensorProto):
            given.CopyFrom(value)
        else:
            setattr(attribute, key, value)
    return after(
        wrong, node("ReduceSum", ["linear", "axes"], "mean", keepdims=1), node("Add", ["mean", "linear"], "action")
    )


def recursive() -> ModelProto:
    """A function that is made of itself."""
    content = model([helper.make_node("f", ["observation"], ["action"], domain="own")], domains=[("own", 1)])
    itself = helper.make_node("f", ["a"], ["b"], domain="own")
    imports = [helper.make_opsetid("", 17), helper.make_opsetid("own", 1)]
    content.functions.append(helper.make_function("own", "f", ["a"], ["b"], [itself], imports))
    return content


def circle() -> ModelProto:
    """A node that needs what it makes."""
    return after(
        node("Add", ["linear", "second"], "first"),
        node("Add", ["first", "linear"], "second"),
        node("Identity", ["second"], "action"),
    )


def tree() -> ModelProto:
    """A decision tree whose only branch leads back to it."""
    nodes: dict[str, Any] = {"treeids": [0, 0], "featureids": [0, 0]}
    nodes |= {"nodeids": [0, 1], "modes": ["BRANCH_LEQ"] * 2, "truenodeids": [1, 0], "falsenodeids": [1, 0]}
    nodes |= {"missing_value_tracks_true": [1, 1], "values": [0.0, 0.0], "hitrates": [1.0, 1.0]}
    targets = {"treeids": [0], "nodeids": [1], "ids": [0], "weights": [1.0]}
    given = {f"nodes_{key}": value for key, value in nodes.items()}
    given |= {f"target_{key}": value for key, value in targets.items()}
    name, domain = "TreeEnsembleRegressor", "ai.onnx.ml"
    regressor = helper.make_node(name, ["observation"], ["action"], domain=domain, n_targets=M, **given)
    return model([regressor], domains=[(domain, 3)])


def sparse() -> ModelProto:
    """Weights as a sparse tensor whose places are outside of it."""
    values, indices = constant("weights", [1.0]), constant("places", [10**12], np.int64)
    content = model(constants=[])
    content.graph.sparse_initializer.append(helper.make_sparse_tensor(values, indices, [N, M]))
    return content


def slow(width: int) -> ModelProto:
    """An operator that takes its time."""
    nodes = [node("Add", ["linear", "wide"], "v0")]
    nodes += [node("Softplus", [f"v{i}"], f"v{i + 1}") for i in range(4)]
    nodes += [node("ReduceMean", ["v4"], "mean", axes=[0], keepdims=1), node("Add", ["mean", "linear"], "action")]
    return after(*nodes, constants=[constant("wide", np.ones((width, M)))])


def much(values: int) -> ModelProto:
    """A few bytes that become many numbers once the file is loaded."""
    nodes = [node("ConstantOfShape", ["size"], "all"), node("ReduceMax", ["all"], "most", keepdims=0)]
    return after(*nodes, node("Add", ["linear", "most"], "action"), constants=[constant("size", [values], np.int64)])


def in_every_session(values: int) -> ModelProto:
    """A few bytes that become many numbers in the session of every scenario."""
    nodes = [
        node("Expand", ["nought", "size"], "all"),
        node("Cast", ["linear"], "whole", to=TensorProto.INT64),
        node("Gather", ["all", "whole"], "nothing"),
    ]
    own = [constant("nought", [0.0]), constant("size", [values], np.int64)]
    return after(*nodes, node("Add", ["linear", "nothing"], "action"), constants=own)


def last_lane() -> ModelProto:
    """Rounding of a batch's last values, which a vector of the processor does not fill, made 10⁸ times as large."""
    nodes = [
        node("Erf", ["linear"], "one"),
        node("Concat", ["linear", "linear", "linear"], "three", axis=0),
        node("Erf", ["three"], "all"),
        node("ReduceMean", ["all"], "two", axes=[0], keepdims=1),
        node("Sub", ["one", "two"], "rounding"),
        node("Mul", ["rounding", "many"], "large"),
        node("Add", ["large", "linear"], "action"),
    ]
    return after(*nodes, constants=[constant("many", 1e8)])


def sums_of_a_state() -> ModelProto:
    """The rounding of a sum of 33 states, which depends on the address of the first, made 10⁸ times as large."""
    nodes = [
        node("Identity", ["numbers"], "next_state_0"),
        node("ReduceSum", ["state_0", "all"], "read", keepdims=0),
        node("ReduceSum", ["numbers", "all"], "known", keepdims=0),
        node("Sub", ["read", "known"], "rounding"),
        node("Mul", ["rounding", "many"], "large"),
        node("MatMul", ["observation", "weights"], "linear"),
        node("Add", ["large", "linear"], "action"),
    ]
    numbers = np.random.default_rng(0).uniform(0.1, 10.0, (1, 33))
    own = [constant("numbers", numbers), constant("all", [0, 1], np.int64), constant("many", 1e8), WEIGHTS]
    state, following = info("state_0", "batch", 33), info("next_state_0", "batch", 33)
    return model(nodes, [OBSERVATION, state], [ACTION, following], own)


def mixed() -> ModelProto:
    """A product of all scenarios' observations, and the number of scenarios."""
    nodes = [
        node("Transpose", ["linear"], "t"),
        node("MatMul", ["linear", "t"], "products"),
        node("ReduceSum", ["products"], "sum", keepdims=1),
        node("Shape", ["linear"], "shape"),
        node("Cast", ["shape"], "sizes", to=TensorProto.FLOAT),
        node("ReduceMax", ["sizes"], "largest", keepdims=0),
        node("Div", ["sum", "largest"], "mean"),
        node("Add", ["mean", "linear"], "action"),
    ]
    return after(*nodes)


def hidden_nan() -> ModelProto:
    """A state that is infinite from the second step on, which no action uses."""
    state, following = info("state_0", "batch", 1), info("next_state_0", "batch", 1)
    nodes = [LINEAR, node("Add", ["state_0", "infinite"], "next_state_0")]
    return model(nodes, [OBSERVATION, state], [ACTION, following], [WEIGHTS, constant("infinite", [[np.inf]])])


def own_domain(operator: str) -> ModelProto:
    """An operator of a library that is not ONNX."""
    foreign = helper.make_node(operator, ["observation"], ["action"], domain="ai.onnx.contrib")
    return model([foreign], domains=[("ai.onnx.contrib", 1)])


def many_states() -> ModelProto:
    """Seventeen large states."""
    nodes = [LINEAR, *(node("Identity", [f"state_{i}"], f"next_state_{i}") for i in range(17))]
    inputs, outputs = ([info(f"{name}_{i}", "batch", 60_000) for i in range(17)] for name in ("state", "next_state"))
    return model(nodes, [OBSERVATION, *inputs], [ACTION, *outputs])


def in_doubles() -> ModelProto:
    """Actions in double precision."""
    nodes = [node("MatMul", ["observation", "weights"], "a"), node("Cast", ["a"], "action", to=TensorProto.DOUBLE)]
    return model(nodes, outputs=[info("action", "batch", M, kind=TensorProto.DOUBLE)])


def endless() -> ModelProto:
    """A loop without an end in every step."""
    loop = node("Loop", ["", "on", "linear"], "action", body=spin())
    return after(loop, constants=[constant("on", True, np.bool_)])


def dropout() -> ModelProto:
    """Half of the actions, drawn anew in every step."""
    return after(
        node("Dropout", ["linear", "half", "yes"], "action"),
        constants=[constant("half", 0.5), constant("yes", True, np.bool_)],
    )


def two_layers(order: Sequence[int]) -> ModelProto:
    """A network whose hidden values come in some order."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(0, 0.1, (N, len(order))), rng.normal(0, 0.3, (len(order), M))
    nodes = [node("MatMul", ["observation", "a"], "hidden"), node("Tanh", ["hidden"], "bent")]
    nodes += [node("MatMul", ["bent", "b"], "action")]
    return model(nodes, constants=[constant("a", first[:, order]), constant("b", second[list(order)])])


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


def of_v1() -> ModelProto:
    """A linear policy for version v1: four groups, each of which sees what its sensors say."""
    return model(
        inputs=[info("observation", "batch", 32)],
        outputs=[info("action", "batch", 8)],
        constants=[constant("weights", np.full((32, 8), 0.01))],
    )


TOML_V1 = TOML.replace("-v0", "-v1")
