"""Shapes of everything that a policy computes, found without computing it.

A shape is a tuple of lengths, with :data:`BATCH` in place of the number of lanes. Every rule keeps the lanes apart: an
operator that would add them up, mix them, or make a second axis of them is refused. So the size of every value, and
that a lane's action depends on that lane alone, are known beforehand. An operator that has no rule is not allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

#: Stands for the number of lanes.
BATCH = -1
Shape = tuple[int, ...]


@dataclass(frozen=True)
class Value:
    """What is known of a value: its shape, and its content where it is a constant."""

    shape: Shape
    content: npt.NDArray[Any] | None = None


@dataclass(frozen=True)
class Call:
    """One node: operator, inputs (None for one that is left out), attributes, number of outputs."""

    operator: str
    inputs: Sequence[Value | None]
    attributes: Mapping[str, Any]
    n_outputs: int

    def value(self, index: int) -> Value:
        """Return an input that must be there."""
        found = self.inputs[index] if index < len(self.inputs) else None
        if found is None:
            raise ValueError(f"input {index} is missing")
        return found

    def shape(self, index: int = 0) -> Shape:
        """Return the shape of an input that must be there."""
        return self.value(index).shape

    def has(self, index: int) -> bool:
        """Return whether an input is there."""
        return index < len(self.inputs) and self.inputs[index] is not None

    def whole_numbers(self, index: int, attribute: str) -> list[int] | None:
        """Return numbers that an attribute or a constant input gives; None where neither is there."""
        if attribute in self.attributes:
            given = self.attributes[attribute]
            return [int(number) for number in (given if isinstance(given, (list, tuple)) else [given])]
        if not self.has(index):
            return None
        content = self.value(index).content
        if content is None or content.dtype not in (np.int64, np.int32) or content.ndim > 1:
            raise ValueError(f"{attribute} must be a constant list of whole numbers")
        return [int(number) for number in content.reshape(-1)]

    def axis(self, default: int, n_axes: int) -> int:
        """Return the attribute `axis`, counted from the front."""
        return _axis(int(self.attributes.get("axis", default)), n_axes)


def infer(call: Call) -> tuple[list[Shape], int]:
    """Return the shapes of a node's outputs and the multiplications of matrices it needs per lane.

    Raises:
        ValueError: the operator is not allowed, its inputs do not fit, or lanes would be mixed.
    """
    if call.operator not in RULES:
        raise ValueError("the operator is not allowed")
    shapes, products = RULES[call.operator](call)
    for shape in shapes:
        if shape.count(BATCH) > 1:
            raise ValueError("it would make two axes of the lanes")
        if any(length != BATCH and length < 1 for length in shape):
            raise ValueError(f"a value would have no elements: {text(shape)}")
    if len(shapes) < call.n_outputs:
        raise ValueError(f"it has {call.n_outputs} outputs, allowed are at most {len(shapes)}")
    return shapes[: call.n_outputs], products


def elements(shape: Shape) -> int:
    """Return the number of elements per lane."""
    return math.prod(length for length in shape if length != BATCH)


def text(shape: Shape) -> str:
    """Return a shape as people write it."""
    return f"({', '.join('batch' if length == BATCH else str(length) for length in shape)})"


def _axis(axis: int, n_axes: int) -> int:
    if not -n_axes <= axis < n_axes:
        raise ValueError(f"axis {axis} is outside the allowed range {-n_axes} … {n_axes - 1}")
    return axis % n_axes


def _own(shape: Shape, axis: int) -> int:
    """Return the length of an axis that an operator works along."""
    if shape[axis] == BATCH:
        raise ValueError("it works along the axis of the lanes, which must stay apart")
    return shape[axis]


def broadcast(first: Shape, second: Shape) -> Shape:
    """Return the shape of two values combined element by element.

    Raises:
        ValueError: the shapes do not fit, or the lanes would meet another axis.
    """
    n_axes = max(len(first), len(second))
    pairs = zip(
        (1,) * (n_axes - len(first)) + first,
        (1,) * (n_axes - len(second)) + second,
        strict=True,
    )
    lengths = []
    for one, two in pairs:
        if one != two and 1 not in (one, two):
            raise ValueError(f"shapes {text(first)} and {text(second)} do not fit")
        lengths.append(two if one == 1 else one)
    return tuple(lengths)


_Answer = tuple[list[Shape], int]


def _same(call: Call) -> _Answer:
    return [call.shape()], 0


def _clip(call: Call) -> _Answer:
    for index in (1, 2):
        if call.has(index) and elements(call.shape(index)) != 1:
            raise ValueError("its bounds must be single numbers")
        if call.has(index) and BATCH in call.shape(index):
            raise ValueError("its bounds must be constants")
    return [call.shape()], 0


def _elementwise(call: Call) -> _Answer:
    shape = call.shape()
    for index in range(1, len(call.inputs)):
        shape = broadcast(shape, call.shape(index))
    return [shape], 0


def _matmul(call: Call) -> _Answer:
    left, right = call.shape(0), call.shape(1)
    if len(left) < 2 or len(right) < 2:
        raise ValueError("both factors must have two axes or more")
    inner = _own(left, len(left) - 1)
    if _own(right, len(right) - 2) != inner:
        raise ValueError(f"shapes {text(left)} and {text(right)} do not fit")
    shape = (*broadcast(left[:-2], right[:-2]), left[-2], right[-1])
    return [shape], elements(shape) * inner


def _gemm(call: Call) -> _Answer:
    left, right = call.shape(0), call.shape(1)
    if len(left) != 2 or len(right) != 2:
        raise ValueError("both factors must have two axes")
    left = left[::-1] if call.attributes.get("transA", 0) else left
    right = right[::-1] if call.attributes.get("transB", 0) else right
    inner = _own(left, 1)
    if _own(right, 0) != inner:
        raise ValueError(f"shapes {text(left)} and {text(right)} do not fit")
    shape = (left[0], right[1])
    if call.has(2) and broadcast(shape, call.shape(2)) != shape:
        raise ValueError(f"the summand of shape {text(call.shape(2))} does not fit {text(shape)}")
    return [shape], elements(shape) * inner


def _along(call: Call) -> _Answer:
    _own(call.shape(), call.axis(-1, len(call.shape())))
    return [call.shape()], 0


def _layer_normalization(call: Call) -> _Answer:
    shape = call.shape()
    first = call.axis(-1, len(shape))
    for axis in range(first, len(shape)):
        _own(shape, axis)
    for index in range(1, len(call.inputs)):
        if call.has(index) and broadcast(shape, call.shape(index)) != shape:
            raise ValueError(f"shapes {text(shape)} and {text(call.shape(index))} do not fit")
    reduced = shape[:first] + (1,) * (len(shape) - first)
    return [shape, reduced, reduced], 0


def _reduce(call: Call) -> _Answer:
    axes = call.whole_numbers(1, "axes")
    if not axes:
        raise ValueError("its axes must be given")
    shape = call.shape()
    reduced = {_axis(axis, len(shape)) for axis in axes}
    for axis in reduced:
        _own(shape, axis)
    if call.attributes.get("keepdims", 1):
        return [tuple(1 if axis in reduced else length for axis, length in enumerate(shape))], 0
    return [tuple(length for axis, length in enumerate(shape) if axis not in reduced)], 0


def _concat(call: Call) -> _Answer:
    shapes = [call.shape(index) for index in range(len(call.inputs))]
    if "axis" not in call.attributes or not shapes:
        raise ValueError("its axis must be given")
    axis = call.axis(0, len(shapes[0]))
    rest = {shape[:axis] + shape[axis + 1 :] for shape in shapes}
    if len(rest) > 1 or len({len(shape) for shape in shapes}) > 1:
        raise ValueError(f"shapes {', '.join(map(text, shapes))} do not fit")
    length = sum(_own(shape, axis) for shape in shapes)
    return [(*shapes[0][:axis], length, *shapes[0][axis + 1 :])], 0


def _split(call: Call) -> _Answer:
    shape, n = call.shape(), call.n_outputs
    axis = call.axis(0, len(shape))
    length = _own(shape, axis)
    parts = call.whole_numbers(1, "split")
    if parts is None:
        each = -(-length // n)
        parts = [each] * (n - 1) + [length - each * (n - 1)]
    if len(parts) != n or sum(parts) != length or min(parts) < 1:
        raise ValueError(f"{length} elements cannot be split into {parts[:8]}")
    return [(*shape[:axis], part, *shape[axis + 1 :]) for part in parts], 0


def _slice(call: Call) -> _Answer:
    shape = list(call.shape())
    starts, ends = call.whole_numbers(1, "starts"), call.whole_numbers(2, "ends")
    if starts is None or ends is None:
        raise ValueError("its starts and ends must be given")
    axes = call.whole_numbers(3, "axes") or list(range(len(starts)))
    steps = call.whole_numbers(4, "steps") or [1] * len(starts)
    if not len(starts) == len(ends) == len(axes) == len(steps) or 0 in steps:
        raise ValueError("its starts, ends, axes and steps do not fit")
    axes = [_axis(axis, len(shape)) for axis in axes]
    if len(set(axes)) < len(axes) or min(steps) < 1:
        raise ValueError("its axes must differ and its steps be positive")
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        shape[axis] = len(range(*slice(start, end, step).indices(_own(tuple(shape), axis))))
    return [tuple(shape)], 0


def _gather(call: Call) -> _Answer:
    shape, indices = call.shape(), call.value(1)
    axis = call.axis(0, len(shape))
    length = _own(shape, axis)
    if indices.content is None or indices.content.dtype not in (np.int64, np.int32):
        raise ValueError("its indices must be constant whole numbers")
    if (np.abs(indices.content.astype(np.float64) + 0.5) > length).any():
        raise ValueError(f"its indices must be {-length} … {length - 1}")
    return [shape[:axis] + indices.shape + shape[axis + 1 :]], 0


def _without_lanes(shape: Shape, lanes: int) -> None:
    """Before the lanes there may be axes of length 1 only, for each lane's numbers to lie together."""
    if any(length != 1 for length in shape[:lanes]):
        raise ValueError("the lanes must be the first axis that is longer than 1")


def _reshape(call: Call) -> _Answer:
    shape, wanted = call.shape(), call.whole_numbers(1, "shape")
    if wanted is None or len(wanted) > 8 or wanted.count(-1) > 1 or call.attributes.get("allowzero", 0):
        raise ValueError("its shape must be a constant of at most 8 numbers, with one -1 at most, and no allowzero")
    if any(length < -1 for length in wanted):
        raise ValueError(f"a shape must be of lengths from -1 on, got {wanted}")
    lengths = [shape[axis] if length == 0 and axis < len(shape) else length for axis, length in enumerate(wanted)]
    if BATCH in shape:
        _without_lanes(shape, shape.index(BATCH))
        # A -1 may stand for the lanes; one that does not is worked out from the rest, lanes kept by a 0.
        kept = [axis for axis, length in enumerate(wanted) if length == 0 and lengths[axis] == BATCH]
        lanes = kept[0] if kept else wanted.index(-1) if -1 in wanted else None
        if lanes is None:
            raise ValueError("it loses the axis of the lanes")
        open_axes = [axis for axis, length in enumerate(wanted) if length == -1 and axis != lanes]
        _fill(lengths, open_axes, elements(shape), skip=lanes)
        _without_lanes(tuple(lengths), lanes)
        return [tuple(BATCH if axis == lanes else length for axis, length in enumerate(lengths))], 0
    _fill(lengths, [axis for axis, length in enumerate(wanted) if length == -1], elements(shape), skip=None)
    return [tuple(lengths)], 0


def _fill(lengths: list[int], open_axes: list[int], n: int, skip: int | None) -> None:
    """Put in the length of the axis that is worked out, if there is one; `n` elements in all but the axis `skip`."""
    known = math.prod(length for axis, length in enumerate(lengths) if axis != skip and axis not in open_axes)
    for axis in open_axes:
        lengths[axis] = n // known if known > 0 else 0
        known *= lengths[axis]
    if known != n:
        raise ValueError(f"{n} elements per lane do not fit the shape {lengths}")


def _flatten(call: Call) -> _Answer:
    shape = call.shape()
    axis = int(call.attributes.get("axis", 1))
    axis = axis + len(shape) if axis < 0 else axis
    if BATCH in shape:
        lanes = shape.index(BATCH)
        _without_lanes(shape, lanes)
        if axis != lanes + 1:
            raise ValueError("it must flatten the axes after the lanes")
        return [(BATCH, elements(shape))], 0
    return [(math.prod(shape[:axis]), math.prod(shape[axis:]))], 0


def _squeeze(call: Call) -> _Answer:
    axes = call.whole_numbers(1, "axes")
    if not axes:
        raise ValueError("its axes must be given")
    shape = call.shape()
    removed = {_axis(axis, len(shape)) for axis in axes}
    if any(shape[axis] != 1 for axis in removed):
        raise ValueError(f"axes {sorted(removed)} of {text(shape)} are not all of length 1")
    return [tuple(length for axis, length in enumerate(shape) if axis not in removed)], 0


def _unsqueeze(call: Call) -> _Answer:
    axes = call.whole_numbers(1, "axes")
    if not axes or len(axes) > 8:
        raise ValueError("its axes must be given, at most 8")
    n_axes = len(call.shape()) + len(axes)
    added = {_axis(axis, n_axes) for axis in axes}
    if len(added) < len(axes):
        raise ValueError("its axes must differ")
    rest = iter(call.shape())
    return [tuple(1 if axis in added else next(rest) for axis in range(n_axes))], 0


def _transpose(call: Call) -> _Answer:
    shape = call.shape()
    order = list(call.attributes.get("perm", range(len(shape))[::-1]))
    if sorted(order) != list(range(len(shape))):
        raise ValueError(f"perm {order[:8]} is no order of {len(shape)} axes")
    return [tuple(shape[axis] for axis in order)], 0


def _recurrent(gates: int) -> Callable[[Call], _Answer]:
    def rule(call: Call) -> _Answer:
        x, weights, recurrence = call.shape(0), call.shape(1), call.shape(2)
        n_directions = 2 if call.attributes.get("direction", b"forward") == b"bidirectional" else 1
        hidden = int(call.attributes.get("hidden_size", 0))
        if len(x) != 3 or x[1] != BATCH or call.attributes.get("layout", 0) or call.has(4):
            raise ValueError("it must take (steps, batch, values), layout 0, without sequence_lens")
        if weights != (n_directions, gates * hidden, x[2]) or recurrence != (n_directions, gates * hidden, hidden):
            raise ValueError(f"its weights {text(weights)} and {text(recurrence)} do not fit")
        if call.has(3) and call.shape(3) != (n_directions, 2 * gates * hidden):
            raise ValueError(f"its bias {text(call.shape(3))} does not fit")
        state = (n_directions, BATCH, hidden)
        for index in (5, 6):
            if call.has(index) and call.shape(index) != state:
                raise ValueError(f"its initial state {text(call.shape(index))} must be {text(state)}")
        if call.has(7) and call.shape(7) != (n_directions, 3 * hidden):
            raise ValueError(f"its peepholes {text(call.shape(7))} do not fit")
        products = x[0] * n_directions * gates * hidden * (x[2] + hidden)
        return [(x[0], n_directions, BATCH, hidden), state, state], products

    return rule


_UNARY = (
    "Abs Atan Ceil Celu Cos Elu Erf Exp Floor Gelu HardSigmoid HardSwish Identity IsNaN LeakyRelu Log Mish Neg Not "
    "Reciprocal Relu Round Selu Sigmoid Sign Sin Softplus Softsign Sqrt Tan Tanh ThresholdedRelu Cast"
)
_ELEMENTWISE = (
    "Add And Div Equal Greater GreaterOrEqual Less LessOrEqual Max Mean Min Mod Mul Or PRelu Pow Sub Sum Where Xor"
)
_REDUCTIONS = "ReduceL1 ReduceL2 ReduceMax ReduceMean ReduceMin ReduceSum ReduceSumSquare"
#: The operators that are allowed. `Constant` is looked at where the file is read.
RULES: dict[str, Callable[[Call], _Answer]] = {
    **dict.fromkeys(_UNARY.split(), _same),
    **dict.fromkeys(_ELEMENTWISE.split(), _elementwise),
    **dict.fromkeys(_REDUCTIONS.split(), _reduce),
    "Clip": _clip,
    "Concat": _concat,
    "Flatten": _flatten,
    "GRU": _recurrent(3),
    "Gather": _gather,
    "Gemm": _gemm,
    "LSTM": _recurrent(4),
    "LayerNormalization": _layer_normalization,
    "LogSoftmax": _along,
    "MatMul": _matmul,
    "RNN": _recurrent(1),
    "Reshape": _reshape,
    "Slice": _slice,
    "Softmax": _along,
    "Split": _split,
    "Squeeze": _squeeze,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
}

__all__ = ["BATCH", "RULES", "Call", "Shape", "Value", "broadcast", "elements", "infer", "text"]
