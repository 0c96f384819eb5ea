"""Records: quantities that belong together, by name.

A record is a NamedTuple class whose fields are floats or other records. Equations are written with records. In memory
the numbers of a record are neighbours: rows of a block (see :mod:`wtg_gym.physics.layout`), or entries of a structured
array of constants. Everything about that order is made from the class here: row numbers, names, and the compiled
functions that load, store and combine records. A new field needs no other line.
"""

from __future__ import annotations

import functools
import linecache
from collections import namedtuple
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

from wtg_gym.systems.compiled import inlined

R = TypeVar("R", bound=tuple[Any, ...])
_DTYPES = {float: np.float64, int: np.int64, bool: np.bool_, complex: np.complex128}


def is_record(kind: Any) -> bool:
    return isinstance(kind, type) and hasattr(kind, "_fields")


@functools.cache
def leaves(record: Any) -> tuple[str, ...]:
    """Return the dotted names of a record's numbers, in their order: ("angle", …, "exciter.lead_lag", …)."""
    names: list[str] = []
    for name, kind in get_type_hints(record).items():
        names += [f"{name}.{leaf}" for leaf in leaves(kind)] if is_record(kind) else [name]
    return tuple(names)


def size(record: Any) -> int:
    """Return how many numbers a record has."""
    return len(leaves(record))


@functools.cache
def short_names(record: Any) -> tuple[str, ...]:
    """Return the last part of each of :func:`leaves`' names: "lead_lag" of "exciter.lead_lag"."""
    return tuple(leaf.rpartition(".")[2] for leaf in leaves(record))


def offsets(record: type) -> Any:
    """Return the row at which each field of a record begins, as a NamedTuple of whole numbers with its field names."""
    rows, row = {}, 0
    for name, kind in get_type_hints(record).items():
        rows[name] = row
        row += size(kind) if is_record(kind) else 1
    return namedtuple(f"{record.__name__}Rows", rows)(**rows)


@functools.cache
def dtype(record: type) -> np.dtype[Any]:
    """Return the data type of a record of constants, with :func:`leaves` as names; floats, whole numbers and flags."""
    return np.dtype(
        [(leaf, _DTYPES[kind]) for leaf, kind in zip(leaves(record), _kinds(record), strict=True)], align=True
    )


def _kinds(record: type) -> Iterator[Any]:
    for kind in get_type_hints(record).values():
        if is_record(kind):
            yield from _kinds(kind)
        else:
            yield kind


def flatten(values: Any) -> tuple[Any, ...]:
    """Return the numbers of a record's values, in the order of :func:`leaves`."""
    flat: list[Any] = []
    for value in values:
        flat += flatten(value) if is_record(type(value)) else [value]
    return tuple(flat)


def loader(record: type[R]) -> Callable[[npt.NDArray[np.float64], int, int], R]:
    """Return `load(block, at, width)`: the record whose numbers are block[at], block[at + width], …"""
    body = _construct(record, iter(f"block[at + {row} * width]" for row in range(size(record))))
    return _function("load", record, "block, at, width", f"return {body}")


def storer(record: type[R]) -> Callable[[R, npt.NDArray[np.float64], int, int], None]:
    """Return `store(values, block, at, width)`, which writes what :func:`loader`'s function reads."""
    lines = [f"block[at + {row} * width] = values.{leaf}" for row, leaf in enumerate(leaves(record))]
    return _function("store", record, "values, block, at, width", "\n    ".join(lines))


def reader(record: type[R]) -> Callable[[Any], R]:
    """Return `read(entry)`: the record of an entry of a structured array of :func:`dtype`."""
    body = _construct(record, iter(f"entry[{leaf!r}]" for leaf in leaves(record)))
    return _function("read", record, "entry", f"return {body}")


def each(function: Callable[..., Any], *records: Any) -> Any:
    """Apply a function of numbers to every number of records of one class; return the record of the results."""
    if not is_record(type(records[0])):
        return function(*records)
    return type(records[0])(*(each(function, *values) for values in zip(*records, strict=True)))


def _construct(record: type, values: Iterator[str]) -> str:
    parts = [_construct(kind, values) if is_record(kind) else next(values) for kind in get_type_hints(record).values()]
    return f"{record.__name__}({', '.join(parts)})"


def _function(name: str, record: type, arguments: str, body: str, **names: Any) -> Callable[..., Any]:
    """Compile a function of the given source, in which the record's classes are known by their names."""
    own = f"{name}_{record.__name__}"
    source = f"def {own}({arguments}):\n    {body}\n"
    file = f"<{record.__module__}.{own}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    space = {**{kind.__name__: kind for kind in _records(record)}, **names, "__name__": record.__module__}
    exec(compile(source, file, "exec"), space)
    function: Callable[..., Any] = inlined(space[own])
    return function


def _records(record: type) -> Iterator[type]:
    yield record
    for kind in get_type_hints(record).values():
        if is_record(kind):
            yield from _records(kind)
