"""Critical frequencies, published and by simulation's own equilibrium."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.physics.statics import critical_frequency_pu, power_margin_pu
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw


@pytest.mark.parametrize(
    ("strategy", "frequency_pu"), [("mppt", 0.99787), ("deloaded-5", 0.99698), ("deloaded-10", 0.99662)]
)
def test_fixed_strategies_lose_their_equilibrium_where_theory_says(strategy: str, frequency_pu: float) -> None:
    assert critical_frequency_pu(STRATEGIES[strategy], 8.0) == pytest.approx(frequency_pu, abs=5e-6)


@given(st.floats(3.0, 25.0))
def test_coordinated_laws_keep_theirs_at_every_wind(wind: float) -> None:
    assert critical_frequency_pu(STRATEGIES["coordinated-piecewise"], wind) is None


@given(st.floats(4.0, 14.0), st.floats(0.5, 5.0))
def test_more_wind_lowers_the_critical_frequency_at_fine_pitch(wind: float, more: float) -> None:
    low, high = (critical_frequency_pu(STRATEGIES["deloaded-5"], v, fine_pitch=True) for v in (wind, wind + more))
    assert low is not None
    assert high is None or high < low


def test_margin_is_zero_at_the_critical_frequency() -> None:
    law = STRATEGIES["mppt"]
    critical = critical_frequency_pu(law, 9.0)
    assert critical is not None
    assert power_margin_pu(critical, law, 9.0) == pytest.approx(0.0, abs=1e-9)
    assert power_margin_pu(critical - 1e-4, law, 9.0) < 0.0 < power_margin_pu(critical + 1e-4, law, 9.0)


def test_impossible_questions_are_named() -> None:
    with pytest.raises(ValueError, match=r"wind = -8 m/s is outside the allowed range 3 … 25 m/s"):
        critical_frequency_pu(STRATEGIES["mppt"], -8.0)
    greedy = TrackingLaw(name="greedy", k_min=3.0, k_nominal=3.0, k_max=3.0)
    with pytest.raises(ValueError, match=r"'greedy' has no equilibrium at 8 m/s even at nominal frequency"):
        critical_frequency_pu(greedy, 8.0)
