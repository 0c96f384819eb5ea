"""Records: quantities that belong together, by name.

A record is a NamedTuple class whose fields are floats or other records. Equations are written with records. In memory
the numbers of a record are neighbours: rows of a block (see :mod:`wtg_gym.physics.layout`), or entries of a structured
array of constants. Everything about that order is made from the class here. A new field needs no other line.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any, get_type_hints

import numpy as np

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


@functools.cache
def dtype(record: type) -> np.dtype[Any]:
    """Return the data type of a record of constants, with :func:`leaves` as names; floats, whole numbers and flags."""
    return np.dtype(
        [(leaf, _DTYPES[kind]) for leaf, kind in zip(leaves(record), kinds_of(record), strict=True)], align=True
    )


def kinds_of(record: type) -> Iterator[Any]:
    """Yield the types of a record's numbers, in the order of :func:`leaves`."""
    for kind in get_type_hints(record).values():
        if is_record(kind):
            yield from kinds_of(kind)
        else:
            yield kind


def flatten(values: Any) -> tuple[Any, ...]:
    """Return the numbers of a record's values, in the order of :func:`leaves`."""
    flat: list[Any] = []
    for value in values:
        flat += flatten(value) if is_record(type(value)) else [value]
    return tuple(flat)


def structured(record: type, entries: Any) -> np.ndarray[Any, np.dtype[Any]]:
    """Return entries of a record as a structured array."""
    return np.array([flatten(entry) for entry in entries], dtype=dtype(record))


def each(function: Callable[..., Any], *records: Any) -> Any:
    """Apply a function of numbers to every number of records of one class; return the record of the results."""
    if not is_record(type(records[0])):
        return function(*records)
    return type(records[0])(*(each(function, *values) for values in zip(*records, strict=True)))
