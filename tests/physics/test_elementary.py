"""The elementary functions against libm and exact arithmetic."""

from __future__ import annotations

import math

import numba
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wtg_gym.systems.elementary import exponential, fma, sine_cosine

ORDINARY = st.floats(-1e100, 1e100, allow_subnormal=False)


@numba.njit
def compiled_fma(a: float, b: float, c: float) -> float:
    return fma(a, b, c)


@given(ORDINARY, ORDINARY, ORDINARY)
@example(-0.0, 1.0, -0.0)
@example(math.inf, 1.0, 0.0)
@example(math.nan, 1.0, 0.0)
@example(1e300, 1e300, 0.0)
@example(-1e300, 1e300, 1.0)
def test_compiled_multiply_add_has_the_bits_of_the_exact_one(a: float, b: float, c: float) -> None:
    assert repr(float(compiled_fma(a, b, c))) == repr(float(fma(a, b, c)))


def test_multiply_add_is_rounded_once() -> None:
    a = 1.0 + 2.0**-30
    assert fma(a, a, -1.0 - 2.0**-29) == 2.0**-60
    assert a * a - (1.0 + 2.0**-29) == 0.0


@given(st.floats(-1e4, 1e4), st.floats(-39.9, 0.0))
def test_sine_cosine_and_exponential_agree_with_libm(angle: float, exponent: float) -> None:
    assert sine_cosine(angle) == pytest.approx((math.sin(angle), math.cos(angle)), abs=4e-15, rel=0.0)
    assert exponential(exponent) == pytest.approx(math.exp(exponent), rel=3e-14, abs=0.0)


def test_zero_is_exact() -> None:
    assert sine_cosine(0.0) == (0.0, 1.0) and exponential(0.0) == 1.0
