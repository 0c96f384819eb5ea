"""g(ω), the strategies' numbers and laws from TOML."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw, get_law, read_law, tracking_coefficient

K_OPT, K_N, K_PR = (tracking_point(d).coefficient for d in (0.0, 0.05, 0.10))


def g(speed: float, law: TrackingLaw) -> float:
    return float(tracking_coefficient(speed, law.k_min, law.k_nominal, law.k_max, 0.992, 1.0, 1.008))


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
        ("k_min = 1\nk_nominal = 1\nk_max = nan\n", r"k_max .* = nan p.u. is outside"),
        ("k_min = 1\nk_nominal = 1\nk_max = 1\ntau_s = -1\n", r"must be 0 … ∞ s, got -1 s"),
        ("k_min = 1\nk_nominal = 1\nk_max = 1\ntau_s = 0.001\n", r"0.001 s is outside the allowed range 0.05 … ∞ s"),
        ("k_min = 1\nk_nominal = 1\nk_max = 1\ncolour = 3\n", r"unknown keys \['colour'\]; allowed"),
        ("deloading_min = 120\ndeloading_nominal = 5\ndeloading_max = 10\n", r"= 120 % is outside .* 0 … 90 %"),
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
