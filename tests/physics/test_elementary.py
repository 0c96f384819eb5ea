"""The polynomials against libm."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.physics.elementary import exponential, sine_cosine


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


def test_exponential_far_below_stays_at_its_floor() -> None:
    assert exponential(-1e6) == exponential(-40.0) < 1e-17
    assert np.isfinite(exponential(-1e300))
