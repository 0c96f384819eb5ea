"""Dataclasses that check their values; each field has unit, source, meaning and range."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import types
from collections.abc import Mapping
from typing import Any, ClassVar, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from wtg_gym.ranges import require_bus, require_count, require_range, require_whole

#: Most items of a list, where its record does not say otherwise.
MOST_ITEMS = 2000


def describe(unit: str, source: str, doc: str) -> dict[str, Any]:
    """Return a field's metadata: its unit, the key of its source in SOURCES, and what it is."""
    return {"unit": unit, "source": source, "doc": doc}


def parameter(default: Any, unit: str, source: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a dataclass field with a default value, :func:`describe`'s metadata and its allowed range."""
    return dataclasses.field(default=default, metadata={**describe(unit, source, doc), "low": low, "high": high})


def required(unit: str, source: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a dataclass field like that of :func:`parameter`, without a default value."""
    return dataclasses.field(metadata={**describe(unit, source, doc), "low": low, "high": high})


def design(default: Any, unit: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a :func:`parameter` that is a design value of this benchmark."""
    return parameter(default, unit, "design", doc, low, high)


@functools.cache
def _kinds(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


class Checked:
    """A dataclass whose fields are checked when it is made: their types, and the ranges that :func:`parameter` gives.

    Numbers become Python's own. A pair of numbers is a span, low to high; an int is a bus number, unless it has a
    range; None is taken where the type says so.

    Raises:
        ValueError: the message names field, value, unit and allowed range.
    """

    #: Fields whose values must rise from each one to the next.
    RISING: ClassVar[tuple[str, ...]] = ()
    #: Most items of single fields; of the others :data:`MOST_ITEMS`.
    MOST: ClassVar[Mapping[str, int]] = types.MappingProxyType({})

    def __post_init__(self) -> None:
        record: Any = type(self)
        for field in dataclasses.fields(record):
            value, kind = getattr(self, field.name), _kinds(record)[field.name]
            if get_origin(kind) in (tuple, list):
                require_items(record, field.name, value)
            checked = _checked(f"{record.__name__}.{field.name}", value, kind, field)
            if checked is not value:
                object.__setattr__(self, field.name, checked)
        values = [getattr(self, name) for name in self.RISING]
        if any(not first < second for first, second in itertools.pairwise(values)):
            given = ", ".join(f"{value:g}" for value in values)
            raise ValueError(f"{record.__name__}: {' < '.join(self.RISING)} must hold, got {given}")


def require_items(record: Any, name: str, value: Any) -> None:
    """Raise a ValueError if a field of a record would have more items than it may, before anything is made of them."""
    if isinstance(value, (tuple, list)):
        most = getattr(record, "MOST", {}).get(name, MOST_ITEMS)
        require_count(f"{record.__name__}.{name}", len(value), most)


def _checked(name: str, value: Any, kind: Any, field: Any, *, is_item: bool = False) -> Any:
    """Return the value of a field, or of an item of it, as its type says, or raise a ValueError."""
    kinds = get_args(kind)
    if type(None) in kinds and value is None:
        return None
    if len(kinds) == 2 and kinds[1] is type(None):
        kind = kinds[0]
    low, high = field.metadata.get("low", -math.inf), field.metadata.get("high", math.inf)
    unit = field.metadata.get("unit", "").removeprefix("-")
    if kind is float:
        return require_range(name, value, low, high, unit)
    if kind is int:
        return require_whole(name, value, low, high) if isinstance(low, int) else require_bus(name, value)
    if kind in (tuple[float, float], tuple[int, int]) and not is_item:
        return _span(name, value, get_args(kind)[0], low, high, unit)
    origin = get_origin(kind)
    if origin is tuple:
        items = get_args(kind)
        if isinstance(value, (tuple, list)):
            if items[-1] is Ellipsis:
                items = items[:1] * len(value)
            if len(items) == len(value):
                pairs = zip(value, items, strict=True)
                return tuple(_checked(name, item, own, field, is_item=True) for item, own in pairs)
    # The origin of an array's annotation is its alias from numpy 2.5 on.
    elif origin in (np.ndarray, npt.NDArray) or isinstance(
        value, kind if origin in (None, types.UnionType) else origin
    ):
        return value
    doc = field.metadata.get("doc")
    raise ValueError(f"{name} must be {field.type}{f' ({doc})' if doc else ''}, got {value!r:.80}")


def _span(name: str, value: Any, number: type, low: float, high: float, unit: str) -> tuple[float, float]:
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(f"{name} must be a pair (low, high) in {low:g} … {high:g} {unit}, got {value!r}".rstrip())
    first, last = (require_range(name, each, low, high, unit) for each in value)
    if first > last:
        raise ValueError(f"{name} must be a pair (low, high), low <= high, got ({first:g}, {last:g}) {unit}".rstrip())
    if number is int and not (first.is_integer() and last.is_integer()):
        raise ValueError(f"{name} must be two whole numbers, got {value}")
    return number(first), number(last)
