"""Facts about figures: files that repeat, and marks that say what happened."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from wtg_gym.envs.rendering.diagram import describe_event, struck_buses
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import (
    Event,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
)
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.plotting import figure_bytes, plot_trajectories, save_figure
from wtg_gym.reproduce.figures import plot_power_coefficient
from wtg_gym.scenarios import get_suite

matplotlib = pytest.importorskip("matplotlib")

_PROGRAM = """
import hashlib, sys
from wtg_gym.plotting import figure_bytes
assert "matplotlib" not in sys.modules
from wtg_gym.reproduce.figures import plot_power_coefficient
print(hashlib.sha256(figure_bytes(plot_power_coefficient(), "svg")).hexdigest(), "matplotlib.pyplot" in sys.modules)
"""


def test_a_figure_is_the_same_file_in_another_process_and_whatever_the_users_settings() -> None:
    # Pyplot would choose a windowing backend behind the user's back.
    other = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True)
    with matplotlib.rc_context({"font.size": 20.0, "axes.grid": False, "lines.linewidth": 5.0}):
        before = dict(matplotlib.rcParams)
        content = figure_bytes(plot_power_coefficient(), "svg")
        assert dict(matplotlib.rcParams) == before
    assert other.stdout.split() == [hashlib.sha256(content).hexdigest(), "False"]
    assert b">(a) power coefficient and reserve</text>" in content and b"<dc:date>" not in content


def test_figures_are_saved_next_to_each_other_in_the_formats_that_are_named(tmp_path: Path) -> None:
    figure, name = plot_power_coefficient(), tmp_path / "new" / "figure 1.2"
    paths = save_figure(figure, name, ["svg", ".png", "pdf"])
    assert paths == [tmp_path / "new" / f"figure 1.2.{suffix}" for suffix in ("svg", "png", "pdf")]
    for path, beginning in zip(paths, (b"<?xml", b"\x89PNG", b"%PDF-"), strict=True):
        assert path.read_bytes().startswith(beginning)
    with pytest.raises(ValueError, match="written as png, svg, pdf, got 'bmp'"):
        save_figure(figure, tmp_path / "other", ["png", "bmp"])
    assert not list(tmp_path.glob("other*"))


def test_a_run_that_ended_early_is_marked_where_it_ended_and_events_are_numbered() -> None:
    scenario = get_suite("paper").scenario(0)
    runs = {name: simulate(scenario, STRATEGIES[name]) for name in ("mppt", "coordinated-piecewise")}
    assert runs["mppt"].status == Status.STALL
    figure = plot_trajectories(runs, scenario)
    crosses = [line for axes in figure.axes for line in axes.get_lines() if line.get_marker() == "x"]
    assert {float(np.asarray(line.get_xdata())[0]) for line in crosses} == {float(runs["mppt"].time_s[-1])}
    texts = "\n".join(text.get_text() for text in figure.texts)
    assert "(1) 5 s: +75 MW at bus 2" in texts and "(2) 30 s: +75 MW at bus 3" in texts


#: Events, how they are described, and which buses they strike where the groups are at buses 2 and 5.
EVENTS: list[tuple[Event, str, list[int]]] = [
    (LoadStep(time_s=1.0, bus=2, power_mw=-20.0, reactive_mvar=5.0), "−20 MW, +5 Mvar at bus 2", [2]),
    (LoadRamp(time_s=1.0, bus=3, power_mw=20.0, duration_s=4.0), "+20 MW at bus 3 over 4 s", [3]),
    (LoadTrip(time_s=1.0, bus=4), "load of bus 4 lost", [4]),
    (LineTrip(time_s=1.0, from_bus=2, to_bus=4, recloses_after_s=0.5), "line 2–4 opens for 0.5 s", [2, 4]),
    (GovernorLoss(time_s=1.0, bus=1), "governor at bus 1 lost", [1]),
    (MachineOutage(time_s=1.0, bus=6), "machine at bus 6 disconnected", [6]),
    # Counted as in the diagram, where the first group is W1.
    (GroupTrip(time_s=1.0, group=1), "WTG group 2 disconnected", [5]),
]


@pytest.mark.parametrize(("event", "text", "buses"), EVENTS)
def test_events_are_described_with_units_and_strike_their_buses(event: Event, text: str, buses: list[int]) -> None:
    assert (describe_event(event), struck_buses(event, [2, 5])) == (text, buses)
