"""The gate for a policy file: the protobuf is read, nothing in it is run.

The only module of the package that imports `onnx`, which parses and no more. It runs in the isolated process, before
onnxruntime sees the file: a file can be made to need much memory while it is parsed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import AttributeProto, TensorProto, numpy_helper

from wtg_gym.submissions import limits
from wtg_gym.submissions.shapes import BATCH, RULES, Call, Shape, Value, elements, infer, text

#: Element types of constants and casts, and their bytes.
_TYPES = {
    TensorProto.FLOAT: 4,
    TensorProto.DOUBLE: 8,
    TensorProto.INT32: 4,
    TensorProto.INT64: 8,
    TensorProto.BOOL: 1,
}
_PLAIN_ATTRIBUTES = (
    AttributeProto.FLOAT,
    AttributeProto.INT,
    AttributeProto.STRING,
    AttributeProto.FLOATS,
    AttributeProto.INTS,
    AttributeProto.STRINGS,
)
_DOMAINS = ("", "ai.onnx")
_MAX_PORTS = 64
#: The checks of :func:`inspect` in their order.
CHECKS = ("file format", "model", "constants", "operators", "signature", "size")


class Refused(ValueError):
    """The file is refused; the message says why."""


def inspect(content: bytes, n_observation: int, n_action: int) -> list[tuple[str, bool, str]]:
    """Look at a policy file without running it.

    Args:
        content: the file.
        n_observation: width of its observations.
        n_action: width of its actions.

    Returns:
        (check, whether it passed, what was found), in the order of :data:`CHECKS` up to the first that did not pass.
    """
    file = _File(content, n_observation, n_action)
    steps: list[Callable[[], str]] = [
        file.parse,
        file.check_model,
        file.read_constants,
        file.follow_nodes,
        file.check_signature,
        file.check_size,
    ]
    done: list[tuple[str, bool, str]] = []
    for name, step in zip(CHECKS, steps, strict=True):
        try:
            done.append((name, True, step()))
        except Refused as error:
            done.append((name, False, str(error)))
            break
        # Whatever a hostile file makes the parser or a rule stumble over is a reason to refuse it.
        except Exception as error:
            done.append((name, False, f"it cannot be read: {type(error).__name__}: {quoted(str(error))}"))
            break
    return done


def example() -> bytes:
    """Return the file of a policy of one observation and one action."""
    observation, action = (
        onnx.helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", 1]) for name in ("observation", "action")
    )
    weight = numpy_helper.from_array(np.ones((1, 1), dtype=np.float32), "weight")
    node = onnx.helper.make_node("MatMul", ["observation", "weight"], ["action"])
    graph = onnx.helper.make_graph([node], "example", [observation], [action], [weight])
    opset = onnx.helper.make_opsetid("", limits.OPSETS.start)
    model = onnx.helper.make_model(graph, opset_imports=[opset], ir_version=limits.IR_VERSIONS.start)
    content: bytes = model.SerializeToString()
    return content


def quoted(value: str) -> str:
    """Return text of a stranger as at most 80 harmless characters."""
    short = value if len(value) <= 60 else value[:57] + "..."
    return ascii(short)[:80]


class _File:
    def __init__(self, content: bytes, n_observation: int, n_action: int) -> None:
        self._content = content
        self._widths = {"observation": n_observation, "action": n_action}
        self._model: Any = None
        self._values: dict[str, Value] = {}
        self._n_parameters = self._n_values = self._n_products = self._opset = 0

    def parse(self) -> str:
        content = self._content
        for start, what in ((b"PK", "a zip archive"), (b"\x80", "a pickle"), (b"\x1f\x8b", "a gzip archive")):
            if content.startswith(start):
                raise Refused(f"it is {what}, not an ONNX model")
        # onnxruntime would read it with the parser of another format.
        if content[4:8] == b"ORTM":
            raise Refused("it is marked as a file of onnxruntime's own format")
        if not 0 < len(content) <= limits.MODEL_BYTES:
            raise Refused(f"{len(content)} bytes, allowed are 1 … {limits.MODEL_BYTES}")
        model = onnx.ModelProto()
        try:
            model.ParseFromString(content)
        # protobuf's DecodeError is no ValueError, and its package is not named here.
        except Exception as error:
            raise Refused(f"it is no ONNX model: {quoted(str(error))}") from error
        size = model.ByteSize()
        model.DiscardUnknownFields()
        if model.ByteSize() != size:
            raise Refused("it has fields that ONNX does not know")
        if not model.HasField("graph"):
            raise Refused("it is no ONNX model: it has no graph")
        self._model = model
        return f"ONNX, {len(content)} bytes"

    def check_model(self) -> str:
        model, graph = self._model, self._model.graph
        if model.ir_version not in limits.IR_VERSIONS:
            raise Refused(_range("IR version", model.ir_version, limits.IR_VERSIONS))
        for what, found in (
            ("functions", model.functions),
            ("training information", model.training_info),
            ("sparse constants", graph.sparse_initializer),
            ("quantization annotations", graph.quantization_annotation),
        ):
            if len(found):
                raise Refused(f"{what} are not allowed")
        if len(model.opset_import) != 1 or model.opset_import[0].domain not in _DOMAINS:
            domains = [opset.domain for opset in model.opset_import[:4]]
            raise Refused(f"it must import the operators of ONNX alone, it imports the domains {quoted(str(domains))}")
        self._opset = model.opset_import[0].version
        if self._opset not in limits.OPSETS:
            raise Refused(_range("opset", self._opset, limits.OPSETS))
        if not 1 <= len(graph.node) <= limits.NODES:
            raise Refused(f"{len(graph.node)} nodes, allowed are 1 … {limits.NODES}")
        if max(len(graph.initializer), len(graph.value_info)) > 4 * limits.NODES:
            raise Refused(f"more than {4 * limits.NODES} constants or descriptions of values")
        return f"IR version {model.ir_version}, opset {self._opset}, {len(graph.node)} nodes"

    def read_constants(self) -> str:
        for tensor in self._model.graph.initializer:
            self._define(tensor.name, self._constant(tensor))
        for node in self._model.graph.node:
            if node.op_type == "Constant" and node.domain in _DOMAINS:
                if len(node.attribute) != 1 or len(node.output) != 1 or len(node.input):
                    raise Refused("a Constant must have one attribute and one output")
                self._define(node.output[0], self._constant_of(node.attribute[0]))
        return f"{self._n_parameters} numbers, all finite and in the file"

    def _constant_of(self, attribute: Any) -> Value:
        if attribute.ref_attr_name:
            raise Refused("a Constant must not refer to an attribute of a function")
        if attribute.name == "value" and attribute.type == AttributeProto.TENSOR:
            return self._constant(attribute.t)
        numbers: list[Any] | None = {
            "value_float": [attribute.f],
            "value_floats": list(attribute.floats),
            "value_int": [attribute.i],
            "value_ints": list(attribute.ints),
        }.get(attribute.name)
        if numbers is None:
            raise Refused(f"a Constant must not have the attribute {quoted(attribute.name)}")
        kind = np.float32 if "float" in attribute.name else np.int64
        array = np.array(numbers if attribute.name.endswith("s") else numbers[0], dtype=kind)
        return self._counted(array, attribute.name)

    def _constant(self, tensor: Any) -> Value:
        name = quoted(tensor.name)
        if tensor.data_location != TensorProto.DEFAULT or len(tensor.external_data):
            raise Refused(f"constant {name} lies in another file; all must be in policy.onnx")
        if tensor.data_type not in _TYPES:
            raise Refused(f"constant {name} is of type {tensor.data_type}; allowed: {_type_names()}")
        if tensor.HasField("segment"):
            raise Refused(f"constant {name} is a segment")
        dims = list(tensor.dims)
        if len(dims) > limits.AXES or not all(1 <= length <= limits.AXIS_LENGTH for length in dims):
            raise Refused(
                f"constant {name} has the shape {quoted(str(dims[:8]))}; allowed are up to {limits.AXES} axes of "
                f"1 … {limits.AXIS_LENGTH}"
            )
        count = math.prod(dims)
        fields = (tensor.float_data, tensor.double_data, tensor.int32_data, tensor.int64_data)
        typed = sum(map(len, fields)) + len(tensor.uint64_data) + len(tensor.string_data)
        raw = len(tensor.raw_data)
        if (raw, typed) not in ((count * _TYPES[tensor.data_type], 0), (0, count)):
            raise Refused(f"constant {name} of {count} numbers has {raw} bytes and {typed} numbers of content")
        return self._counted(numpy_helper.to_array(tensor), tensor.name)

    def _counted(self, array: npt.NDArray[Any], name: str) -> Value:
        self._n_parameters += array.size
        if self._n_parameters > limits.PARAMETERS:
            raise Refused(f"more than {limits.PARAMETERS} numbers in the constants")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise Refused(f"constant {quoted(name)} has numbers that are not finite")
        return Value(tuple(array.shape), array)

    def _define(self, name: str, value: Value) -> None:
        if not name or name in self._values:
            raise Refused(f"the value {quoted(name)} is given twice, or has no name")
        self._values[name] = value

    def follow_nodes(self) -> str:
        graph = self._model.graph
        used = set()
        for given in graph.input:
            self._define(given.name, Value(self._input_shape(given)))
        for index, node in enumerate(graph.node):
            where = f"node {index}, {quoted(node.op_type)}"
            if node.domain not in _DOMAINS:
                raise Refused(f"{where}: its domain {quoted(node.domain)} is not ONNX's own")
            if node.op_type == "Constant":
                continue
            if node.op_type not in RULES:
                raise Refused(f"{where}: the operator is not allowed; allowed: Constant, {', '.join(sorted(RULES))}")
            if len(node.input) > _MAX_PORTS or not 1 <= len(node.output) <= _MAX_PORTS:
                raise Refused(f"{where}: allowed are at most {_MAX_PORTS} inputs and outputs")
            unknown = [name for name in node.input if name and name not in self._values]
            if unknown:
                raise Refused(f"{where}: its input {quoted(unknown[0])} is not computed before it")
            inputs = [self._values[name] if name else None for name in node.input]
            call = Call(node.op_type, inputs, self._attributes(node, where), len(node.output))
            try:
                shapes, products = infer(call)
            except ValueError as error:
                raise Refused(f"{where}: {error}") from error
            self._n_products += products
            for name, shape in zip(node.output, shapes, strict=True):
                self._count_values(shape, where)
                if name:
                    self._define(name, Value(shape))
            used.add(node.op_type)
        return f"{', '.join(sorted(used))}; the lanes stay apart"

    def _count_values(self, shape: Shape, where: str) -> None:
        if len(shape) > limits.AXES:
            raise Refused(f"{where}: a value of {len(shape)} axes, allowed are {limits.AXES}")
        self._n_values += elements(shape)
        if self._n_values > limits.VALUES_PER_LANE:
            raise Refused(f"{where}: more than {limits.VALUES_PER_LANE} values per lane and step")

    def _input_shape(self, given: Any) -> Shape:
        shape = _declared(given)
        if given.name not in self._widths and shape[1] > limits.AXIS_LENGTH:
            raise Refused(f"input {quoted(given.name)} is {shape[1]} wide, allowed are 1 … {limits.AXIS_LENGTH}")
        return shape

    def _attributes(self, node: Any, where: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for attribute in node.attribute:
            if attribute.ref_attr_name or attribute.type not in _PLAIN_ATTRIBUTES or attribute.name in found:
                raise Refused(f"{where}: its attribute {quoted(attribute.name)} is not a plain number, text or list")
            found[attribute.name] = onnx.helper.get_attribute_value(attribute)
        if node.op_type == "Cast" and found.get("to") not in _TYPES:
            raise Refused(f"{where}: it casts to type {quoted(str(found.get('to')))}; allowed: {_type_names()}")
        return found

    def check_signature(self) -> str:
        graph = self._model.graph
        inputs = {given.name: _declared(given) for given in graph.input}
        outputs = {given.name: _declared(given) for given in graph.output}
        n_states = len(inputs) - 1
        if n_states > limits.STATES:
            raise Refused(f"{n_states} states, allowed are up to {limits.STATES}")
        states = {f"state_{index}" for index in range(n_states)}
        if set(inputs) != {"observation", *states} or set(outputs) != {"action", *(f"next_{name}" for name in states)}:
            raise Refused(
                "it must take observation, state_0, state_1, … and give action, next_state_0, …; it takes "
                f"{quoted(', '.join(inputs))} and gives {quoted(', '.join(outputs))}"
            )
        if len(graph.input) != len(inputs) or len(graph.output) != len(outputs):
            raise Refused("an input or output is given twice")
        for name, shape in (*inputs.items(), *outputs.items()):
            width = self._widths.get(name, inputs.get(name.removeprefix("next_"), shape)[1])
            if shape != (BATCH, width):
                raise Refused(f"{name} must be float32 of shape (batch, {width}), it is {text(shape)}")
            if self._values[name].shape != shape:
                raise Refused(f"{name} says it is {text(shape)}, but {text(self._values[name].shape)} is computed")
        return f"observation of {self._widths['observation']}, action of {self._widths['action']}, {n_states} states"

    def check_size(self) -> str:
        if self._n_products > limits.PRODUCTS_PER_LANE:
            raise Refused(
                f"{self._n_products} multiplications of matrices per lane and step, allowed are up to "
                f"{limits.PRODUCTS_PER_LANE}"
            )
        return (
            f"per lane and step {self._n_values} values, {self._n_products} multiplications of matrices "
            f"(allowed: {limits.VALUES_PER_LANE}, {limits.PRODUCTS_PER_LANE})"
        )


def _declared(given: Any) -> Shape:
    """Return the declared shape of an input or output, which must be (batch, n) of float32."""
    kind = given.type
    if kind.WhichOneof("value") != "tensor_type" or kind.tensor_type.elem_type != TensorProto.FLOAT:
        raise Refused(f"{quoted(given.name)} must be a float32 tensor")
    dims = kind.tensor_type.shape.dim
    # An axis without a name is any length too; a name that is no text trips onnxruntime up.
    named = all(dim.dim_param.isascii() for dim in dims)
    if len(dims) != 2 or dims[0].HasField("dim_value") or dims[1].dim_value < 1 or not named:
        raise Refused(f"{quoted(given.name)} must have the shape (batch, n), with a name for the batch and a number n")
    return (BATCH, dims[1].dim_value)


def _range(what: str, value: int, allowed: range) -> str:
    return f"{what} {value} is outside the allowed range {allowed.start} … {allowed.stop - 1}"


def _type_names() -> str:
    return ", ".join(TensorProto.DataType.Name(number).lower() for number in _TYPES)


__all__ = ["CHECKS", "Refused", "example", "inspect", "quoted"]
