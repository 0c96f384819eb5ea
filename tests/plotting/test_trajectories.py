"""The figure of recorded runs."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from wtg_gym.envs.rendering.diagram import describe_event, struck_buses
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import (
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
    Scenario,
)
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.plotting import STRATEGY_LOOKS, plot_trajectories
from wtg_gym.plotting.event_marks import mark_instants
from wtg_gym.plotting.style import GROUP_STYLES

pytest.importorskip("matplotlib")


@pytest.fixture
def two_runs(load_increase: tuple[Scenario, dict[str, Trajectory]]) -> tuple[Scenario, dict[str, Trajectory]]:
    return load_increase[0], {name: load_increase[1][name] for name in ("mppt", "coordinated-piecewise")}


def test_overload_begins_where_the_grid_says(two_runs: tuple[Scenario, dict[str, Trajectory]]) -> None:
    for given, expected in (((), 1.1), ((1.05,), 1.05)):
        figure = plot_trajectories(two_runs[1], two_runs[0], *given)
        (name,) = [text for axes in figure.axes for text in axes.texts if text.get_text() == "overload"]
        assert name.get_position()[1] == expected


def test_a_strategy_keeps_its_colour_and_a_group_its_dashes(
    two_runs: tuple[Scenario, dict[str, Trajectory]],
) -> None:
    figure = plot_trajectories(two_runs[1], two_runs[0])
    rotor = next(axes for axes in figure.axes if axes.get_ylabel() == "rotor speed [p.u.]")
    traces = [line for line in rotor.get_lines() if len(line.get_xdata()) > 2]
    assert [(line.get_color(), line.get_linestyle()) for line in traces] == [
        (STRATEGY_LOOKS[run].colour, GROUP_STYLES[group])
        for run in ("mppt", "coordinated-piecewise")
        for group in range(2)
    ]


def test_a_run_that_ended_early_is_marked_with_a_cross_where_it_ended(
    two_runs: tuple[Scenario, dict[str, Trajectory]],
) -> None:
    scenario, runs = two_runs
    assert runs["mppt"].status == Status.STALL
    figure = plot_trajectories(runs, scenario)
    crosses = [line for axes in figure.axes for line in axes.get_lines() if line.get_marker() == "x"]
    assert crosses
    assert {float(np.asarray(line.get_xdata())[0]) for line in crosses} == {float(runs["mppt"].time_s[-1])}
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["mppt", "coordinated-piecewise", "WTG group 1", "WTG group 2", "run ended: stall"]


def test_events_are_numbered_and_explained(two_runs: tuple[Scenario, dict[str, Trajectory]]) -> None:
    figure = plot_trajectories(two_runs[1], two_runs[0])
    texts = "\n".join(text.get_text() for text in figure.texts)
    assert two_runs[0].name in texts
    assert "(1) 5 s: +75 MW at bus 2" in texts
    assert "(2) 30 s: +75 MW at bus 3" in texts


def _with_groups(run: Trajectory, n_groups: int) -> Trajectory:
    """The run with its two groups repeated or cut to `n_groups`, without simulating another plant."""
    tables = {key: value for key, value in vars(run).items() if getattr(value, "ndim", 0) == 2}
    columns = np.arange(n_groups) % 2
    return dataclasses.replace(run, **{key: value[:, columns] for key, value in tables.items()})


def test_many_groups_are_drawn_as_thin_plain_lines(
    two_runs: tuple[Scenario, dict[str, Trajectory]],
) -> None:
    scenario, runs = two_runs
    figure = plot_trajectories({"mppt": _with_groups(runs["mppt"], 6)}, scenario)
    assert "one line per WTG group (6)" in [text.get_text() for text in figure.legends[0].get_texts()]
    rotor = next(axes for axes in figure.axes if axes.get_ylabel() == "rotor speed [p.u.]")
    traces = [line for line in rotor.get_lines() if len(line.get_xdata()) > 2]
    assert [line.get_linestyle() for line in traces] == ["-"] * 6


def test_pyplot_is_never_imported() -> None:
    # A windowing backend must not be chosen behind the user's back.
    before = "matplotlib.pyplot" in sys.modules
    scenario = Scenario(name="calm", wind_speed=np.full((2, 1), 9.0), duration_s=1.0)
    plot_trajectories({"mppt": simulate(scenario, STRATEGIES["mppt"])}, scenario)
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_events_are_described_with_units() -> None:
    assert describe_event(LoadStep(time_s=1.0, bus=2, power_mw=75.0)) == "+75 MW at bus 2"
    step = LoadStep(time_s=1.0, bus=2, power_mw=-20.0, reactive_mvar=5.0)
    assert describe_event(step) == "−20 MW, +5 Mvar at bus 2"
    ramp = LoadRamp(time_s=1.0, bus=3, power_mw=20.0, duration_s=4.0)
    assert describe_event(ramp) == "+20 MW at bus 3 over 4 s"
    assert describe_event(LoadTrip(time_s=1.0, bus=4)) == "load of bus 4 lost"
    assert describe_event(LineTrip(time_s=1.0, from_bus=2, to_bus=4)) == "line 2–4 opens"
    brief = LineTrip(time_s=1.0, from_bus=2, to_bus=4, recloses_after_s=0.5)
    assert describe_event(brief) == "line 2–4 opens for 0.5 s"
    assert describe_event(GovernorLoss(time_s=1.0, bus=1)) == "governor at bus 1 lost"
    assert describe_event(MachineOutage(time_s=1.0, bus=6)) == "machine at bus 6 disconnected"
    # Counted as in the diagram, where the first group is W1.
    assert describe_event(GroupTrip(time_s=1.0, group=0)) == "WTG group 1 disconnected"


def test_events_strike_both_ends_of_a_line_or_the_bus_of_their_unit() -> None:
    assert struck_buses(LineTrip(time_s=1.0, from_bus=2, to_bus=4), [2, 5]) == [2, 4]
    assert struck_buses(MachineOutage(time_s=1.0, bus=6), [2, 5]) == [6]
    assert struck_buses(GroupTrip(time_s=1.0, group=1), [2, 5]) == [5]


def test_a_line_is_marked_where_it_opens_and_where_it_closes() -> None:
    events = (
        LineTrip(time_s=2.0, from_bus=1, to_bus=2, recloses_after_s=3.0),
        LineTrip(time_s=6.0, from_bus=1, to_bus=2, recloses_after_s=30.0),
    )
    scenario = Scenario(name="x", wind_speed=np.full((2, 1), 9.0), duration_s=20.0, events=events)
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    mark_instants(axes, scenario, numbered=True)
    assert sorted(float(np.asarray(line.get_xdata())[0]) for line in axes.get_lines()) == [2.0, 5.0, 6.0]
    assert [text.get_text() for text in axes.texts] == ["(1)", "(2)"]
