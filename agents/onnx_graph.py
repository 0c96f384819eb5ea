"""A policy network as an ONNX graph of plain operators.

Every input and output has the batch as its first axis:

    observation (batch, n_observation) float32, state_0, state_1, … (batch, n) float32
    action (batch, n_action) float32, next_state_0, next_state_1, … (batch, n) float32

A policy without memory has no states. All states are zero at the start of an episode.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from agents.networks import Normalization, PolicyNetwork

#: Old enough for every onnxruntime that is still around.
OPSET = 17
IR_VERSION = 8
_OPERATORS: dict[type[nn.Module], str] = {nn.ReLU: "Relu", nn.Sigmoid: "Sigmoid", nn.Tanh: "Tanh"}
_OPERATORS_WITH_ALPHA: dict[type[nn.Module], tuple[str, str]] = {
    nn.ELU: ("Elu", "alpha"),
    nn.LeakyReLU: ("LeakyRelu", "negative_slope"),
}


class _Graph:
    """Collects nodes and constants; every method returns the name of a value."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: Any, dtype: type[np.generic] = np.float32) -> str:
        name = f"constant_{len(self.constants)}"
        array = np.ascontiguousarray(np.asarray(value, dtype=dtype))
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        (output,) = self.add_many(operator, *inputs, n_outputs=1, **attributes)
        return output

    def add_many(self, operator: str, *inputs: str, n_outputs: int, **attributes: Any) -> list[str]:
        outputs = [f"value_{len(self.nodes)}_{index}" for index in range(n_outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), outputs, **attributes))
        return outputs

    def name_output(self, value: str, name: str) -> None:
        self.nodes.append(helper.make_node("Identity", [value], [name]))


def to_onnx(network: PolicyNetwork) -> bytes:
    """Return the file of the policy as ONNX."""
    graph = _Graph()
    value = "observation"
    if network.normalization is not None:
        value = _normalized(graph, value, network.normalization)
    states: list[tuple[str, int]] = []
    if network.lstm is not None:
        for layer in range(network.lstm.num_layers):
            value, cell = _lstm_layer(graph, value, network.lstm, layer)
            states += [(value, network.lstm.hidden_size), (cell, network.lstm.hidden_size)]
    n_action = 0
    for module in network.layers:
        value = _layer(graph, value, module)
        n_action = module.out_features if isinstance(module, nn.Linear) else n_action
    value = graph.add("Clip", value, graph.constant(-1.0), graph.constant(1.0))
    graph.name_output(value, "action")
    for index, (state, _) in enumerate(states):
        graph.name_output(state, f"next_state_{index}")
    inputs = {"observation": network.n_observation, **{f"state_{i}": n for i, (_, n) in enumerate(states)}}
    outputs = {"action": n_action, **{f"next_state_{i}": n for i, (_, n) in enumerate(states)}}
    model = helper.make_model(
        helper.make_graph(graph.nodes, "policy", _infos(inputs), _infos(outputs), graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="wtg_gym",
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _infos(widths: dict[str, int]) -> list[onnx.ValueInfoProto]:
    return [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width]) for name, width in widths.items()]


def _normalized(graph: _Graph, value: str, normalization: Normalization) -> str:
    # In double precision, as VecNormalize does it.
    value = graph.add("Cast", value, to=TensorProto.DOUBLE)
    value = graph.add("Sub", value, graph.constant(normalization.mean, np.float64))
    value = graph.add("Div", value, graph.constant(normalization.std, np.float64))
    bounds = (graph.constant(sign * normalization.bound, np.float64) for sign in (-1.0, 1.0))
    return graph.add("Cast", graph.add("Clip", value, *bounds), to=TensorProto.FLOAT)


def _linear(graph: _Graph, value: str, weight: torch.Tensor, bias: torch.Tensor | None) -> str:
    """Return value @ weight.T + bias."""
    inputs = [value, graph.constant(weight.detach().cpu().numpy())]
    if bias is not None:
        inputs.append(graph.constant(bias.detach().cpu().numpy()))
    return graph.add("Gemm", *inputs, transB=1)


def _layer(graph: _Graph, value: str, module: nn.Module) -> str:
    kind = type(module)
    if isinstance(module, nn.Linear):
        return _linear(graph, value, module.weight, module.bias)
    if isinstance(module, nn.Hardtanh):
        return graph.add("Clip", value, graph.constant(module.min_val), graph.constant(module.max_val))
    if kind in _OPERATORS_WITH_ALPHA:
        operator, attribute = _OPERATORS_WITH_ALPHA[kind]
        return graph.add(operator, value, alpha=float(getattr(module, attribute)))
    return graph.add(_OPERATORS[kind], value)


def _lstm_layer(graph: _Graph, value: str, lstm: nn.LSTM, layer: int) -> tuple[str, str]:
    """Return (hidden, cell) of one layer after one step; gates in torch's order: input, forget, cell, output."""
    hidden, cell = f"state_{2 * layer}", f"state_{2 * layer + 1}"
    parameters = [getattr(lstm, f"{name}_l{layer}") for name in ("weight_ih", "bias_ih", "weight_hh", "bias_hh")]
    gates = graph.add("Add", _linear(graph, value, *parameters[:2]), _linear(graph, hidden, *parameters[2:]))
    i, f, g, o = graph.add_many("Split", gates, n_outputs=4, axis=1)
    kept = graph.add("Mul", graph.add("Sigmoid", f), cell)
    written = graph.add("Mul", graph.add("Sigmoid", i), graph.add("Tanh", g))
    cell = graph.add("Add", kept, written)
    return graph.add("Mul", graph.add("Sigmoid", o), graph.add("Tanh", cell)), cell


__all__ = ["OPSET", "to_onnx"]
