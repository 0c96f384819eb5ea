"""Streams of numpy's default generator, compiled: the same bits, without an object or a lock per stream.

`np.random.default_rng([seed, key])` is a SeedSequence, a PCG64 and, for normal numbers, a ziggurat. A compiled ziggurat
takes a third of the time, and it keeps the benchmark's scenarios what they are should numpy ever change its own.

Sources: M. E. O'Neill, "PCG: a family of simple fast space-efficient statistically good algorithms for random number
generation", 2014 (PCG XSL RR 128/64); J. A. Doornik, "An improved ziggurat method to generate normal random samples",
2005; the constants and the table are those of numpy (BSD licence).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from numba import int64, uint64

from wtg_gym.systems.compiled import compiled, inlined, internal

Words = npt.NDArray[np.uint64]
FloatArray = npt.NDArray[np.float64]
#: An unsigned integer; the compiler infers its size.
Word = Any
Span = tuple[float, float]
T = TypeVar("T")
#: Uniform numbers that a picker takes from a stream at a time.
_N_UNIFORMS = 64

#: Per layer of the ziggurat: its width over 2^52, the share of it that lies below the curve times 2^52, the density.
_TABLE: FloatArray = np.load(Path(__file__).with_name("ziggurat.npy"))
_DENSITY = np.ascontiguousarray(_TABLE[2])
#: Width and share again, for positive and then for negative numbers: an index with the sign needs no branch on it.
_WIDTH, _INSIDE = np.concatenate([_TABLE[0], -_TABLE[0]]), np.concatenate([_TABLE[1], _TABLE[1]])
#: Where the tail begins.
_TAIL = 3.6541528853610088
_INVERSE_TAIL = 0.27366123732975828

_MULTIPLIER_HIGH = np.uint64(0x2360ED051FC65DA4)
_MULTIPLIER_LOW = np.uint64(0x4385DF649FCCF645)
_LOW_HALF = np.uint64(0xFFFFFFFF)
_WORD = 2**64 - 1


@inlined
def _high_product(a: Word, b: Word) -> Word:
    """Return the upper 64 bits of a 64 x 64 bit product."""
    half = uint64(32)
    a_low, a_high, b_low, b_high = a & _LOW_HALF, a >> half, b & _LOW_HALF, b >> half
    low, cross, other = a_low * b_low, a_low * b_high, a_high * b_low
    carry = ((low >> half) + (cross & _LOW_HALF) + (other & _LOW_HALF)) >> half
    return a_high * b_high + (cross >> half) + (other >> half) + carry


@internal
def _advance(high: Word, low: Word, add_high: Word, add_low: Word) -> tuple[Word, Word]:
    """Return the 128-bit state, in two words, that follows."""
    product = low * _MULTIPLIER_LOW
    upper = _high_product(low, _MULTIPLIER_LOW) + low * _MULTIPLIER_HIGH + high * _MULTIPLIER_LOW
    total = product + add_low
    return upper + add_high + uint64(total < product), total


@inlined
def _output(high: Word, low: Word) -> Word:
    """Return the 64 random bits of a state: both halves, exclusive-or, rotated."""
    mixed, turn = high ^ low, high >> uint64(58)
    return (mixed >> turn) | (mixed << ((uint64(64) - turn) & uint64(63)))


@inlined
def _unit(bits: Word) -> float:
    """Return a number in [0, 1) from 64 random bits."""
    return float(int64(bits >> uint64(11))) * (1.0 / 9007199254740992.0)


def seed_streams(seeds: Sequence[int], key: int) -> Words:
    """Return the states of one stream per seed, that of `np.random.default_rng([seed, key])`.

    Returns:
        (n_seeds, 4): state and increment, the upper word first.
    """
    found = [np.random.PCG64([seed, key]).state["state"] for seed in seeds]
    words = [(own["state"] >> 64, own["state"] & _WORD, own["inc"] >> 64, own["inc"] & _WORD) for own in found]
    return np.array(words, dtype=np.uint64).reshape(-1, 4)


@compiled
def draw_uniforms(states: Words, uniforms: FloatArray) -> None:
    """Fill uniforms (n, m) with the next m numbers in [0, 1) of each of n streams; states (n, 4) move on."""
    for i in range(states.shape[0]):
        high, low = states[i, 0], states[i, 1]
        for j in range(uniforms.shape[1]):
            high, low = _advance(high, low, states[i, 2], states[i, 3])
            uniforms[i, j] = _unit(_output(high, low))
        states[i, 0], states[i, 1] = high, low


@internal
def _tail(high: Word, low: Word, add_high: Word, add_low: Word) -> tuple[float, Word, Word]:
    """Return a normal number beyond the ziggurat's last layer, and the state after it."""
    while True:
        high, low = _advance(high, low, add_high, add_low)
        beyond = -_INVERSE_TAIL * math.log1p(-_unit(_output(high, low)))
        high, low = _advance(high, low, add_high, add_low)
        height = -math.log1p(-_unit(_output(high, low)))
        if height + height > beyond * beyond:
            return _TAIL + beyond, high, low


@inlined
def _candidate(bits: Word) -> tuple[float, bool]:
    """Return the number that random bits name, and whether it lies inside its layer, as 99 of 100 do."""
    layer = bits & uint64(0x1FF)
    size = float(int64((bits >> uint64(9)) & uint64(0x000FFFFFFFFFFFFF)))
    return size * _WIDTH[layer], size < _INSIDE[layer]


@internal
def _edge(high: Word, low: Word, add_high: Word, add_low: Word, bits: Word, x: float) -> tuple[float, Word, Word]:
    """Return a normal number where the first candidate x lies at the edge of its layer, and the state after it."""
    inside = False
    while not inside:
        layer = bits & uint64(0xFF)
        if layer == uint64(0):
            x, high, low = _tail(high, low, add_high, add_low)
            return (-x if bits & uint64(0x20000) else x), high, low
        high, low = _advance(high, low, add_high, add_low)
        step = (_DENSITY[layer - uint64(1)] - _DENSITY[layer]) * _unit(_output(high, low))
        if step + _DENSITY[layer] < math.exp(-0.5 * x * x):
            break
        high, low = _advance(high, low, add_high, add_low)
        bits = _output(high, low)
        x, inside = _candidate(bits)
    return x, high, low


@internal
def _normal(high: Word, low: Word, add_high: Word, add_low: Word) -> tuple[float, Word, Word]:
    """Return a normal number and the state after it."""
    high, low = _advance(high, low, add_high, add_low)
    bits = _output(high, low)
    x, inside = _candidate(bits)
    # The rare case is a function of its own: in one loop with it the common case takes twice the time.
    if inside:
        return x, high, low
    return _edge(high, low, add_high, add_low, bits, x)


@compiled
def draw_normals(states: Words, scale: FloatArray, normals: FloatArray) -> None:
    """Fill normals (n, m, 2) with the next pairs of normal numbers of each of n streams, of mean 0.

    Args:
        states: (n, 4); they move on.
        scale: standard deviation of each pair (n, m).
        normals: written.
    """
    for i in range(states.shape[0]):
        high, low, add_high, add_low = states[i, 0], states[i, 1], states[i, 2], states[i, 3]
        for j in range(scale.shape[1]):
            first, high, low = _normal(high, low, add_high, add_low)
            second, high, low = _normal(high, low, add_high, add_low)
            normals[i, j, 0], normals[i, j, 1] = first * scale[i, j], second * scale[i, j]
        states[i, 0], states[i, 1] = high, low


# --- plain values -----------------------------------------------------------------------------------------------------


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
