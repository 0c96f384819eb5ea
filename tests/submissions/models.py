"""Policy files, good and hostile, made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper

#: Widths of the local observation of two groups, and of both actions.
N, M = 20, 4
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
