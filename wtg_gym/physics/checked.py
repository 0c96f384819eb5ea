"""Dataclasses of parameters that check their values; each field has unit, source, meaning and range."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from typing import Any, ClassVar, get_args, get_origin, get_type_hints

from wtg_gym.ranges import require_bus, require_range


def describe(unit: str, source: str, doc: str) -> dict[str, Any]:
    """Return a field's metadata: its unit, the key of its source in SOURCES, and what it is."""
    return {"unit": unit, "source": source, "doc": doc}


def parameter(default: Any, unit: str, source: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a dataclass field with a default value, :func:`describe`'s metadata and its allowed range."""
    return dataclasses.field(default=default, metadata={**describe(unit, source, doc), "low": low, "high": high})


def required(unit: str, source: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a dataclass field like that of :func:`parameter`, without a default value."""
    return dataclasses.field(metadata={**describe(unit, source, doc), "low": low, "high": high})


@functools.cache
def _kinds(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


class Checked:
    """A dataclass whose fields are checked when it is made: their types, and the ranges that :func:`parameter` gives.

    A field of type int is checked as a bus number.

    Raises:
        ValueError: the message names field, value, unit and allowed range.
    """

    #: Fields whose values must rise from each one to the next.
    RISING: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        record: Any = type(self)
        for field in dataclasses.fields(record):
            name, value = f"{record.__name__}.{field.name}", getattr(self, field.name)
            kind = _kinds(record)[field.name]
            if kind is float or (kind == float | None and value is not None):
                if "low" in field.metadata:
                    unit = field.metadata["unit"].removeprefix("-")
                    require_range(name, value, field.metadata["low"], field.metadata["high"], unit)
            elif kind is int:
                require_bus(name, value)
            elif get_origin(kind) is tuple:
                entry = get_args(kind)[0]
                if not isinstance(value, (tuple, list)) or not all(isinstance(item, entry) for item in value):
                    raise ValueError(f"{name} must be a tuple of {entry.__name__}, got {value!r}")
            elif not isinstance(value, kind):
                raise ValueError(f"{name} must be {field.type}, got {value!r}")
        values = [getattr(self, name) for name in self.RISING]
        if any(not first < second for first, second in itertools.pairwise(values)):
            given = ", ".join(f"{value:g}" for value in values)
            raise ValueError(f"{type(self).__name__}: {' < '.join(self.RISING)} must hold, got {given}")
