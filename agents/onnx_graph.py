"""A policy network as an ONNX graph of plain operators.

Every input and output has the batch as its first axis:

    observation (batch, n_observation) float32, state_0, state_1, … (batch, n) float32
    action (batch, n_action) float32, next_state_0, next_state_1, … (batch, n) float32

A policy without memory has no states. All states are zero at the start of an episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

#: Old enough for every onnxruntime that is still around.
OPSET = 17
IR_VERSION = 8
#: Activations that can be exported: their operators, and the attribute of torch that is the operator's alpha.
_OPERATORS: dict[type[nn.Module], tuple[str, str | None]] = {
    nn.ELU: ("Elu", "alpha"),
    nn.LeakyReLU: ("LeakyRelu", "negative_slope"),
    nn.ReLU: ("Relu", None),
    nn.Sigmoid: ("Sigmoid", None),
    nn.Tanh: ("Tanh", None),
}
#: The same as a configuration file names them.
ACTIVATIONS = {f"nn.{kind.__name__}": kind for kind in _OPERATORS}
#: The layers that the export can write, besides nested `nn.Sequential`.
LAYERS: tuple[type[nn.Module], ...] = (nn.Linear, nn.Hardtanh, *_OPERATORS)


@dataclass(frozen=True, kw_only=True)
class Normalization:
    """clip((observation - mean) / std, ± bound) in double precision."""

    #: mean, std: one value per entry of the observation, (n_observation,) float64.
    mean: npt.NDArray[np.float64]
    std: npt.NDArray[np.float64]
    bound: float  # largest magnitude of the result


def normalized(values: torch.Tensor, mean: torch.Tensor, std: torch.Tensor, bound: float) -> torch.Tensor:
    """Return clip((values - mean) / std, ± bound) as float32, computed in the precision of the arguments."""
    return ((values - mean) / std).clamp(-bound, bound).float()


@dataclass(frozen=True, kw_only=True)
class LowPass:
    """Slow copies of some entries of the observation: y += gain (x - y) in every step, from y = x at the start."""

    columns: npt.NDArray[np.int64]  # the entries, (n,) whole numbers
    gain: npt.NDArray[np.float64]  # one per copy, (n,)


@dataclass(frozen=True)
class PolicyNetwork:
    """Observation → normalisation → low pass → LSTM → layers → clip to [-1, 1]: the deterministic action."""

    n_observation: int  # number of entries of the observation
    normalization: Normalization | None  # None where the network sees raw observations
    lstm: nn.LSTM | None  # None for a policy without memory
    layers: Sequence[nn.Module]  # applied one after the other, each of :data:`LAYERS`
    low_pass: LowPass | None = None  # its slow copies follow the observation in what the layers see; not beside an LSTM
    #: One for each of the equal parts of which the observation consists; the network acts for each part by itself, and
    #: sees its size behind it; all its other numbers are of one part. Not beside an LSTM or a low pass. None for a
    #: network that sees and does all.
    sizes: npt.NDArray[np.float32] | None = None


def flat_layers(modules: Sequence[nn.Module]) -> list[nn.Module]:
    """Return the layers in modules one after the other; a ValueError if one is none of :data:`LAYERS`."""
    flat = [layer for module in modules for layer in module.modules() if not isinstance(layer, nn.Sequential)]
    for layer in flat:
        if not isinstance(layer, LAYERS):
            names = ", ".join(each.__name__ for each in LAYERS)
            raise ValueError(f"cannot export a layer {type(layer).__name__}, only {names}")
    return flat


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


def to_onnx(network: PolicyNetwork) -> bytes:
    """Return the file of the policy as ONNX."""
    graph = _Graph()
    value = "observation"
    n_parts, n_observation = 1, network.n_observation
    if network.sizes is not None:
        n_parts = network.sizes.size
        n_observation = n_parts * (network.n_observation - 1)
        value = _parts(graph, value, network.sizes, network.n_observation)
    if network.normalization is not None:
        value = _normalized(graph, value, network.normalization)
    states: list[str] = []
    widths: list[int] = []
    if network.low_pass is not None:
        value, states = _low_passed(graph, value, network.low_pass)
        widths = [network.low_pass.columns.size, 1]
    if network.lstm is not None:
        widths = [network.lstm.hidden_size] * (2 * network.lstm.num_layers)
        for layer in range(network.lstm.num_layers):
            value, cell = _lstm_layer(graph, value, network.lstm, layer)
            states += [value, cell]
    n_action = 0
    for module in network.layers:
        value = _layer(graph, value, module)
        n_action = module.out_features if isinstance(module, nn.Linear) else n_action
    value = graph.add("Clip", value, graph.constant(-1.0), graph.constant(1.0))
    n_action *= n_parts
    if network.sizes is not None:
        value = graph.add("Reshape", value, graph.constant([-1, n_action], np.int64))
    named = {"action": value, **{f"next_state_{i}": state for i, state in enumerate(states)}}
    for name, result in named.items():
        graph.nodes.append(helper.make_node("Identity", [result], [name]))
    inputs = {"observation": n_observation, **{f"state_{i}": width for i, width in enumerate(widths)}}
    outputs = {"action": n_action, **{f"next_state_{i}": width for i, width in enumerate(widths)}}
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


def _parts(graph: _Graph, value: str, sizes: npt.NDArray[np.float32], width: int) -> str:
    """Return the parts of the observation, each with its size behind it, (batch · parts, width)."""
    n_measured = width - 1
    # As many rows as the batch has: zeros plus the sizes.
    zeros = graph.add("Mul", graph.add("Gather", value, graph.constant([0], np.int64), axis=1), graph.constant(0.0))
    value = graph.add("Concat", value, graph.add("Add", zeros, graph.constant(sizes)), axis=1)
    n = sizes.size
    columns = [[*range(i * n_measured, (i + 1) * n_measured), n * n_measured + i] for i in range(n)]
    value = graph.add("Gather", value, graph.constant(np.concatenate(columns), np.int64), axis=1)
    return graph.add("Reshape", value, graph.constant([-1, width], np.int64))


def _normalized(graph: _Graph, value: str, normalization: Normalization) -> str:
    # In double precision, as VecNormalize does it.
    value = graph.add("Cast", value, to=TensorProto.DOUBLE)
    value = graph.add("Sub", value, graph.constant(normalization.mean, np.float64))
    value = graph.add("Div", value, graph.constant(normalization.std, np.float64))
    bounds = (graph.constant(sign * normalization.bound, np.float64) for sign in (-1.0, 1.0))
    return graph.add("Cast", graph.add("Clip", value, *bounds), to=TensorProto.FLOAT)


def _low_passed(graph: _Graph, value: str, low_pass: LowPass) -> tuple[str, list[str]]:
    """Return the observation with its slow copies behind it, and the next states: the copies, and 1 once started."""
    seen = graph.add("Gather", value, graph.constant(low_pass.columns, np.int64), axis=1)
    before = graph.add("Where", graph.add("Greater", "state_1", graph.constant(0.5)), "state_0", seen)
    step = graph.add("Mul", graph.add("Sub", seen, before), graph.constant(low_pass.gain))
    slow = graph.add("Add", before, step)
    started = graph.add("Add", graph.add("Mul", "state_1", graph.constant(0.0)), graph.constant(1.0))
    return graph.add("Concat", value, slow, axis=1), [slow, started]


def _linear(graph: _Graph, value: str, weight: torch.Tensor, bias: torch.Tensor | None) -> str:
    """Return value @ weight.T + bias."""
    inputs = [value, graph.constant(weight.detach().cpu().numpy())]
    if bias is not None:
        inputs.append(graph.constant(bias.detach().cpu().numpy()))
    return graph.add("Gemm", *inputs, transB=1)


def _layer(graph: _Graph, value: str, module: nn.Module) -> str:
    if isinstance(module, nn.Linear):
        return _linear(graph, value, module.weight, module.bias)
    if isinstance(module, nn.Hardtanh):
        return graph.add("Clip", value, graph.constant(module.min_val), graph.constant(module.max_val))
    operator, alpha = _OPERATORS[type(module)]
    return graph.add(operator, value, **({"alpha": float(getattr(module, alpha))} if alpha else {}))


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
