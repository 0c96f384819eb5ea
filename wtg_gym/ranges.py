"""Checks of values, and dataclasses that check theirs: each field has unit, source, meaning and range."""

import dataclasses
import difflib
import functools
import inspect
import itertools
import math
import os
import re
import types
from collections.abc import Collection, Iterable, Mapping
from typing import Any, ClassVar, Literal, Self, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

Value = TypeVar("Value")


class ByName(dict[str, Value]):
    """A dictionary of a `kind` of things by name, whose KeyError lists the names, or says why one is `missing`."""

    def __init__(self, kind: str, values: Mapping[str, Value], missing: Mapping[str, str] | None = None) -> None:
        super().__init__(values)
        self._kind = kind
        self._missing = missing or {}

    def __missing__(self, name: Any) -> Value:
        reason = f": {self._missing[name]}" if name in self._missing else ""
        known = f"choose one of {', '.join(self)}{did_you_mean(name, self)}"
        raise KeyError(f"unknown {self._kind} {name!r}{reason}; {known}")


def did_you_mean(name: Any, known: Iterable[str]) -> str:
    """Return the end of an error about an unknown name: "; did you mean 'paper'?", or "" if no known one is near.

    A known name is near if it has the same signs, is spelt alike, or holds the unknown one.
    """
    names, text = {option.casefold(): str(option) for option in known}, str(name).casefold()
    close = [other for other in names if sorted(other) == sorted(text)]
    close = close or difflib.get_close_matches(text, names, n=1, cutoff=0.7)
    close = close or [other for other in names if text in other and len(text) > 2]
    return f"; did you mean {names[close[0]]!r}?" if close else ""


def is_whole(value: Any) -> bool:
    """Return whether a value is an integer of Python or numpy; True and False are not."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def require_range(name: str, value: Any, low: float, high: float, unit: str) -> float:
    """Return `value` as a float, or raise a ValueError that names value, unit and allowed range.

    Limits that are whole numbers (`int`) are named with all their digits.
    """
    # By far the most frequent case, in the drawing of scenarios.
    if type(value) is float and low <= value <= high and math.isfinite(value):
        return value
    digits = ".15g" if isinstance(low, int) and isinstance(high, int) else "g"
    allowed = f"{low:{digits}} … {high:{digits}} {unit}".rstrip()
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ValueError(f"{name} must be a number in {allowed}, got {value!r}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or not low <= number <= high:
        raise ValueError(f"{name} = {number:{digits}} {unit}".rstrip() + f" is outside the allowed range {allowed}")
    return number


def require_whole(name: str, value: Any, low: int, high: float = math.inf) -> int:
    """Return a whole number as an int, or raise a ValueError that names value and allowed range."""
    if not is_whole(value) or not low <= value <= high:
        allowed = f"of {low} or more" if high == math.inf else f"in {low} … {high}"
        raise ValueError(f"{name} must be a whole number {allowed}, got {value!r}")
    return int(value)


def require_count(name: str, count: int, most: int) -> None:
    """Raise a ValueError that names how many items a list has, if there are more than allowed."""
    if count > most:
        raise ValueError(f"{name} has {count} items; allowed: at most {most}")


def require_memory(what: str, n_bytes: int) -> None:
    """Raise a ValueError if arrays would need more than the machine's memory, where the system tells how much it has.

    It would give that much and end the process later, when the arrays are filled.
    """
    if hasattr(os, "sysconf"):
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        if n_bytes > memory:
            raise ValueError(f"{what} need {n_bytes / 2**30:.3g} GiB of memory; this machine has {memory / 2**30:.3g}")


def require_known(what: str, names: Iterable[Any], known: Collection[str]) -> None:
    """Raise a ValueError that names what is given and not known, and what is known."""
    if unknown := sorted(map(str, set(names) - set(known))):
        raise ValueError(f"unknown {what} {unknown}; known {what}: {', '.join(known)}{did_you_mean(unknown[0], known)}")


def require_choice(name: str, value: Any, choices: Collection[str]) -> None:
    """Raise a ValueError that names a value which is none of the choices, and the choices."""
    if not isinstance(value, str) or value not in choices:
        known = f"choose one of {', '.join(choices)}{did_you_mean(value, choices)}"
        raise ValueError(f"unknown {name} {value!r}; {known}")


def whole_steps(name: str, interval: float, step: float, step_name: str) -> int:
    """Return how many steps make up an interval [s]; a ValueError if the number is not whole to 1e-6 steps."""
    count = round(interval / step)
    if abs(count * step - interval) > 1e-6 * step:
        raise ValueError(f"{name} = {interval:g} s is not a whole number of {step_name}s of {step:g} s")
    return count


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
    range; None is taken where the type says so. A ValueError names field, value, unit and allowed range.
    """

    #: Fields whose values must rise from each one to the next.
    RISING: ClassVar[tuple[str, ...]] = ()
    #: Most items of single fields; of the others :data:`MOST_ITEMS`.
    MOST: ClassVar[Mapping[str, int]] = types.MappingProxyType({})

    def __new__(cls, *_: Any, **values: Any) -> Self:
        # A subclass that is no dataclass may take others.
        if "__dataclass_fields__" in vars(cls):
            known = [field.name for field in dataclasses.fields(cls) if field.init]  # type: ignore[arg-type]
            require_known(f"arguments of {cls.__name__}", values, known)
        return super().__new__(cls)

    def __post_init__(self) -> None:
        record: Any = type(self)
        for field in dataclasses.fields(record):
            value, hint = getattr(self, field.name), _kinds(record)[field.name]
            if get_origin(hint) in (tuple, list):
                require_items(record, field.name, value)
            checked = _checked(f"{record.__name__}.{field.name}", value, hint, field)
            if checked is not value:
                object.__setattr__(self, field.name, checked)
        values = [getattr(self, name) for name in self.RISING]
        if any(not first < second for first, second in itertools.pairwise(values)):
            shown = ", ".join(f"{value:g}" for value in values)
            raise ValueError(f"{record.__name__}: {' < '.join(self.RISING)} must hold, got {shown}")


def require_items(record: Any, name: str, value: Any) -> None:
    """Raise a ValueError if a field of a record would have more items than it may, before anything is made of them."""
    if isinstance(value, (tuple, list)):
        most = getattr(record, "MOST", {}).get(name, MOST_ITEMS)
        require_count(f"{record.__name__}.{name}", len(value), most)


def _checked(name: str, value: Any, hint: Any, field: Any, *, is_item: bool = False) -> Any:
    """Return the value of a field, or of an item of it, as its type says, or raise a ValueError."""
    options = get_args(hint)
    if type(None) in options and value is None:
        return None
    if len(options) == 2 and options[1] is type(None):
        hint = options[0]
    low, high = field.metadata.get("low", -math.inf), field.metadata.get("high", math.inf)
    unit = field.metadata.get("unit", "").removeprefix("-")
    if hint is float:
        return require_range(name, value, low, high, unit)
    if hint is int:
        if isinstance(low, int):
            return require_whole(name, value, low, high)
        if not is_whole(value) or value < 1:
            raise ValueError(f"{name} must be a bus number of the network (a positive integer), got {value!r}")
        return int(value)
    if hint in (tuple[float, float], tuple[int, int]) and not is_item:
        return _span(name, value, get_args(hint)[0], low, high, unit)
    origin = get_origin(hint)
    if origin is Literal:
        require_choice(name, value, get_args(hint))
        return value
    if origin is tuple:
        items = get_args(hint)
        if isinstance(value, (tuple, list)):
            if items[-1] is Ellipsis:
                items = items[:1] * len(value)
            if len(items) == len(value):
                pairs = zip(value, items, strict=True)
                return tuple(_checked(name, item, item_hint, field, is_item=True) for item, item_hint in pairs)
    # The origin of an array's annotation is its alias from numpy 2.5 on.
    elif origin in (np.ndarray, npt.NDArray) or isinstance(
        value, hint if origin in (None, types.UnionType) else origin
    ):
        return value
    doc, form = field.metadata.get("doc"), re.sub(r"\w+\.", "", inspect.formatannotation(field.type))
    if isinstance(hint, type) and issubclass(hint, Checked):
        form = f"{hint.__module__}.{hint.__name__}"
    raise ValueError(f"{name} must be {form}{f' ({doc})' if doc else ''}, got {value!r:.80}")


def _span(name: str, value: Any, number: type, low: float, high: float, unit: str) -> tuple[float, float]:
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(f"{name} must be a pair (low, high) in {low:g} … {high:g} {unit}, got {value!r}".rstrip())
    first, last = (require_range(name, end, low, high, unit) for end in value)
    if first > last:
        raise ValueError(f"{name} must be a pair (low, high), low <= high, got ({first:g}, {last:g}) {unit}".rstrip())
    if number is int and not (first.is_integer() and last.is_integer()):
        raise ValueError(f"{name} must be two whole numbers, got {value}")
    return number(first), number(last)
