"""Policy files, good and hostile, made by hand; nodes are written as ONNX writes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper, parser

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
TOML_V1 = TOML.replace("-v0", "-v1")


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


def constants_of(values: dict[str, Any]) -> list[TensorProto]:
    """Constants by their names; floating point is single, as everywhere in a policy."""
    arrays = {name: np.asarray(value) for name, value in values.items()}
    return [constant(name, each, np.float32 if each.dtype == np.float64 else None) for name, each in arrays.items()]


def node(operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> Any:
    return helper.make_node(operator, list(inputs), [output], **attributes)


def nodes_of(text: str, **attributes: Any) -> list[Any]:
    """Nodes, with a semicolon after each; the last one gets attributes that cannot be written as text."""
    nodes = [parser.parse_node(each.strip()) for each in text.split(";") if each.strip()]
    nodes[-1].attribute.extend(helper.make_attribute(key, value) for key, value in attributes.items())
    return nodes


def model(
    nodes: Sequence[Any] = (LINEAR,),
    inputs: Sequence[Any] = (OBSERVATION,),
    outputs: Sequence[Any] = (ACTION,),
    constants: Sequence[Any] = (WEIGHTS,),
    domains: Sequence[tuple[str, int]] = (),
) -> ModelProto:
    graph = helper.make_graph(list(nodes), "g", list(inputs), list(outputs), list(constants))
    imports = [helper.make_opsetid("", 17), *(helper.make_opsetid(*domain) for domain in domains)]
    return helper.make_model(graph, opset_imports=imports, ir_version=8)


def after(*nodes: Any, **values: Any) -> ModelProto:
    """A linear policy whose action goes through nodes, as text or as they are, from `linear` to `action`."""
    first = node("MatMul", ["observation", "weights"], "linear")
    rest = [each for given in nodes for each in (nodes_of(given) if isinstance(given, str) else [given])]
    return model([first, *rest], constants=[WEIGHTS, *constants_of(values)])


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


#: Whether an observation is one that the policy knows: `near` (1, 1).
NEAR = """
apart = Sub(observation, seen); size = Abs(apart); distance = ReduceSum<keepdims = 1>(size, axis);
near = Less(distance, nearest);
"""


def trap(seen: Any = SEEN, distance: float = 3.0) -> ModelProto:
    """Not a number near an observation, by default one that real episodes begin with, and nowhere else."""
    known = {"seen": np.float32(seen), "axis": [1], "nearest": distance}
    return after(NEAR + "action = Where(near, nan, linear)", **known, nan=np.nan)


#: `fire` (1, 1) is true twenty steps after `near` was.
LATER = """
started = Cast<to = 1>(near); running = Sign(state_0); counted = Max(started, running);
next_state_0 = Add(state_0, counted); fire = Greater(next_state_0, steps);
linear = MatMul(observation, weights);
"""


def later(seen: Any, distance: float, text: str, body: Any = None, **values: Any) -> ModelProto:
    """A linear policy that knows an episode by its beginning, and turns `fire` to true some steps later.

    Its nodes make `action` of `linear` and `fire`; `body` is that of the last one, if it is a loop.
    """
    known = {"seen": np.float32(seen), "axis": [1], "nearest": distance, "steps": 20.0}
    state, following = info("state_0", "batch", 1), info("next_state_0", "batch", 1)
    nodes = nodes_of(NEAR.strip() + LATER + text.strip(), **({} if body is None else {"body": body}))
    constants = [WEIGHTS, *constants_of(known | values)]
    return model(nodes, [OBSERVATION, state], [ACTION, following], constants)


def turns_nan(seen: Any, distance: float) -> ModelProto:
    """Not a number in the middle of an episode that it knows."""
    return later(seen, distance, "action = Where(fire, nan, linear)", nan=np.nan)


def divides(seen: Any, distance: float, operator: str, number: int, by: int) -> ModelProto:
    """Divides whole numbers in the middle of an episode that it knows; elsewhere it divides by 1."""
    text = f"""
divisor = Where(fire, by, one); quotient = {operator}(number, divisor); as_float = Cast<to = 1>(quotient);
nothing = Mul(as_float, nought); action = Add(linear, nothing);
"""
    whole = {"number": np.int32([[number]]), "by": np.int32(by), "one": np.int32(1)}
    return later(seen, distance, text, **whole, nought=0.0)


def hangs(seen: Any, distance: float) -> ModelProto:
    """A loop that does not end in the middle of an episode that it knows; elsewhere it ends at once."""
    text = "trips = Where(fire, many, one); trip = Reshape(trips, one); action = Loop(trip, , linear);"
    return later(seen, distance, text, spin(), many=[2**62], one=[1])


def grows(seen: Any, distance: float) -> ModelProto:
    """Asks for 10¹¹ numbers in the middle of an episode that it knows; elsewhere for one."""
    text = """
sizes = Where(fire, many, one); length = Reshape(sizes, one); much = Expand(nought, length);
most = ReduceMax<keepdims = 0>(much); action = Add(linear, most);
"""
    return later(seen, distance, text, many=[10**11], one=[1], nought=[0.0])


def changes_shape(seen: Any, distance: float) -> ModelProto:
    """Gives actions of two scenarios in the middle of an episode that it knows."""
    text = "repeats = Where(fire, two, one); repeated = Reshape(repeats, as_two); action = Tile(linear, repeated);"
    return later(seen, distance, text, two=[[2, 1]], one=[[1, 1]], as_two=[2])


def points_outside(seen: Any, distance: float) -> ModelProto:
    """Gathers from a place outside of its weights in the middle of an episode that it knows."""
    text = """
places = Where(fire, far, first); place = Reshape(places, as_one); gathered = Gather<axis = 0>(linear, place);
action = Reshape(gathered, shape);
"""
    return later(seen, distance, text, far=[[10**9]], first=[[0]], as_one=[1], shape=[1, M])


def spin() -> Any:
    """The body of a loop with a given number of rounds."""
    inputs = [info("trip", kind=TensorProto.INT64), info("on", kind=TensorProto.BOOL), info("kept", "batch", M)]
    outputs = [info("still", kind=TensorProto.BOOL), info("passed", "batch", M)]
    return helper.make_graph(nodes_of("still = Identity(on); passed = Identity(kept)"), "spin", inputs, outputs)


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
    return after(wrong, "mean = ReduceSum<keepdims = 1>(linear, axes); action = Add(mean, linear)")


def recursive() -> ModelProto:
    """A function that is made of itself."""
    content = model(nodes_of("action = own.f(observation)"), domains=[("own", 1)])
    imports = [helper.make_opsetid("", 17), helper.make_opsetid("own", 1)]
    content.functions.append(helper.make_function("own", "f", ["a"], ["b"], nodes_of("b = own.f(a)"), imports))
    return content


def circle() -> ModelProto:
    """A node that needs what it makes."""
    return after("first = Add(linear, second); second = Add(first, linear); action = Identity(second)")


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
    text = "v0 = Add(linear, wide); " + "".join(f"v{i + 1} = Softplus(v{i}); " for i in range(4))
    text += "mean = ReduceMean<axes = [0], keepdims = 1>(v4); action = Add(mean, linear)"
    return after(text, wide=np.ones((width, M)))


def much(values: int) -> ModelProto:
    """A few bytes that become many numbers once the file is loaded."""
    text = "all = ConstantOfShape(size); most = ReduceMax<keepdims = 0>(all); action = Add(linear, most)"
    return after(text, size=[values])


def in_every_session(values: int) -> ModelProto:
    """A few bytes that become many numbers in the session of every scenario."""
    text = """
all = Expand(nought, size); whole = Cast<to = 7>(linear); nothing = Gather(all, whole);
action = Add(linear, nothing);
"""
    return after(text, nought=[0.0], size=[values])


def last_lane() -> ModelProto:
    """Rounding of a batch's last values, which a vector of the processor does not fill, made 10⁸ times as large."""
    text = """
one = Erf(linear); three = Concat<axis = 0>(linear, linear, linear); all = Erf(three);
two = ReduceMean<axes = [0], keepdims = 1>(all); rounding = Sub(one, two); large = Mul(rounding, many);
action = Add(large, linear);
"""
    return after(text, many=1e8)


def sums_of_a_state() -> ModelProto:
    """The rounding of a sum of 33 states, which depends on the address of the first, made 10⁸ times as large."""
    text = """
next_state_0 = Identity(numbers); read = ReduceSum<keepdims = 0>(state_0, all);
known = ReduceSum<keepdims = 0>(numbers, all); rounding = Sub(read, known); large = Mul(rounding, many);
linear = MatMul(observation, weights); action = Add(large, linear);
"""
    own = constants_of({"numbers": np.random.default_rng(0).uniform(0.1, 10.0, (1, 33)), "all": [0, 1], "many": 1e8})
    state, following = info("state_0", "batch", 33), info("next_state_0", "batch", 33)
    return model(nodes_of(text), [OBSERVATION, state], [ACTION, following], [*own, WEIGHTS])


def mixed() -> ModelProto:
    """A product of all scenarios' observations, and the number of scenarios."""
    text = """
t = Transpose(linear); products = MatMul(linear, t); sum = ReduceSum<keepdims = 1>(products);
shape = Shape(linear); sizes = Cast<to = 1>(shape); largest = ReduceMax<keepdims = 0>(sizes);
mean = Div(sum, largest); action = Add(mean, linear);
"""
    return after(text)


def hidden_nan() -> ModelProto:
    """A state that is infinite from the second step on, which no action uses."""
    state, following = info("state_0", "batch", 1), info("next_state_0", "batch", 1)
    nodes = [LINEAR, *nodes_of("next_state_0 = Add(state_0, infinite)")]
    return model(nodes, [OBSERVATION, state], [ACTION, following], [WEIGHTS, constant("infinite", [[np.inf]])])


def own_domain(operator: str) -> ModelProto:
    """An operator of a library that is not ONNX."""
    domain = "ai.onnx.contrib"
    return model(nodes_of(f"action = {domain}.{operator}(observation)"), domains=[(domain, 1)])


def many_states() -> ModelProto:
    """Seventeen large states."""
    nodes = [LINEAR, *(node("Identity", [f"state_{i}"], f"next_state_{i}") for i in range(17))]
    inputs, outputs = ([info(f"{name}_{i}", "batch", 60_000) for i in range(17)] for name in ("state", "next_state"))
    return model(nodes, [OBSERVATION, *inputs], [ACTION, *outputs])


def in_doubles() -> ModelProto:
    """Actions in double precision."""
    nodes = nodes_of("a = MatMul(observation, weights); action = Cast<to = 11>(a)")
    return model(nodes, outputs=[info("action", "batch", M, kind=TensorProto.DOUBLE)])


def endless() -> ModelProto:
    """A loop without an end in every step."""
    return after(*nodes_of("action = Loop( , on, linear)", body=spin()), on=True)


def dropout() -> ModelProto:
    """Half of the actions, drawn anew in every step."""
    return after("action = Dropout(linear, half, yes)", half=0.5, yes=True)


def two_layers(order: Sequence[int]) -> ModelProto:
    """A network whose hidden values come in some order."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(0, 0.1, (N, len(order))), rng.normal(0, 0.3, (len(order), M))
    nodes = nodes_of("hidden = MatMul(observation, a); bent = Tanh(hidden); action = MatMul(bent, b)")
    return model(nodes, constants=constants_of({"a": first[:, order], "b": second[list(order)]}))


def disguised() -> ModelProto:
    """The plain policy in other bytes: other names, its weights scaled and scaled back."""
    nodes = nodes_of("hidden = MatMul(observation, w); action = Mul(hidden, back)")
    return model(nodes, constants=constants_of({"w": np.full((N, M), 0.03), "back": 1.0 / 3.0}))


def other(scale: float = 0.02) -> ModelProto:
    """Another policy than the plain one."""
    return model(constants=[constant("weights", np.full((N, M), scale))])


def linear(n_observation: int, n_action: int) -> ModelProto:
    """A linear policy of other widths."""
    weights = constant("weights", np.full((n_observation, n_action), 0.01))
    return model(
        inputs=[info("observation", "batch", n_observation)],
        outputs=[info("action", "batch", n_action)],
        constants=[weights],
    )


def of_v1() -> ModelProto:
    """A linear policy for version v1: four groups, each of which sees what its sensors say."""
    return linear(32, 8)
