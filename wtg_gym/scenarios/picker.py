"""Uniform draws of plain Python values from the stream of a seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from wtg_gym.scenarios.stream import Words, draw_uniforms

T = TypeVar("T")
Span = tuple[float, float]
#: Uniform numbers that are taken from a stream at a time.
_N_UNIFORMS = 64


def pickers(states: Words) -> Iterator[Picker]:
    """Yield one picker per stream; the numbers that most scenarios need are drawn for all streams at once."""
    first = np.empty((states.shape[0], _N_UNIFORMS))
    draw_uniforms(states, first)
    for state, block in zip(states, first.tolist(), strict=True):
        yield Picker(_uniforms(state[None, :], block).__next__)


def _uniforms(state: Words, block: list[float]) -> Iterator[float]:
    """Yield the numbers of a stream by the block, each block from its end."""
    while True:
        yield from reversed(block)
        more = np.empty((1, _N_UNIFORMS))
        draw_uniforms(state, more)
        block = more[0].tolist()


class Picker:
    """Uniform draws of plain Python values."""

    def __init__(self, uniform: Callable[[], float]) -> None:
        self.uniform = uniform

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
