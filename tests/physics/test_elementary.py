"""The polynomials against libm."""

from __future__ import annotations

import math

import numba
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wtg_gym.physics.elementary import exponential, fma, sine_cosine

ORDINARY = st.floats(-1e100, 1e100, allow_subnormal=False)


@numba.njit
def compiled_fma(a: float, b: float, c: float) -> float:
    return fma(a, b, c)


@given(ORDINARY, ORDINARY, ORDINARY)
@example(-0.0, 1.0, -0.0)
def test_compiled_multiply_add_has_the_bits_of_the_exact_one(a: float, b: float, c: float) -> None:
    assert compiled_fma(a, b, c).hex() == fma(a, b, c).hex()


def test_multiply_add_is_rounded_once() -> None:
    a = 1.0 + 2.0**-30
    assert fma(a, a, -1.0 - 2.0**-29) == 2.0**-60
    assert a * a - (1.0 + 2.0**-29) == 0.0


@pytest.mark.parametrize(
    "values", [(math.inf, 1.0, 0.0), (math.nan, 1.0, 0.0), (1e300, 1e300, 0.0), (-1e300, 1e300, 1.0)]
)
def test_multiply_add_keeps_what_is_not_finite(values: tuple[float, float, float]) -> None:
    assert repr(compiled_fma(*values)) == repr(fma(*values))


@given(st.floats(-1e4, 1e4))
def test_sine_and_cosine_agree_with_libm(angle: float) -> None:
    sine, cosine = sine_cosine(angle)
    assert abs(sine - math.sin(angle)) < 4e-15
    assert abs(cosine - math.cos(angle)) < 4e-15


@given(st.floats(-39.9, 0.0))
def test_exponential_agrees_with_libm(x: float) -> None:
    assert exponential(x) == pytest.approx(math.exp(x), rel=3e-14)


def test_zero_is_exact() -> None:
    assert sine_cosine(0.0) == (0.0, 1.0)
    assert exponential(0.0) == 1.0
