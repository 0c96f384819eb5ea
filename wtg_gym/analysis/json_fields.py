"""Checked values of a nested JSON object, and the keys that were never asked for."""

from __future__ import annotations

import math
from typing import Any

#: Keys that only describe.
_DESCRIPTIVE = ("note", "name", "idx", "comment", "Vn", "u")


class Fields:
    """Values of a nested JSON object; an error names the place, the wanted kind and the value.

    A null counts as missing. `unused` collects the places of keys that were never asked for, over the whole file.
    """

    def __init__(self, data: Any, where: str, unused: dict[str, None] | None = None) -> None:
        if not isinstance(data, dict):
            raise ValueError(f"{where} must be an object with named values, got {type(data).__name__}")
        self.data = {key: value for key, value in data.items() if value is not None}
        self.where = where
        self.unused: dict[str, None] = {} if unused is None else unused
        self.unused.update(dict.fromkeys(f"{key} of {where}" for key in self.data if key not in _DESCRIPTIVE))
        if self.data.get("u", 1) == 0:
            raise ValueError(f"{where} is switched off (u = 0); leave it out of the file")

    def get(self, key: str, default: Any = None) -> Any:
        """Return a raw value, and take its key for used."""
        self.unused.pop(f"{key} of {self.where}", None)
        return self.data.get(key, default)

    def number(self, key: str, default: float | None = None, *, positive: bool = False) -> float:
        value = self.get(key, default)
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not is_number or (positive and value <= 0.0):
            raise ValueError(
                f"{key} of {self.where} must be a finite{' positive' if positive else ''} number, got {value!r}"
            )
        return float(value)

    def numbers(self, **keys: str) -> dict[str, Any]:
        """Return positive numbers: the value of each key under the name that it is given for."""
        return {name: self.number(key, positive=True) for name, key in keys.items()}

    def bus(self, key: str = "bus") -> int:
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value != int(value):
            raise ValueError(f"{key} of {self.where} must be a bus number, got {value!r}")
        return int(value)

    def list(self, key: str, *, required: bool = True) -> list[Fields]:
        value = self.get(key)
        if value is None and not required:
            return []
        # A single object stands for a list of one.
        value = [value] if isinstance(value, dict) else value
        if not isinstance(value, list):
            raise ValueError(f"{key} of {self.where} must be a list, got {value!r}")
        return [Fields(item, f"{key}[{i}] of {self.where}", self.unused) for i, item in enumerate(value)]

    def object(self, key: str) -> Fields:
        return Fields(self.get(key), f"{key} of {self.where}", self.unused)
