"""Critical frequencies, published and by simulation's own equilibrium."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.reproduce.power_frequency import characteristic, critical_frequency_pu, named_points
from wtg_gym.reproduce.steady_states import Balance, equilibria, power_margin_pu, stable_equilibrium


@pytest.mark.parametrize(
    ("strategy", "frequency_pu"), [("mppt", 0.99787), ("deloaded-5", 0.99698), ("deloaded-10", 0.99662)]
)
def test_fixed_strategies_lose_their_equilibrium_where_theory_says(strategy: str, frequency_pu: float) -> None:
    assert critical_frequency_pu(STRATEGIES[strategy], 8.0) == pytest.approx(frequency_pu, abs=5e-6)


@settings(max_examples=40)
@given(st.floats(3.0, 25.0))
def test_coordinated_laws_keep_theirs_at_every_wind(wind: float) -> None:
    assert critical_frequency_pu(STRATEGIES["coordinated-piecewise"], wind) is None


@settings(max_examples=40)
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
    greedy = TrackingLaw(name="greedy", k_min=3.0, k_nominal=3.0, k_max=3.0, damping_time_constant_s=0.8)
    with pytest.raises(ValueError, match=r"'greedy' has no equilibrium at 8 m/s from the set-point on upwards"):
        critical_frequency_pu(greedy, 8.0)


LAWS = st.builds(
    lambda k_min, k_nominal, k_max, tau: TrackingLaw(
        name="x", k_min=k_min, k_nominal=k_nominal, k_max=k_max, damping_time_constant_s=tau
    ),
    st.floats(0.05, 3.0),
    st.floats(0.05, 3.0),
    st.floats(0.05, 3.0),
    st.sampled_from([0.0, 0.8, math.inf]),
)


@given(LAWS, st.floats(3.0, 25.0), st.floats(0.98, 1.02), st.booleans())
@example(TrackingLaw(name="x", k_min=1.0, k_nominal=1.0, k_max=0.25), 3.0, 1.015625, False)
def test_every_equilibrium_balances_and_stable_and_unstable_ones_take_turns(
    law: TrackingLaw, wind: float, frequency: float, fine_pitch: bool
) -> None:
    from wtg_gym.physics.aerodynamics import power_coefficient
    from wtg_gym.physics.parameters import TurbineParameters

    turbine = TurbineParameters()
    found = equilibria(frequency, law, wind, fine_pitch=fine_pitch)
    for point in found:
        ratio = turbine.tip_speed_ratio_per_speed_m_s * point.rotor_speed_pu / wind
        captured = turbine.wind_power_pu_per_cubic_wind * wind**3 * float(power_coefficient(ratio, point.pitch_deg))
        assert captured == pytest.approx(point.power_pu, abs=1e-6)
        assert point.tip_speed_ratio == pytest.approx(ratio)
        assert not (fine_pitch and point.pitch_deg)
    # From the slowest on, every second one is stable, the fastest one always.
    assert [point.stable for point in reversed(found)] == [i % 2 == 0 for i in range(len(found))]
    margin = power_margin_pu(frequency, law, wind, fine_pitch=fine_pitch)
    if abs(margin) > 1e-9:
        # Where the droop draws power from the grid even at the pitch's speed limit, the blades may not brake enough.
        balance = Balance(frequency, law, wind, fine_pitch=fine_pitch)
        driven = math.isfinite(balance.speed_limit) and float(balance.delivered(balance.speed_limit)) < 0.0
        braked = not driven or balance.holding_pitch(balance.speed_limit) is not None
        assert any(point.stable for point in found) == (margin > 0.0 and braked)


@settings(max_examples=40)
@given(LAWS, st.floats(4.0, 20.0))
@example(TrackingLaw(name="x", k_min=1.0, k_nominal=2.375, k_max=1.0, damping_time_constant_s=math.inf), 19.0)
def test_equilibrium_is_lost_just_below_the_critical_frequency(law: TrackingLaw, wind: float) -> None:
    try:
        critical = critical_frequency_pu(law, wind)
    except ValueError:
        for frequency in (1.0, 1.004, 1.008, 1.4):
            assert power_margin_pu(frequency, law, wind) < 1e-9
        return
    if critical is None:
        frequencies = np.linspace(0.9, 1.0, 41)
        assert min(power_margin_pu(float(f), law, wind) for f in frequencies) > -1e-9
        return
    assert power_margin_pu(critical, law, wind) == pytest.approx(0.0, abs=1e-9)
    # Between there and the set-point it exists throughout, if it exists at the set-point.
    if critical < 1.0:
        between = np.linspace(critical, 1.0, 31)[1:]
        assert min(power_margin_pu(float(f), law, wind) for f in between) > -1e-9


def test_a_narrow_gap_in_the_characteristic_is_found() -> None:
    """k falls with the frequency while the droop grows: the equilibrium is lost, and comes back further down."""
    law = TrackingLaw(name="dip", k_min=0.04110382, k_nominal=1.90836649, k_max=1.90836649)
    critical = critical_frequency_pu(law, 9.7057825, fine_pitch=True)
    assert critical == pytest.approx(0.99575, abs=5e-5)
    assert equilibria(0.9957276, law, 9.7057825, fine_pitch=True) == ()
    assert equilibria(0.9930, law, 9.7057825, fine_pitch=True)


def test_fast_rotors_of_little_wind_are_found() -> None:
    point = stable_equilibrium(1.008, STRATEGIES["deloaded-5"], 3.0)
    assert point is not None
    assert point.tip_speed_ratio == pytest.approx(22.9, abs=0.05)
    assert point.power_pu == pytest.approx(-0.074, abs=5e-4)


@pytest.mark.parametrize("wind", [8.0, 13.0, 20.0])
@pytest.mark.parametrize("strategy", ["mppt", "coordinated-piecewise"])
def test_simulation_starts_in_the_stable_equilibrium(wind: float, strategy: str) -> None:
    from wtg_gym.physics.scenario import Scenario
    from wtg_gym.physics.trajectory import simulate

    scenario = Scenario(name="x", wind_speed=np.array([[wind], [8.0]]), duration_s=5.0)
    run = simulate(scenario, STRATEGIES[strategy])
    point = stable_equilibrium(1.0, STRATEGIES[strategy], wind)
    assert point is not None
    assert run.rotor_speed_pu[-1, 0] == pytest.approx(point.rotor_speed_pu, abs=1e-8)
    assert run.power_pu[-1, 0] == pytest.approx(point.power_pu, abs=1e-8)
    assert run.pitch_deg[-1, 0] == pytest.approx(point.pitch_deg, abs=1e-6)


def test_named_points_of_the_paper() -> None:
    points = named_points(STRATEGIES["deloaded-5"], 11.4)
    assert points["A"].frequency_pu == 1.0 and points["C"].frequency_pu == 1.008 and points["B"].frequency_pu == 0.992
    assert points["M"].tip_speed_ratio == pytest.approx(7.0026, abs=1e-4)
    assert points["B"].power_pu < points["M"].power_pu > points["A"].power_pu
    lost = named_points(STRATEGIES["mppt"], 8.0)
    assert "M" not in lost and lost["B"].frequency_pu == pytest.approx(0.99787, abs=5e-6)


def test_branches_of_the_characteristic_meet_at_the_critical_frequency() -> None:
    law = STRATEGIES["deloaded-10"]
    critical = critical_frequency_pu(law, 8.0)
    assert critical is not None
    curve = characteristic(law, 8.0, critical + np.array([-1e-6, 1e-8, 1e-4]))
    assert np.isnan(curve.power_pu[0]) and np.isnan(curve.unstable_power_pu[0])
    gap = curve.rotor_speed_pu - curve.unstable_rotor_speed_pu
    assert 0.0 < gap[1] < 0.02 < gap[2]


def test_margin_at_the_corner_of_the_power_limit_is_exact() -> None:
    """A surplus that is largest where the captured power is capped: to either side it falls along a slope."""
    law = TrackingLaw(name="corner", k_min=1.0, k_nominal=3.0, k_max=1.0, damping_time_constant_s=0.0)
    critical = critical_frequency_pu(law, 18.768600535348114)
    assert critical is not None
    slope = power_margin_pu(critical + 1e-6, law, 18.768600535348114) / 1e-6
    for step in (-1e-9, -1e-11, 0.0, 1e-11, 1e-9):
        margin = power_margin_pu(critical + step, law, 18.768600535348114)
        assert margin == pytest.approx(slope * step, abs=1e-12, rel=1e-3)
