"""The C_p table of a rotor: its surface, its edges, its file."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.nrel5mw import ROTOR_TABLE, nrel_5mw
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, ProtectionParameters
from wtg_gym.physics.rotor_table import RotorTable, read_rotor_table
from wtg_gym.physics.wind_turbine import turbine_constants, turbine_equilibrium

TABLE = read_rotor_table(ROTOR_TABLE)
RATIO, PITCH, CP = (np.array(v) for v in (TABLE.tip_speed_ratio, TABLE.pitch_deg, TABLE.power_coefficient))


def test_the_surface_goes_through_the_tables_points() -> None:
    for j in np.flatnonzero(PITCH >= 0.0):
        assert power_coefficient(RATIO, float(PITCH[j]), TABLE) == pytest.approx(CP[:, j], abs=1e-14)


def test_between_the_points_it_is_the_bicubic_spline() -> None:
    spline = RectBivariateSpline(RATIO, PITCH, CP, kx=3, ky=3, s=0.0)
    rng = np.random.default_rng(0)
    for pitch in rng.uniform(0.0, PITCH[-1], 40):
        ratio = np.sort(rng.uniform(RATIO[0], RATIO[-1], 50))
        assert power_coefficient(ratio, float(pitch), TABLE) == pytest.approx(spline(ratio, pitch)[:, 0], abs=1e-13)


def test_an_uneven_table_is_followed_at_its_points_and_between_them() -> None:
    ratio = np.array([2.0, 2.5, 3.5, 5.0, 5.5, 7.0, 8.0, 10.0, 13.0])
    pitch = np.array([-3.0, 0.5, 2.0, 5.0, 9.0, 15.0, 24.0])
    smooth = 0.4 * np.exp(-(((ratio[:, None] - 7.0) / 4.0) ** 2)) * np.cos(pitch / 20.0)
    table = RotorTable(
        tip_speed_ratio=tuple(ratio), pitch_deg=tuple(pitch), power_coefficient=tuple(map(tuple, smooth.tolist()))
    )
    spline = RectBivariateSpline(ratio, pitch, smooth, kx=3, ky=3, s=0.0)
    between = np.linspace(2.0, 13.0, 200)
    for angle in np.linspace(0.0, 24.0, 30):
        # Cells are of one size, so the spline's knots lie within them: there its third derivative jumps.
        assert power_coefficient(between, angle, table) == pytest.approx(spline(between, angle)[:, 0], abs=2e-4)


def test_slopes_go_on_over_the_edges_of_cells() -> None:
    h = 1e-5
    for pitch in (0.0, 3.3, 12.0):
        for edge in RATIO[1:-1]:
            left = power_coefficient(np.array([edge - 2 * h, edge - h, edge]), pitch, TABLE)
            right = power_coefficient(np.array([edge, edge + h, edge + 2 * h]), pitch, TABLE)
            slopes = [(v @ w) / (2 * h) for v, w in ((left, [1.0, -4.0, 3.0]), (right, [-3.0, 4.0, -1.0]))]
            assert slopes[0] == pytest.approx(slopes[1], abs=1e-7)


def test_beyond_its_edges_it_keeps_their_values_and_falls_to_zero_at_standstill() -> None:
    at_edge = float(power_coefficient(RATIO[-1], 0.0, TABLE))
    assert power_coefficient(np.array([20.0, 90.0]), 0.0, TABLE) == pytest.approx(at_edge, abs=1e-14)
    assert power_coefficient(7.0, 80.0, TABLE) == pytest.approx(
        power_coefficient(7.0, float(PITCH[-1]), TABLE), abs=1e-14
    )
    least = float(power_coefficient(RATIO[0], 0.0, TABLE))
    assert power_coefficient(RATIO[0] * np.array([0.5, 0.01]), 0.0, TABLE) == pytest.approx(
        least * np.array([0.5, 0.01]), abs=1e-14
    )


def test_the_nrel_turbine_has_its_published_numbers() -> None:
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


@pytest.mark.parametrize(
    ("limits", "held_back"),
    [
        ({}, (0.219, 0.443)),
        ({"rotor_speed_limit_pu": 10.0}, (0.046, 0.096)),
        ({"rotor_speed_limit_pu": 10.0, "captured_power_limit_pu": 10.0}, (0.05, 0.10)),
    ],
)
def test_limit_on_rotor_speed_makes_the_nrel_rotor_hold_back_more_than_its_deloading(
    limits: dict[str, float], held_back: tuple[float, ...]
) -> None:
    turbine = nrel_5mw()
    constants = turbine_constants(turbine, PitchParameters(**limits), GridFormingParameters(), ProtectionParameters())
    powers = []
    for deloading in (0.0, 0.05, 0.1):
        k = tracking_point(deloading, turbine).coefficient
        rotor, _, found = turbine_equilibrium(11.4, k, constants, TABLE.surface()[1])
        assert found
        powers.append(k * rotor**3)
    assert [1.0 - power / powers[0] for power in powers[1:]] == pytest.approx(held_back, abs=1e-3)
