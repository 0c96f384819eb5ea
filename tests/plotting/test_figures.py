"""Facts about figures, which are files that repeat, and about the page of play without a browser."""

import dataclasses
import hashlib
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from wtg_gym import Entry, Scenario, evaluate, get_suite, simulate
from wtg_gym.plotting import figure_bytes, plot_trajectories, save_figure
from wtg_gym.plotting.live import OWN, REFERENCE, Match
from wtg_gym.plotting.style import law_looks
from wtg_gym.scenarios import Suite
from wtg_gym.tasks import V1

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
_LENGTH_S = 12.0
_SEED = 20_000


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


def test_figures_are_saved_in_the_format_that_is_named(tmp_path):
    figure = plot_trajectories({"mppt": simulate(SCENARIO, "mppt")}, SCENARIO)
    for suffix, beginning in {"svg": b"<?xml", "PNG": b"\x89PNG", "pdf": b"%PDF-"}.items():
        path = tmp_path / "new" / f"figure 1.2.{suffix}"
        save_figure(figure, path)
        assert path.read_bytes().startswith(beginning)
    with pytest.raises(ValueError, match=r"written as png, svg, pdf, got '\.bmp'"):
        save_figure(figure, tmp_path / "other.bmp")
    assert not list(tmp_path.glob("other*"))


def test_an_entry_looks_the_same_beside_the_law_at_100_and_beside_all_references():
    two = law_looks(["mine", V1.hundred])
    assert two == {name: law_looks(["mine", *V1.references])[name] for name in two}


@pytest.fixture(scope="module", params=["standard-v1", "standard"])
def suite(request):
    return get_suite(request.param)


def _played(suite: Suite, on_k: float, on_tau: float = 0.0, seed: int = _SEED) -> Match:
    match = Match(suite, seed, _LENGTH_S)
    while not match.has_ended():
        match.step(on_k, on_tau)
    return match


def _episodes(match: Match):
    results = match.results()
    return [results.episodes_of(name)[0] for name in ("you", *results.task.anchors)]


def test_without_an_action_you_are_the_reference(suite):
    match = _played(suite, 0.0)
    you, *anchors = _episodes(match)
    same = next(each for each in anchors if each.entry == "coordinated-piecewise")
    assert dataclasses.replace(you, entry=same.entry) == same
    assert [each.entry for each in anchors] == list(suite.task.anchors)
    assert all(np.array_equal(values[OWN], values[REFERENCE]) for values in match.sample().values())


def test_the_cost_is_the_evaluators(suite):
    def held(observation, state=None, **_):
        return np.tile([0.3, -0.2], (len(observation), len(suite.plant.groups))), state

    seeds = list(suite.validation[:3])
    entry = Entry(name="held", policy=SimpleNamespace(predict=held), action_mode="k+tau")
    results = evaluate([entry], suite.name, "validation", seeds=seeds, duration_s=_LENGTH_S)
    yours = [_episodes(_played(suite, 0.3, -0.2, seed))[0] for seed in seeds]
    assert [you.metrics for you in yours] == [episode.metrics for episode in results.episodes_of("held")]
