"""Facts about the figures of a policy's behaviour: they show the recorded values, in few points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wtg_gym.envs import EnvSettings
from wtg_gym.evaluation import Entry
from wtg_gym.evaluation.recording import Recording, one_scenario, record
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.scenario import Scenario
from wtg_gym.plotting import plot_costs, plot_responses, plot_runs
from wtg_gym.plotting.policy_runs import needed_points
from wtg_gym.plotting.responses import binned
from wtg_gym.plotting.style import Look
from wtg_gym.scenarios import get_suite

REFERENCE = "coordinated-piecewise"


class Windward:
    """Adds to k in strong wind: the first group, or both alike."""

    def __init__(self, both: bool) -> None:
        self._second = float(both)

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        actions = np.zeros((len(observation), 4))
        actions[:, 0], actions[:, 2] = observation[:, 5], self._second * observation[:, 15]
        return actions, state


@pytest.fixture(scope="module")
def scenarios() -> list[Scenario]:
    return get_suite("standard").scenarios(range(10_000, 10_012), duration_s=20.0)


@pytest.fixture(scope="module")
def runs(scenarios: list[Scenario]) -> dict[str, Recording]:
    entries = [Entry(name=REFERENCE), *(Entry(name=f"both {b}", policy=Windward(b)) for b in (True, False))]
    return {entry.name: record(entry, EnvSettings(duration_s=20.0, version="v0"), scenarios) for entry in entries}


def test_bins_hold_the_quantiles_of_their_samples() -> None:
    x, y = np.repeat([0.5, 1.5, 2.5], [1001, 1001, 29]), np.r_[np.arange(2002.0) % 1001, np.zeros(29)]
    x[0], y[1] = np.nan, np.inf
    bins = binned(x, y, np.array([0.0, 1.0, 2.0, 3.0]))
    assert bins.centre.tolist() == [0.5, 1.5, 2.5] and np.isfinite(bins.median).tolist() == [True, True, False]
    assert (bins.low[1], bins.median[1], bins.high[1]) == pytest.approx((100.0, 500.0, 900.0))


def test_the_legend_of_responses_has_the_dashes_of_their_curves(runs: dict[str, Recording]) -> None:
    looks = {REFERENCE: Look("#0072B2"), "both True": Look("#009E73", (0.0, (1.2, 1.2)))}
    figure = plot_responses("both True", runs["both True"], runs[REFERENCE], looks)
    drawn = {(line.get_color(), line.get_linestyle()) for axes in figure.axes for line in axes.lines}
    assert {(line.get_color(), line.get_linestyle()) for line in figure.legends[0].get_lines()} == drawn


def test_responses_show_k_tau_and_samples_over_everything_seen(runs: dict[str, Recording]) -> None:
    figure = plot_responses("both True", runs["both True"], runs[REFERENCE])
    panels = np.array(figure.axes).reshape(4, 5)
    assert all(axes.get_xlabel() and axes.get_xlabel().endswith("]") for axes in panels[3])
    assert [axes.get_ylabel() for axes in panels[:, 0]].count("") == 0
    # Its offset on k is linear in the wind, and 0 for the reference.
    reference, policy = panels[1, 4].lines
    assert not np.nan_to_num(np.asarray(reference.get_ydata())).any()
    wind, added = (np.asarray(values) for values in policy.get_data())
    slope = np.polyfit(wind[np.isfinite(added)], added[np.isfinite(added)], 1)[0]
    k_opt, k_pr = tracking_point(0.0).coefficient, tracking_point(0.1).coefficient
    assert slope == pytest.approx(0.5 * (1.0 - k_pr / k_opt) / 5.0, rel=0.05)


def test_groups_are_drawn_apart_only_where_they_act_differently(runs: dict[str, Recording]) -> None:
    together, apart = (plot_responses(name, runs[name], runs[REFERENCE]) for name in ("both True", "both False"))
    words = [[text.get_text() for text in figure.legends[0].get_texts()] for figure in (together, apart)]
    assert "WTG group 2" not in words[0] and "WTG group 2" in words[1]
    assert len(together.axes[5].lines) == 2 and len(apart.axes[5].lines) == 3


def test_runs_have_a_column_for_each_group_and_wind_where_it_changes(
    runs: dict[str, Recording], scenarios: list[Scenario]
) -> None:
    own = {name: [one_scenario(runs[name], 3)] for name in (REFERENCE, "both True")}
    figure = plot_runs(scenarios[3], own)
    grid = np.array(figure.axes).reshape(6, 2)
    assert [axes.get_xlabel() for axes in grid[5]] == ["time [s]"] * 2 and grid[5, 0].get_ylabel() == "wind [m/s]"
    k = grid[3, 1].lines[0]
    exact = own[REFERENCE][0].coefficient_pu[0, :, 1] / tracking_point(0.0).coefficient
    time = own[REFERENCE][0].time_s
    assert 2 < len(k.get_xdata()) < time.size
    assert np.interp(time, k.get_xdata(), k.get_ydata()) == pytest.approx(
        exact, abs=0.0035 * np.ptp(grid[3, 1].get_ylim())
    )
    steady = Scenario(name="steady", wind_speed=np.full((2, 1), 9.0), duration_s=5.0)
    calm = record(Entry(name=REFERENCE), EnvSettings(version="v0"), [steady])
    assert len(plot_runs(steady, {REFERENCE: [calm]}).axes) == 10


def test_cross_marks_an_early_end() -> None:
    case = get_suite("paper").scenario(0)
    settings = EnvSettings(suite="paper")
    own = {name: [record(Entry(name=name, strategy=name), settings, [case])] for name in (REFERENCE, "deloaded-5")}
    power = plot_runs(case, own).axes[2]
    (cross,) = [line for line in power.lines if line.get_marker() == "x"]
    run = own["deloaded-5"][0]
    end = int(np.isfinite(run.frequency_hz[0]).sum()) - 1
    assert end < run.time_s.size - 1
    assert (cross.get_xdata()[0], cross.get_ydata()[0]) == (run.time_s[end], run.power_pu[0, end, 0])


def test_thinned_line_stays_within_its_tolerance_and_keeps_gaps() -> None:
    x = np.linspace(0.0, 60.0, 601)
    y = np.sin(0.3 * x) + (x > 20.0)
    y[300:310] = np.nan
    kept = needed_points(x, y, 0.01)
    assert kept.sum() < 120 and kept[[0, -1]].all() and kept[299:311].all()
    finite = np.isfinite(y)
    assert np.interp(x[finite], x[kept & finite], y[kept & finite]) == pytest.approx(y[finite], abs=0.01)


def test_costs_are_totals_and_terms_that_somebody_pays() -> None:
    costs = {
        REFERENCE: {"frequency": 3.0, "duty": 1.0, "failure": 0.0},
        "mine": {"frequency": 2.0, "duty": 0.5, "failure": 0.0},
    }
    (axes,) = plot_costs(costs).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["total", "frequency", "duty"]
    assert [bar.get_width() for bar in axes.patches] == [4.0, 3.0, 1.0, 2.5, 2.0, 0.5]
    assert axes.get_xlabel() == "mean cost of an episode [–]"
