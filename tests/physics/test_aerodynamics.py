"""The C_p curve and what is derived from it, against the paper's table; a table in its place."""

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.parameters import ROTOR_TABLE, nrel_5mw
from wtg_gym.physics.rotor_table import read_rotor_table


def test_operating_points_are_those_of_the_paper():
    best, nominal, limit = points = [tracking_point(d) for d in (0.0, 0.05, 0.10)]
    assert round(best.tip_speed_ratio) == 7
    assert round(best.power_coefficient, 3) == 0.448
    assert round(nominal.tip_speed_ratio, 2) == 7.92
    assert round(limit.tip_speed_ratio, 2) == 8.32
    assert [point.coefficient for point in points] == pytest.approx([1.02412, 0.67166, 0.54916], abs=5e-6)
    assert available_power_pu(np.array([11.4, 8.0])) == pytest.approx([1.01722, 0.35154], abs=5e-6)
    assert power_coefficient(np.linspace(2.0, 15.0, 2001)).max() <= best.power_coefficient * (1.0 + 1e-12)


TABLE = read_rotor_table(ROTOR_TABLE)
RATIO, PITCH, CP = (np.array(v) for v in (TABLE.tip_speed_ratio, TABLE.pitch_deg, TABLE.power_coefficient))


def test_between_the_points_it_is_the_bicubic_spline():
    spline = RectBivariateSpline(RATIO, PITCH, CP, kx=3, ky=3, s=0.0)
    rng = np.random.default_rng(0)
    for pitch in rng.uniform(0.0, PITCH[-1], 40):
        ratio = np.sort(rng.uniform(RATIO[0], RATIO[-1], 50))
        assert power_coefficient(ratio, float(pitch), TABLE) == pytest.approx(spline(ratio, pitch)[:, 0], abs=1e-13)


def test_beyond_its_edges_it_keeps_their_values_and_falls_to_zero_at_standstill():
    at_edge = float(power_coefficient(RATIO[-1], 0.0, TABLE))
    assert power_coefficient(np.array([20.0, 90.0]), 0.0, TABLE) == pytest.approx(at_edge, abs=1e-14)
    assert power_coefficient(7.0, 80.0, TABLE) == pytest.approx(power_coefficient(7.0, PITCH[-1], TABLE), abs=1e-14)
    least = float(power_coefficient(RATIO[0], 0.0, TABLE))
    shares = np.array([0.5, 0.01])
    assert power_coefficient(RATIO[0] * shares, 0.0, TABLE) == pytest.approx(least * shares, abs=1e-14)


def test_the_nrel_turbine_has_its_published_numbers():
    turbine = nrel_5mw()
    best = tracking_point(0.0, turbine)
    assert 7.0 < best.tip_speed_ratio < 8.0
    assert 0.45 < best.power_coefficient < 0.49
    # Of the blades from their moments about the root (hub radius 1.5 m, precone 2.5°), hub and generator.
    blade = 11_776_047.0 + 2.0 * 1.5 * 363_231.0 + 1.5**2 * 17_740.0
    inertia = 3.0 * np.cos(np.radians(2.5)) ** 2 * blade + 115_926.0 + 97.0**2 * 534.116
    assert turbine.inertia_constant_s == pytest.approx(0.5 * inertia * (12.1 * np.pi / 30.0) ** 2 / 5e6, rel=1e-6)
    # Rated at 11.4 m/s with 5.297 MW on the shaft.
    assert float(available_power_pu(11.4, turbine)) == pytest.approx(1.0594, rel=0.03)
    # At a coefficient K the captured power meets K ω³ at every wind: with the table as with the curve.
    for deloading in (0.0, 0.05, 0.1):
        point = tracking_point(deloading, turbine)
        assert point.power_coefficient == pytest.approx((1.0 - deloading) * best.power_coefficient, rel=1e-9)
