"""The C_p curve and what is derived from it, against the paper's table."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point

BETZ_LIMIT = 16.0 / 27.0


def test_operating_points_round_to_the_printed_digits_of_the_papers_table() -> None:
    best, nominal, limit = (tracking_point(d) for d in (0.0, 0.05, 0.10))
    assert round(best.tip_speed_ratio) == 7
    assert round(best.power_coefficient, 3) == 0.448
    assert round(nominal.tip_speed_ratio, 2) == 7.92
    assert round(limit.tip_speed_ratio, 2) == 8.32


def test_tracking_coefficients_have_their_published_values() -> None:
    values = [tracking_point(d).coefficient for d in (0.0, 0.05, 0.10)]
    assert values == pytest.approx([1.02412, 0.67166, 0.54916], abs=5e-6)


def test_available_power_at_the_papers_winds() -> None:
    assert available_power_pu(np.array([11.4, 8.0])) == pytest.approx([1.01722, 0.35154], abs=5e-6)


def test_optimum_is_a_maximum() -> None:
    best = tracking_point(0.0)
    ratios = np.linspace(2.0, 15.0, 2001)
    assert power_coefficient(ratios).max() <= best.power_coefficient * (1.0 + 1e-12)


@given(st.floats(0.5, 20.0), st.floats(0.0, 30.0))
def test_power_coefficient_never_exceeds_betz_limit(ratio: float, pitch: float) -> None:
    assert power_coefficient(ratio, pitch) < BETZ_LIMIT


@given(st.floats(0.001, 0.5))
def test_deloaded_coefficient_equals_its_definition(deloading: float) -> None:
    # K_d = K_opt (λ_opt/λ_d)³ (1 - d)
    best, point = tracking_point(0.0), tracking_point(deloading)
    expected = best.coefficient * (best.tip_speed_ratio / point.tip_speed_ratio) ** 3 * (1.0 - deloading)
    assert point.coefficient == pytest.approx(expected, rel=1e-10)
    assert point.tip_speed_ratio > best.tip_speed_ratio
