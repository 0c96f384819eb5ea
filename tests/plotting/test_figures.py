"""Facts about figures: files that repeat."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from wtg_gym import simulate
from wtg_gym.physics.scenario import Scenario
from wtg_gym.plotting import figure_bytes, plot_trajectories, save_figure

matplotlib = pytest.importorskip("matplotlib")

SCENARIO = Scenario(name="calm", wind_speed=np.full((2, 1), 8.0), duration_s=2.0)
_PROGRAM = """
import hashlib, sys
import wtg_gym.plotting
assert "matplotlib" not in sys.modules
from tests.plotting.test_figures import SCENARIO, figure_bytes, plot_trajectories, simulate
content = figure_bytes(plot_trajectories({"mppt": simulate(SCENARIO, "mppt")}, SCENARIO), "svg")
print(hashlib.sha256(content).hexdigest(), "matplotlib.pyplot" in sys.modules)
"""


def test_a_figure_is_the_same_file_in_another_process_and_whatever_the_users_settings():
    # Pyplot would choose a windowing backend behind the user's back.
    other = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True)
    runs = {"mppt": simulate(SCENARIO, "mppt")}
    with matplotlib.rc_context({"font.size": 20.0, "axes.grid": False, "lines.linewidth": 5.0}):
        before = dict(matplotlib.rcParams)
        content = figure_bytes(plot_trajectories(runs, SCENARIO), "svg")
        assert dict(matplotlib.rcParams) == before
    assert other.stdout.split() == [hashlib.sha256(content).hexdigest(), "False"]
    assert b">(a) WTG group 1</text>" in content and b"<dc:date>" not in content


def test_figures_are_saved_next_to_each_other_in_the_formats_that_are_named(tmp_path):
    figure = plot_trajectories({"mppt": simulate(SCENARIO, "mppt")}, SCENARIO)
    name = tmp_path / "new" / "figure 1.2"
    paths = save_figure(figure, name, ["svg", ".png", "pdf"])
    assert paths == [tmp_path / "new" / f"figure 1.2.{suffix}" for suffix in ("svg", "png", "pdf")]
    for path, beginning in zip(paths, (b"<?xml", b"\x89PNG", b"%PDF-"), strict=True):
        assert path.read_bytes().startswith(beginning)
    with pytest.raises(ValueError, match="written as png, svg, pdf, got 'bmp'"):
        save_figure(figure, tmp_path / "other", ["png", "bmp"])
    assert not list(tmp_path.glob("other*"))
