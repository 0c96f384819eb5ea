"""The paper's figures show the model's values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.reproduce.case_claims import run_case
from wtg_gym.reproduce.figures import plot_bode, plot_case_study, plot_characteristic, plot_power_coefficient
from wtg_gym.reproduce.loops import ideal_source_loop, single_machine
from wtg_gym.reproduce.steady_states import critical_frequency_pu, named_points
from wtg_gym.scenarios import get_suite

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.filterwarnings("error")


def _line(axes: Any, name: str) -> Any:
    # A leading underscore keeps a line out of the legend.
    (found,) = [line for line in axes.get_lines() if line.get_label().removeprefix("_") == name]
    return found


def test_power_coefficient_names_the_values_of_the_papers_table() -> None:
    _, part = plot_power_coefficient().axes
    assert [label.get_text().split("\n")[0] for label in part.get_xticklabels()] == ["7.00", "7.92", "8.32"]
    texts = [text.get_text().split(" = ")[1] for text in part.texts]
    assert texts == ["0.448", "0.425, −5 %", "0.403, −10 %"]


def test_branches_of_a_fixed_strategy_meet_at_its_critical_frequency() -> None:
    law = STRATEGIES["deloaded-5"]
    rotor, power, speed = plot_characteristic(law).axes
    for number, wind in ((1, 11.4), (2, 8.0)):
        critical = critical_frequency_pu(law, wind)
        for axes, stable_name in ((power, f"{number}: {wind:g} m/s"), (speed, f"{number}: {wind:g} m/s")):
            stable, unstable = _line(axes, stable_name), _line(axes, f"unstable {wind:g} m/s")
            assert stable.get_xdata()[0] == unstable.get_xdata()[0] == pytest.approx(critical, abs=1e-8)
            assert stable.get_ydata()[0] == pytest.approx(unstable.get_ydata()[0], abs=1e-3)
        for name, point in named_points(law, wind).items():
            (place,) = _line(rotor, f"point {name}{number}").get_xydata()
            assert place.tolist() == [point.rotor_speed_pu, point.power_pu]
        # What the law demands touches what the rotor captures.
        surplus = _line(rotor, f"captured {wind:g} m/s").get_ydata() - _line(rotor, f"demand {wind:g} m/s").get_ydata()
        assert -1e-4 < surplus.max() <= 1e-9


def test_bode_states_the_papers_margins() -> None:
    linear = single_machine(STRATEGIES["coordinated-linear"], 11.4)
    figure = plot_bode({"ideal-source": ideal_source_loop(), "coordinated-linear": linear})
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[0].startswith("ideal-source: 48.8° at ") and legend[1].startswith("coordinated-linear: 55.4° at ")
    phase = _line(figure.axes[1], "phase ideal-source").get_ydata()
    # From one integrator to two, without a jump.
    assert phase[0] == pytest.approx(-90.0, abs=0.2) and np.abs(np.diff(phase)).max() < 2.0


def test_case_study_shows_every_run_of_every_group_and_marks_stalls_and_limits() -> None:
    runs = run_case(0)
    figure = plot_case_study(get_suite("paper").scenario(0), runs)
    assert len(figure.axes) == 8
    power, rotor = figure.axes[3], figure.axes[5]
    for name, run in runs.items():
        assert np.array_equal(_line(rotor, name).get_ydata(), run.rotor_speed_pu[:, 1])
    stalled = {run.time_s[-1] for run in runs.values() if run.status == Status.STALL}
    assert {line.get_xdata()[0] for line in power.get_lines() if line.get_marker() == "x"} == stalled
    heights = [float(line.get_ydata()[0]) for line in power.get_lines()]
    for limit in (float(available_power_pu(8.0)), 0.9 * float(available_power_pu(8.0))):
        assert np.isclose(heights, limit, rtol=1e-9).any()
