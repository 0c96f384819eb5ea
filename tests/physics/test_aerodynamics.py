"""The C_p curve, a table in its place, and the tracking laws that follow from it, against the paper's numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from wtg_gym import Plant, Scenario, TrackingLaw, get_law, simulate
from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.converter import Corners, tracking_coefficient
from wtg_gym.physics.parameters import ROTOR_TABLE, GridFormingParameters, TurbineParameters, nrel_5mw
from wtg_gym.physics.rotor_table import read_rotor_table
from wtg_gym.physics.tracking_law import LAW_NAMES, LAWS, TUNED

TABLE = read_rotor_table(ROTOR_TABLE)
RATIO, PITCH, CP = (np.array(v) for v in (TABLE.tip_speed_ratio, TABLE.pitch_deg, TABLE.power_coefficient))
LONG_BLADES = TurbineParameters(blade_radius_m=70.0)
K_OPT, K_N, K_PR = (tracking_point(d).coefficient for d in (0.0, 0.05, 0.10))
CALM = Scenario(name="x", wind_speed=np.full((2, 1), 8.0), duration_s=1.0)


def test_operating_points_are_those_of_the_paper():
    best, nominal, limit = points = [tracking_point(d) for d in (0.0, 0.05, 0.10)]
    assert round(best.tip_speed_ratio) == 7
    assert round(best.power_coefficient, 3) == 0.448
    assert round(nominal.tip_speed_ratio, 2) == 7.92
    assert round(limit.tip_speed_ratio, 2) == 8.32
    assert [point.coefficient for point in points] == pytest.approx([1.02412, 0.67166, 0.54916], abs=5e-6)
    assert available_power_pu(np.array([11.4, 8.0])) == pytest.approx([1.01722, 0.35154], abs=5e-6)
    assert power_coefficient(np.linspace(2.0, 15.0, 2001)).max() <= best.power_coefficient * (1.0 + 1e-12)


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


def g(speed: float, law: TrackingLaw) -> float:
    return float(tracking_coefficient(speed, law.k_min, law.k_nominal, law.k_max, Corners(0.992, 1.0, 1.008)))


def test_laws_are_the_papers_corners_straight_line_and_constants():
    corners = [g(speed, LAWS["coordinated-piecewise"]) for speed in (0.992, 1.0, 1.008)]
    assert corners == pytest.approx([K_OPT, K_N, K_PR], rel=1e-14)
    for speed in (0.993, 0.998, 1.0, 1.003, 1.0075):
        line = (K_OPT - K_PR) / (0.992 - 1.008) * (speed - 1.008) + K_PR
        assert g(speed, LAWS["coordinated-linear"]) == pytest.approx(line, rel=1e-12)
        fixed = [g(speed, LAWS[name]) for name in ("mppt", "deloaded-5", "deloaded-10")]
        assert fixed == [K_OPT, K_N, K_PR]
    assert {law.damping_time_constant_s for law in list(LAWS.values())[:3]} == {math.inf}
    damped = ("coordinated-linear", "coordinated-piecewise", "coordinated-undamped")
    assert [LAWS[name].damping_time_constant_s for name in damped] == [0.8, 0.8, 0.0]


def test_law_from_toml_by_deloading_equals_the_reference_of_its_turbine(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("deloading_min = 0\ndeloading_nominal = 5\ndeloading_max = 10\ntau_s = 0.8\n")
    for turbine, factor in ((None, 1.0), (LONG_BLADES, (70.0 / 63.0) ** 5)):
        assert get_law(str(path), turbine) == replace(get_law("coordinated-piecewise", turbine), name="mine")
        assert get_law(str(path), turbine).k_min == pytest.approx(K_OPT * factor, rel=1e-12)


def test_a_strategy_takes_its_numbers_from_the_control_of_the_plant():
    control = GridFormingParameters(damping_time_constant_s=20.0, deloading_nominal=0.2, deloading_limit=0.3)
    for name in ("coordinated-piecewise", "coordinated-linear", "coordinated-undamped"):
        law = get_law(name, control=control)
        assert law.k_max == tracking_point(0.3).coefficient
        assert law.damping_time_constant_s == (0.0 if name == "coordinated-undamped" else 20.0)
        run = simulate(CALM, name, Plant(control=control))
        assert run.coefficient_pu[0] == pytest.approx([law.k_nominal] * 2, rel=1e-9)
    assert get_law("coordinated-piecewise", control=control).k_nominal == tracking_point(0.2).coefficient


@pytest.mark.parametrize("name", TUNED)
def test_tuned_law_follows_the_turbine_as_its_equation_says(name):
    # The power curve of the last one is flat: its K_opt - K_pr is so large that the range of a law's k ends before.
    for turbine in (None, LONG_BLADES, Plant().replaced(physics="nrel-5mw").turbine):
        paper, tuned = (get_law(each, turbine) for each in ("coordinated-piecewise", name))
        span = paper.k_min - paper.k_max
        for k, own, share in (
            (tuned.k_min, paper.k_min, TUNED[name].above_opt),
            (tuned.k_nominal, paper.k_nominal, TUNED[name].above_nominal),
            (tuned.k_max, paper.k_max, -TUNED[name].below_limit),
        ):
            assert k == pytest.approx(min(max(own + share * span, 1e-3), 3.0), rel=1e-12)
        assert tuned.damping_time_constant_s == TUNED[name].time_constant_s
    assert tuned.k_max == 1e-3
    assert name not in LAWS and name in LAW_NAMES
    # Only the free law goes beyond the best coefficient.
    best = max(get_law(name).k_min, get_law(name).k_nominal)
    assert best > K_OPT if name == "coordinated-free" else best == K_OPT
