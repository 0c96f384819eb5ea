"""g(ω), the strategies' numbers and laws from TOML."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.converter import Corners, tracking_coefficient
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.plant import PlantSettings, plant_settings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import (
    STRATEGIES,
    STRATEGY_NAMES,
    TUNED_ABOVE_NOMINAL,
    TUNED_ABOVE_OPT,
    TUNED_BELOW_LIMIT,
    TUNED_TIME_CONSTANT_S,
    TrackingLaw,
    get_law,
    group_laws,
    read_law,
)
from wtg_gym.physics.trajectory import simulate
from wtg_gym.reproduce.steady_states import stable_equilibrium

LONG_BLADES = TurbineParameters(blade_radius_m=70.0)
K_OPT, K_N, K_PR = (tracking_point(d).coefficient for d in (0.0, 0.05, 0.10))


def g(speed: float, law: TrackingLaw) -> float:
    return float(tracking_coefficient(speed, law.k_min, law.k_nominal, law.k_max, Corners(0.992, 1.0, 1.008)))


def test_piecewise_law_meets_its_three_corners() -> None:
    law = STRATEGIES["coordinated-piecewise"]
    assert [g(w, law) for w in (0.992, 1.0, 1.008)] == pytest.approx([K_OPT, K_N, K_PR], rel=1e-14)


def test_linear_law_is_the_papers_straight_line() -> None:
    law = STRATEGIES["coordinated-linear"]
    for speed in (0.993, 0.998, 1.0, 1.003, 1.0075):
        line = (K_OPT - K_PR) / (0.992 - 1.008) * (speed - 1.008) + K_PR
        assert g(speed, law) == pytest.approx(line, rel=1e-12)


@given(st.floats(0.9, 1.1), st.floats(0.0, 0.05))
def test_coordinated_laws_fall_with_frequency_and_saturate(speed: float, more: float) -> None:
    for name in ("coordinated-linear", "coordinated-piecewise"):
        low, high = g(speed + more, STRATEGIES[name]), g(speed, STRATEGIES[name])
        assert K_PR - 1e-12 <= low <= high + 1e-12 <= K_OPT + 2e-12


@given(st.floats(0.9, 1.1))
def test_fixed_laws_ignore_frequency(speed: float) -> None:
    assert g(speed, STRATEGIES["mppt"]) == K_OPT
    assert g(speed, STRATEGIES["deloaded-5"]) == K_N
    assert g(speed, STRATEGIES["deloaded-10"]) == K_PR


def test_time_constants_of_the_strategies() -> None:
    assert {name: law.damping_time_constant_s for name, law in STRATEGIES.items()} == {
        "mppt": math.inf,
        "deloaded-5": math.inf,
        "deloaded-10": math.inf,
        "coordinated-linear": 0.8,
        "coordinated-piecewise": 0.8,
        "coordinated-undamped": 0.0,
    }


def test_law_from_toml_by_deloading_equals_the_reference(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("deloading_min = 0\ndeloading_nominal = 5\ndeloading_max = 10\ntau_s = 0.8\n")
    law, reference = get_law(str(path)), STRATEGIES["coordinated-piecewise"]
    assert law.name == "mine"
    assert (law.k_min, law.k_nominal, law.k_max) == (reference.k_min, reference.k_nominal, reference.k_max)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("k_min = 1\nk_nominal = 1\n", r"exactly one of k_max \[p.u.\] and deloading_max \[%\], got neither"),
        ("k_min = 1\nk_nominal = 1\nk_max = 9\n", r"k_max .* = 9 p.u. is outside the allowed range 0.001 … 3 p.u."),
        (
            "k_min = 1\nk_nominal = 1\nk_max = 1\ntau_s = -1\n",
            r"tau_s = -1 s in .*law.toml is not allowed: .* must be 0.05 … 100000 s, 0 s .* infinite .*, got -1 s",
        ),
        ("k_min = 1\nk_nominal = 1\nk_max = 1\ntau_s = 1e308\n", r"must be 0.05 … 100000 s, .* got 1e\+308 s"),
        ("k_min = 1\nk_nominal = 1\nk_max = 1\ncolour = 3\n", r"unknown keys \['colour'\]; allowed"),
        ("deloading_min = 120\ndeloading_nominal = 5\ndeloading_max = 10\n", r"= 120 % is outside .* 0 … 90 %"),
        (
            "deloading_min = 0\ndeloading_nominal = 0.05\ndeloading_max = 10\n",
            r"deloading_nominal = 0.05 in .*law.toml is in percent: write 5 for 5 %; allowed: 0, or 0.5 … 90 %",
        ),
        ("name = 'mppt'\nk_min = 1\nk_nominal = 1\nk_max = 1\n", r"built-in strategy"),
        ("k_min = \n", r"is not TOML"),
    ],
)
def test_bad_law_files_say_what_is_wrong(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "law.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_law(path)


def test_unknown_strategy_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"unknown strategy 'magic'; known strategies: mppt, deloaded-5"):
        get_law("magic")
    with pytest.raises(ValueError, match=r"cannot read the law file"):
        get_law("nowhere/law.toml")


@pytest.mark.parametrize(
    ("strategy", "deloading"), [("mppt", 0.0), ("deloaded-10", 0.1), ("coordinated-piecewise", 0.05)]
)
def test_a_strategy_keeps_its_meaning_on_another_turbine(strategy: str, deloading: float) -> None:
    optimum = tracking_point(0.0, LONG_BLADES)
    scenario = Scenario(name="x", wind_speed=np.full((2, 1), 8.0), duration_s=1.0)
    start = simulate(scenario, strategy, PlantSettings(turbine=LONG_BLADES))
    point = stable_equilibrium(1.0, get_law(strategy, LONG_BLADES), 8.0, turbine=LONG_BLADES)
    assert point is not None
    assert start.tip_speed_ratio[0] == pytest.approx([point.tip_speed_ratio] * 2, rel=1e-6)
    captured = start.captured_power_pu[0] / (LONG_BLADES.wind_power_pu_per_cubic_wind * 8.0**3)
    assert captured == pytest.approx([(1.0 - deloading) * optimum.power_coefficient] * 2, rel=5e-3)


def test_maximum_power_point_tracking_starts_at_the_optimum_of_its_own_turbine() -> None:
    point = stable_equilibrium(1.0, get_law("mppt", LONG_BLADES), 8.0, turbine=LONG_BLADES)
    assert point is not None
    assert point.tip_speed_ratio == pytest.approx(tracking_point(0.0, LONG_BLADES).tip_speed_ratio, rel=1e-5)
    assert get_law("mppt", LONG_BLADES).k_min == pytest.approx(K_OPT * (70.0 / 63.0) ** 5, rel=1e-12)


def test_deloadings_in_a_file_are_those_of_the_turbine(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("deloading_min = 0\ndeloading_nominal = 5\ndeloading_max = 10\ntau_s = 0.8\n")
    mine, reference = get_law(str(path), LONG_BLADES), get_law("coordinated-piecewise", LONG_BLADES)
    assert (mine.k_min, mine.k_nominal, mine.k_max) == (reference.k_min, reference.k_nominal, reference.k_max)
    assert mine.k_min != K_OPT


def test_a_strategy_takes_its_numbers_from_the_control_of_the_plant() -> None:
    control = GridFormingParameters(damping_time_constant_s=20.0, deloading_nominal=0.2, deloading_limit=0.3)
    scenario = Scenario(name="x", wind_speed=np.full((2, 1), 8.0), duration_s=1.0)
    for name in ("coordinated-piecewise", "coordinated-linear", "coordinated-undamped"):
        law = get_law(name, control=control)
        assert law.k_max == tracking_point(0.3).coefficient
        assert law.damping_time_constant_s == (0.0 if name == "coordinated-undamped" else 20.0)
        run = simulate(scenario, name, PlantSettings(control=control))
        assert run.coefficient_pu[0] == pytest.approx([law.k_nominal] * 2, rel=1e-9)
    assert get_law("coordinated-piecewise", control=control).k_nominal == tracking_point(0.2).coefficient


def test_paper_strategies_are_those_of_the_papers_turbine() -> None:
    assert dict(STRATEGIES) == {name: get_law(name, TurbineParameters()) for name in STRATEGIES}
    assert "magic" not in STRATEGIES and len(STRATEGIES) == 6
    with pytest.raises(KeyError):
        STRATEGIES["magic"]


def test_laws_of_groups_are_one_for_all_or_one_for_each() -> None:
    mppt = STRATEGIES["mppt"]
    assert group_laws("mppt", 2) == group_laws(["mppt", mppt], 2) == (mppt, mppt)
    with pytest.raises(ValueError, match=r"one for each of the 2 groups, got 3"):
        group_laws(["mppt"] * 3, 2)


def test_importing_the_laws_compiles_nothing() -> None:
    code = (
        "from wtg_gym.physics import aerodynamics, tracking_law;"
        "assert not aerodynamics.power_coefficient_at.signatures and 'mppt' in tracking_law.STRATEGIES"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_tuned_law_follows_the_turbine_as_its_equation_says() -> None:
    # The power curve of the last one is flat: its K_opt - K_pr is so large that the range of a law's k ends before.
    lowest = {
        None: K_PR - TUNED_BELOW_LIMIT * (K_OPT - K_PR),
        LONG_BLADES: None,
        plant_settings("nrel-5mw").turbine: 1e-3,
    }
    for turbine, least in lowest.items():
        paper, tuned = (get_law(name, turbine) for name in ("coordinated-piecewise", "coordinated-tuned"))
        span = paper.k_min - paper.k_max
        corners = ((tuned.k_min, paper.k_min, TUNED_ABOVE_OPT), (tuned.k_nominal, paper.k_nominal, TUNED_ABOVE_NOMINAL))
        for k, own, share in (*corners, (tuned.k_max, paper.k_max, -TUNED_BELOW_LIMIT)):
            assert k == pytest.approx(min(max(own + share * span, 1e-3), 3.0), rel=1e-12)
        assert least is None or tuned.k_max == pytest.approx(least)
        assert tuned.damping_time_constant_s == TUNED_TIME_CONSTANT_S
    assert "coordinated-tuned" not in STRATEGIES and "coordinated-tuned" in STRATEGY_NAMES
