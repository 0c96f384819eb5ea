"""Checks of numbers and names, with errors that say what is allowed."""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Collection, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np

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
    """Return the end of an error about an unknown name: "; did you mean 'paper'?", or "" if no known one is near."""
    names = {each.casefold(): str(each) for each in known}
    close = difflib.get_close_matches(str(name).casefold(), names, n=1)
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


def require_bus(name: str, bus: Any) -> int:
    """Return a bus number as an int, or raise a ValueError that names it."""
    if not is_whole(bus) or bus < 1:
        raise ValueError(f"{name} must be a bus number of the network (a positive integer), got {bus!r}")
    return int(bus)


def whole_steps(name: str, interval: float, step: float, step_name: str) -> int:
    """Return how many steps make up an interval [s]; a ValueError if that is no whole number to 1e-6 steps."""
    count = round(interval / step)
    if abs(count * step - interval) > 1e-6 * step:
        raise ValueError(f"{name} = {interval:g} s is not a whole number of {step_name}s of {step:g} s")
    return count
