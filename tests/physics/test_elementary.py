"""The elementary functions against libm and exact arithmetic."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wtg_gym.physics.layout import Layout
from wtg_gym.systems.elementary import exponential, fma, sine_cosine
from wtg_gym.systems.programs import build_table, in_one_table
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import Kind, system

ORDINARY = st.floats(-1e100, 1e100, allow_subnormal=False)


SUMS = Kind(name="sums", rows={"a": float, "b": float, "c": float, "sum": float})
(PROGRAM,) = in_one_table(SUM=(system(SUMS, "sum")(lambda a, b, c: fma(a, b, c)),))
ROUTINE, TABLES = Routine(PROGRAM), build_table((PROGRAM,), Layout({SUMS: 1}, {}))


def compiled_fma(*given: float) -> float:
    block = np.array([*given, 0.0])[:, np.newaxis]
    ROUTINE((block, np.zeros((0, 1))), TABLES)
    return float(block[3, 0])


@given(ORDINARY, ORDINARY, ORDINARY)
@example(-0.0, 1.0, -0.0)
@example(math.inf, 1.0, 0.0)
@example(math.nan, 1.0, 0.0)
@example(1e300, 1e300, 0.0)
@example(-1e300, 1e300, 1.0)
def test_compiled_multiply_add_has_the_bits_of_the_exact_one(a, b, c):
    assert repr(compiled_fma(a, b, c)) == repr(float(fma(a, b, c)))


def test_multiply_add_is_rounded_once_and_zero_is_exact():
    a = 1.0 + 2.0**-30
    assert fma(a, a, -1.0 - 2.0**-29) == 2.0**-60
    assert a * a - (1.0 + 2.0**-29) == 0.0
    assert sine_cosine(0.0) == (0.0, 1.0) and exponential(0.0) == 1.0


@given(st.floats(-1e4, 1e4), st.floats(-39.9, 0.0))
def test_sine_cosine_and_exponential_agree_with_libm(angle, exponent):
    assert sine_cosine(angle) == pytest.approx((math.sin(angle), math.cos(angle)), abs=4e-15, rel=0.0)
    assert exponential(exponent) == pytest.approx(math.exp(exponent), rel=3e-14, abs=0.0)
