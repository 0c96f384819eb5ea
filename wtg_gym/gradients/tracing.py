"""The kernels' own source, run with other arithmetic: numbers that remember, instead of floats.

Nothing of the model is written twice. A kernel is a loop over units and lanes around equations without branches; with
`select`, `min`, `max` and a few more exchanged it runs on one lane of :class:`Rows`, and leaves the program of every
row that it has written.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

from wtg_gym.gradients import expressions as ex

#: Meanings of the kernels' names while they are traced.
ARITHMETIC: dict[str, Any] = {
    "min": ex.smallest,
    "max": ex.largest,
    "abs": ex.absolute,
    "select": ex.select,
    "fma": ex.multiply_add,
    "sine_cosine": ex.sine_cosine,
    "exponential": ex.exponential,
    "math": SimpleNamespace(sqrt=ex.square_root, floor=ex.floor, ceil=ex.ceil, inf=math.inf),
}


def retargeted(
    function: Any, arithmetic: Mapping[str, Any] = ARITHMETIC, done: dict[Any, Any] | None = None
) -> Callable[..., Any]:
    """Return a compiled function's source as a plain function whose names, and its callees', mean `arithmetic`."""
    done = {} if done is None else done
    source = getattr(function, "py_func", function)
    if source in done:
        found: Callable[..., Any] = done[source]
        return found
    names = dict(source.__globals__)
    cells = tuple(types.CellType(cell.cell_contents) for cell in source.__closure__ or ())
    copy = types.FunctionType(source.__code__, names, source.__name__, source.__defaults__, cells)
    done[source] = copy
    for cell in cells:
        if hasattr(cell.cell_contents, "py_func"):
            cell.cell_contents = retargeted(cell.cell_contents, arithmetic, done)
    for name in source.__code__.co_names:
        if name in arithmetic:
            names[name] = arithmetic[name]
        elif hasattr(names.get(name), "py_func"):
            names[name] = retargeted(names[name], arithmetic, done)
    return copy


class Rows(dict[int, Any]):
    """The rows of one lane; a row that is read before it is written comes from `read`."""

    def __init__(self, read: Callable[[int], Any]) -> None:
        super().__init__()
        self._read = read

    def __missing__(self, row: int) -> Any:
        return self._read(int(row))


class Actions:
    """The actions of one lane, in rows of their own behind the block's."""

    def __init__(self, first: int, n_action: int, read: Callable[[int], Any]) -> None:
        self.shape = (1, n_action)
        self._first, self._read = first, read

    def __getitem__(self, place: tuple[int, int]) -> Any:
        return self._read(self._first + place[1])


def traced(kernel: Callable[[Rows], None]) -> dict[int, Any]:
    """Return what a kernel writes, row by row, as numbers of the rows that it reads."""
    rows = Rows(ex.row_of_block)
    kernel(rows)
    return {int(row): value for row, value in rows.items()}
