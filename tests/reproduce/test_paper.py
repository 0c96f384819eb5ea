"""The paper's figures show the model's values."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import STRATEGY_LOOKS
from wtg_gym.reproduce.characteristics import plot_characteristic
from wtg_gym.reproduce.loops import SingleMachine, ideal_source_loop, single_machine
from wtg_gym.reproduce.paper_figures import plot_bode, plot_case_study, plot_power_coefficient
from wtg_gym.reproduce.power_frequency import critical_frequency_pu, named_points

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.filterwarnings("error")

_WINDS = (11.4, 8.0)


@functools.lru_cache
def _characteristic(strategy: str) -> Any:
    return plot_characteristic(STRATEGIES[strategy], _WINDS)


def _line(axes: Any, name: str) -> Any:
    # A leading underscore keeps a line out of the legend.
    (found,) = [line for line in axes.get_lines() if line.get_label().removeprefix("_") == name]
    return found


def _legend(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def _texts(axes: Any) -> str:
    return "\n".join(text.get_text() for text in axes.texts)


def test_power_coefficient_names_the_values_of_the_papers_table() -> None:
    whole, part = plot_power_coefficient().axes
    assert "= 7.00" in _texts(whole)
    assert "= 0.448" in _texts(whole)
    assert [label.get_text().split("\n")[0] for label in part.get_xticklabels()] == ["7.00", "7.92", "8.32"]
    assert "0.425, −5 %" in _texts(part)
    assert "0.403, −10 %" in _texts(part)
    curve = _line(part, "power coefficient")
    assert curve.get_ydata().max() == pytest.approx(tracking_point().power_coefficient, abs=1e-12)


@pytest.mark.parametrize("strategy", ["mppt", "deloaded-5", "deloaded-10"])
def test_branches_of_a_fixed_strategy_meet_at_its_critical_frequency(strategy: str) -> None:
    law = STRATEGIES[strategy]
    figure = _characteristic(strategy)
    for axes in figure.axes[1:]:
        for wind in _WINDS:
            stable, unstable = (_line(axes, f"{kind} {wind:g} m/s") for kind in ("stable", "unstable"))
            critical = critical_frequency_pu(law, wind, fine_pitch=True)
            assert stable.get_xdata()[0] == unstable.get_xdata()[0] == pytest.approx(critical, abs=1e-12)
            assert stable.get_ydata()[0] == unstable.get_ydata()[0]
            # Sampled densely where both leave it vertically, so that no gap and no kink shows.
            for line in (stable, unstable):
                height = np.ptp(axes.get_ylim())
                assert np.abs(np.diff(line.get_ydata()[:40])).max() < 0.02 * height
    assert "no equilibrium at 8 m/s" in _legend(figure)


def test_the_coordinated_law_has_an_equilibrium_everywhere() -> None:
    figure = _characteristic("coordinated-piecewise")
    rotor, power, _ = figure.axes
    stable = _line(power, "stable 8 m/s")
    assert (stable.get_xdata()[0], stable.get_xdata()[-1]) == power.get_xlim()
    assert not any("no equilibrium" in text for text in _legend(figure))
    assert r"$k_{min}$" in _texts(rotor)


@pytest.mark.parametrize("strategy", ["mppt", "deloaded-5", "coordinated-piecewise"])
def test_points_of_the_paper_are_marked_in_all_three_panels(strategy: str) -> None:
    law = STRATEGIES[strategy]
    rotor, power, speed = _characteristic(strategy).axes
    for number, wind in enumerate(_WINDS, start=1):
        for name, point in named_points(law, wind).items():
            point_name = f"point {name}{number}"
            assert [float(v) for v in _line(rotor, point_name).get_xydata()[0]] == [
                point.rotor_speed_pu,
                point.power_pu,
            ]
            assert [float(v) for v in _line(power, point_name).get_xydata()[0]] == [point.frequency_pu, point.power_pu]
            assert [float(v) for v in _line(speed, point_name).get_xydata()[0]] == [
                point.frequency_pu,
                point.rotor_speed_pu,
            ]


def test_the_demand_of_a_fixed_law_touches_the_captured_power_where_the_equilibrium_is_lost() -> None:
    rotor = _characteristic("mppt").axes[0]
    surplus = _line(rotor, "captured 8 m/s").get_ydata() - _line(rotor, "demand 8 m/s").get_ydata()
    assert -1e-4 < surplus.max() <= 1e-9


@pytest.mark.parametrize(
    ("winds", "message"),
    [((), "1 … 4 wind speeds, got 0"), ((8.0,) * 5, "got 5"), ((8.0, 40.0), "wind .*40")],
)
def test_winds_outside_the_range_are_refused(winds: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot_characteristic(STRATEGIES["mppt"], winds)


@pytest.fixture(scope="module")
def loops() -> dict[str, SingleMachine]:
    names = ("mppt", "deloaded-5", "coordinated-linear")
    return {"ideal-source": ideal_source_loop(), **{name: single_machine(STRATEGIES[name], 11.4) for name in names}}


def test_bode_states_the_papers_margins(loops: dict[str, SingleMachine]) -> None:
    figure = plot_bode(loops)
    legend = _legend(figure)
    assert any(text.startswith("coordinated-linear: 55.4° at ") for text in legend)
    assert any(text.startswith("ideal-source: 48.8° at ") for text in legend)
    phase = figure.axes[1]
    ((crossover, top),) = _line(phase, "margin coordinated-linear").get_xydata()
    assert top + 180.0 == pytest.approx(55.4, abs=0.05)
    assert abs(complex(loops["coordinated-linear"].response(crossover))) == pytest.approx(1.0)


def test_phase_is_continuous_and_begins_where_the_integrators_put_it(loops: dict[str, SingleMachine]) -> None:
    phase = plot_bode(loops).axes[1]
    for name in loops:
        values = _line(phase, f"phase {name}").get_ydata()
        assert -270.0 < values.min() < values.max() < -89.0
        assert np.abs(np.diff(values)).max() < 2.0
    assert _line(phase, "phase ideal-source").get_ydata()[0] == pytest.approx(-90.0, abs=0.2)
    # At the maximum of C_p the aerodynamic slope is zero: a second integrator.
    assert _line(phase, "phase mppt").get_ydata()[0] == pytest.approx(-180.0, abs=3.0)


def test_phase_does_not_jump_where_it_passes_180_degrees(loops: dict[str, SingleMachine]) -> None:
    # 2/(s (s + 1) (s/2 + 1)) turns from -90° to -270°.
    third_order = dataclasses.replace(loops["mppt"], numerator=(2.0,), denominator=(0.0, 1.0, 1.5, 0.5))
    values = _line(plot_bode({"third order": third_order}).axes[1], "phase third order").get_ydata()
    assert values[0] == pytest.approx(-90.0, abs=1.0)
    assert values[-1] == pytest.approx(-270.0, abs=2.0)
    assert (np.diff(values) < 0.0).all()


Runs = tuple[Scenario, dict[str, Trajectory]]


def test_case_study_has_a_column_per_group_and_a_colour_per_strategy(load_increase: Runs) -> None:
    figure = plot_case_study(*load_increase)
    titles = [axes.get_title(loc="left") for axes in figure.axes[:2]]
    assert titles == ["(a) GFM-WTG 1 (11.4 m/s)", "(b) GFM-WTG 2 (8 m/s)"]
    assert len(figure.axes) == 8
    for axes in figure.axes:
        for name in STRATEGIES:
            assert _line(axes, name).get_color() == STRATEGY_LOOKS[name].colour
        reference = _line(axes, "coordinated-piecewise")
        others = [_line(axes, name) for name in STRATEGIES if name != "coordinated-piecewise"]
        assert all(reference.get_zorder() > line.get_zorder() for line in others)
        assert all(reference.get_linewidth() > line.get_linewidth() for line in others)
    rotor = _line(figure.axes[5], "mppt")
    assert np.array_equal(rotor.get_ydata(), load_increase[1]["mppt"].rotor_speed_pu[:, 1])


def test_case_study_marks_stalls_events_and_limits(load_increase: Runs) -> None:
    scenario, runs = load_increase
    figure = plot_case_study(scenario, runs)
    stalled = {run.time_s[-1] for run in runs.values() if run.status == Status.STALL}
    power = figure.axes[3]
    assert {line.get_xdata()[0] for line in power.get_lines() if line.get_marker() == "x"} == stalled
    assert "stall" in _legend(figure)
    instants = {line.get_xdata()[0] for line in power.get_lines() if list(line.get_ydata()) == [0, 1]}
    assert instants == {5.0, 30.0}
    heights = [float(line.get_ydata()[0]) for line in power.get_lines()]
    available = float(available_power_pu(8.0))
    for limit in (available, 0.9 * available):
        assert np.isclose(heights, limit, rtol=1e-9).any()
    assert "+75 MW at bus 3" in "".join(text.get_text() for text in figure.texts)
