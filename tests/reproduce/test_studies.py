"""Figures of the studies beyond the paper."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.modes import Mode, linearise, modes
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import STRATEGY_LOOKS
from wtg_gym.reproduce.case_studies import DampingStudy, EquilibriumStudy, MachineModelStudy, MarginStudy
from wtg_gym.reproduce.eigenvalue_plane import plot_modes
from wtg_gym.reproduce.study_figures import plot_damping, plot_equilibria, plot_machine_models, plot_margins

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.filterwarnings("error")

_WIND = np.array([6.0, 8.0, 10.0, 12.0])


def _line(axes: Any, name: str) -> Any:
    # A leading underscore keeps a line out of the legend.
    (found,) = [line for line in axes.get_lines() if line.get_label().removeprefix("_") == name]
    return found


def test_margins_have_the_colours_of_their_strategies() -> None:
    study = MarginStudy(_WIND, {"mppt": 48.0 - 0.1 * _WIND, "coordinated-linear": 20.0 + 2.0 * _WIND}, "")
    (axes,) = plot_margins(study).axes
    for name, margin in study.phase_margin_deg.items():
        assert _line(axes, name).get_color() == STRATEGY_LOOKS[name].colour
        assert np.array_equal(_line(axes, name).get_ydata(), margin)
    assert axes.get_ylabel() == "phase margin [°]"


def test_the_slopes_of_a_strategy_share_its_colour_and_differ_in_dashes() -> None:
    labels = [f"coordinated-piecewise, {side}-frequency" for side in ("under", "over")]
    (axes,) = plot_margins(MarginStudy(_WIND, {label: _WIND for label in labels}, "")).axes
    under, over = (_line(axes, label) for label in labels)
    assert under.get_color() == over.get_color() == STRATEGY_LOOKS["coordinated-piecewise"].colour
    assert under.get_linestyle() == "-"
    assert over.get_linestyle() != "-"


def test_the_region_without_equilibrium_lies_below_the_curve() -> None:
    critical = np.array([0.999, 0.998, 0.996, np.nan])
    study = EquilibriumStudy(_WIND, {"mppt": critical, "deloaded-5": np.full(4, np.nan)}, "")
    axes = plot_equilibria(study).axes[0]
    assert np.array_equal(_line(axes, "mppt").get_ydata(), critical, equal_nan=True)
    region = axes.collections[0].get_paths()[0]
    assert region.contains_point((8.0, 0.9979))
    assert not region.contains_point((8.0, 0.9981))
    # Where every frequency has an equilibrium nothing is shaded.
    assert not region.contains_point((11.9, 0.993))
    low, high = axes.get_ylim()
    assert low < 0.992 < 1.0 < high


def _damping_study(tau: list[float]) -> DampingStudy:
    n = len(tau)
    rotors = np.stack([np.linspace(1.08, 1.05, n), np.linspace(0.77, 0.71, n)], axis=1)
    return DampingStudy(np.array(tau), np.linspace(49.79, 49.84, n), rotors, rotors, "")


def test_no_time_constant_of_zero_enters_the_logarithmic_line() -> None:
    nadir, rotor, trade = plot_damping(_damping_study([0.0, 0.1, 0.8, 6.4])).axes
    assert list(_line(nadir, "over tau").get_xdata()) == [0.1, 0.8, 6.4]
    assert nadir.get_xscale() == rotor.get_xscale() == "log"
    apart = nadir.get_xticks()[0]
    assert 0.0 < apart < 0.1
    assert nadir.get_xticklabels()[0].get_text() == "0"
    assert [float(x) for x in _line(trade, "trade").get_xdata()] == pytest.approx([0.77, 0.75, 0.73, 0.71])
    assert [text.get_text() for text in trade.texts] == ["0", "0.1", "0.8", "6.4"]


def test_points_close_together_share_a_name() -> None:
    study = _damping_study([0.0, 0.1, 0.8, 6.4])
    rotors = study.lowest_rotor_speed_pu.copy()
    rotors[1] = rotors[0]
    nadir = study.nadir_hz.copy()
    nadir[1] = nadir[0] + 1e-4
    trade = plot_damping(dataclasses.replace(study, nadir_hz=nadir, lowest_rotor_speed_pu=rotors)).axes[2]
    assert [text.get_text() for text in trade.texts] == ["0 … 0.1", "0.8", "6.4"]


def test_machine_models_differ_in_dashes_and_strategies_in_colour(
    load_increase: tuple[Scenario, dict[str, Trajectory]],
) -> None:
    scenario, runs = load_increase
    chosen = {(model, name): runs[name] for model in ("genrou", "classical") for name in ("mppt", "coordinated-linear")}
    figure = plot_machine_models(MachineModelStudy(scenario, chosen, ""))
    for axes in figure.axes:
        for (model, name), _ in chosen.items():
            line = _line(axes, f"{model} {name}")
            assert line.get_color() == STRATEGY_LOOKS[name].colour
            assert (line.get_linestyle() == "-") == (model == "genrou")
    # The group with the least wind is shown.
    rotor = _line(figure.axes[2], "genrou mppt")
    assert np.array_equal(rotor.get_ydata(), runs["mppt"].rotor_speed_pu[:, 1])


def _mode(value: complex) -> Mode:
    return Mode(eigenvalue=value, frequency_hz=0.0, damping_ratio=0.0, time_constant_s=1.0, participation={})


def test_modes_of_the_plant_lie_where_their_eigenvalues_are(
    load_increase: tuple[Scenario, dict[str, Trajectory]],
) -> None:
    names = ("mppt", "coordinated-piecewise")
    groups = {name: modes(linearise(load_increase[0], STRATEGIES[name])) for name in names}
    plane, slow = plot_modes(groups).axes
    for name, found in groups.items():
        line = _line(plane, name)
        expected = [mode.eigenvalue for mode in found if mode.eigenvalue.real >= -12.0]
        assert np.allclose(line.get_xdata() + 1j * line.get_ydata(), expected)
        assert line.get_color() == STRATEGY_LOOKS[name].colour
    assert len({_line(plane, name).get_marker() for name in names}) == len(names)
    assert slow.get_xlim()[0] == pytest.approx(-1.2)


def test_lines_of_constant_damping_ratio_have_that_ratio() -> None:
    plane = plot_modes({"a": [_mode(-1.0 + 5.0j)]}).axes[0]
    for ratio in (0.05, 0.10, 0.30):
        start, end = _line(plane, f"damping ratio {ratio:g}").get_xydata()
        assert list(start) == [0.0, 0.0]
        assert -end[0] / np.hypot(*end) == pytest.approx(ratio)


def test_an_unstable_mode_is_in_sight() -> None:
    plane = plot_modes({"a": [_mode(0.8 + 5.0j), _mode(-1.0 + 0.0j)]}).axes[0]
    assert plane.get_xlim()[1] > 0.8
