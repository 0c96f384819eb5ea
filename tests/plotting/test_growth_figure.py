"""The figure of growth: its panels, axes and lines."""

from __future__ import annotations

import pytest

from wtg_gym.analysis.benchmarks.growth import Curve, Point
from wtg_gym.plotting import plot_growth


def curve(name: str, *sizes: int) -> Curve:
    return Curve(name, tuple(Point(n, 3.0 * n, 0.0, 1e4) for n in sizes))


@pytest.mark.parametrize("single", [False, True])
def test_a_panel_for_each_kind_of_size(single: bool) -> None:
    curves = [curve("groups", 1, 2, 4), curve("lanes", 1, 16), curve("threads", 1, 2)]
    if single:
        curves.insert(1, curve("groups, single", 1, 2, 4))
    groups, lanes, threads, empty = plot_growth(curves).axes
    assert groups.get_xlabel() == "number of groups" and groups.get_ylabel() == "time per step [µs]"
    assert groups.get_xscale() == groups.get_yscale() == "log"
    assert len(groups.lines) == (4 if single else 2)
    assert len(lanes.lines) == 1 and lanes.get_legend() is None
    assert threads.get_legend().get_texts()[0].get_text() == "ideal"
    assert not empty.axison
