"""A function's own source, run with other arithmetic: numbers that remember, instead of floats.

Nothing of a model is written twice. An equation is a pure function without branches; with `select`, `min`, `max` and a
few more exchanged it runs on :class:`~wtg_gym.systems.expressions.Number`, and leaves the program of its result.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from wtg_gym.systems import expressions as ex

#: Meanings of names in equations while they are traced.
ARITHMETIC: dict[str, Any] = {
    "min": ex.smallest,
    "max": ex.largest,
    "abs": ex.absolute,
    "select": ex.select,
    "fma": ex.multiply_add,
    "sine_cosine": ex.sine_cosine,
    "exponential": ex.exponential,
    "noise": ex.noise,
    "math": SimpleNamespace(
        sqrt=ex.square_root,
        floor=ex.floor,
        ceil=ex.ceil,
        isfinite=ex.is_finite,
        sin=ex.sine_of_libm,
        cos=ex.cosine_of_libm,
        atan2=ex.arc_tangent,
        hypot=ex.hypotenuse,
        inf=math.inf,
        pi=math.pi,
    ),
    # Whole numbers are floats in rows: they stay what they are.
    "np": SimpleNamespace(int64=lambda value: value),
}


def retargeted(function: Any, done: dict[Any, Any] | None = None) -> Callable[..., Any]:
    """Return a function's source as a function whose names, and its callees', have the meanings of `ARITHMETIC`.

    `done` has the functions that were found before.
    """
    done = {} if done is None else done
    source = getattr(function, "py_func", function)
    if source in done:
        found: Callable[..., Any] = done[source]
        return found
    names = dict(source.__globals__)
    cells = tuple(types.CellType(cell.cell_contents) for cell in source.__closure__ or ())
    copy = types.FunctionType(source.__code__, names, source.__name__, source.__defaults__, cells)
    copy.__kwdefaults__ = source.__kwdefaults__
    done[source] = copy

    def converted(value: Any) -> Any:
        if isinstance(getattr(value, "py_func", value), types.FunctionType):
            return retargeted(value, done)
        return tuple(map(converted, value)) if type(value) is tuple else value

    for cell in cells:
        cell.cell_contents = converted(cell.cell_contents)
    for name in _names_in(source.__code__):
        if name in ARITHMETIC or name in names:
            names[name] = ARITHMETIC[name] if name in ARITHMETIC else converted(names[name])
    return copy


def _names_in(code: types.CodeType) -> Iterator[str]:
    """Yield the global names that a function's code, and functions within it, mention."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names_in(constant)
