"""Random streams, one for each seed, and plain values picked from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Span = tuple[float, float]
T = TypeVar("T")
#: Uniform numbers that a picker takes from a stream at a time.
_N_UNIFORMS = 64


def seed_streams(seeds: Sequence[int], key: int, attempt: int = 0) -> list[np.random.Generator]:
    """Return one stream per seed; another key or attempt gives others."""
    more = [attempt] if attempt else []
    return [np.random.default_rng([seed, key, *more]) for seed in seeds]


class Picker:
    """Uniform draws of plain Python values."""

    def __init__(self, stream: np.random.Generator) -> None:
        self._stream = stream
        self._left: list[float] = []

    def uniform(self) -> float:
        """Return a number in [0, 1): those of the stream by the block, each block from its end."""
        if not self._left:
            self._left = self._stream.random(_N_UNIFORMS).tolist()
        return self._left.pop()

    def between(self, span: Span) -> float:
        """Return a number of the span low … high."""
        low, high = span
        return low + (high - low) * self.uniform()

    def chance(self, probability: float) -> bool:
        """Return True with a probability."""
        return self.uniform() < probability

    def whole(self, low: int, high: int) -> int:
        """Return one of the whole numbers low … high."""
        return low + int((high - low + 1) * self.uniform())

    def choice(self, options: Sequence[T]) -> T:
        """Return one of the options."""
        return options[self.whole(0, len(options) - 1)]

    def instant(self, window: Span) -> float:
        """Return an instant of the window, to a tenth of a second [s]."""
        return round(self.between(window), 1)
