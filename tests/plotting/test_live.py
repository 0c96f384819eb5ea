"""The live pages without a browser: matches and their scores, ports and displays."""

from __future__ import annotations

import dataclasses
import re
import socket
import sys

import numpy as np
import pytest

from tests.cli.calls import error_of
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.evaluation.summary import POINTS, REST
from wtg_gym.physics.scenario import LineTrip, LoadStep, Scenario
from wtg_gym.plotting.live.episode import happened
from wtg_gym.plotting.live.match import Match, Scale
from wtg_gym.plotting.live.server import open_browser
from wtg_gym.scenarios import get_suite

_LENGTH_S = 12.0
_SEED = 20_000


@pytest.fixture(scope="module", params=["standard-v1", "standard"])
def scale(request: pytest.FixtureRequest) -> Scale:
    return Scale.of(get_suite(request.param), _LENGTH_S)


def _played(scale: Scale, on_k: float, on_tau: float = 0.0, seed: int = _SEED) -> Match:
    match = Match(scale, seed)
    n = match.n_groups
    while not match.over:
        match.step(np.full(n, on_k), np.full(n, on_tau))
    return match


# --- match -----------------------------------------------------------------------------------------------------------


def test_without_an_action_you_are_the_reference(scale: Scale) -> None:
    match = _played(scale, 0.0)
    you, *anchors = match.verdicts()
    same = next(each for each in anchors if each.name == "coordinated-piecewise")
    assert dataclasses.replace(you, name=same.name) == same
    assert match.reference.measured(same.name).metrics["cost"] == same.cost
    assert [each.name for each in anchors] == list(scale.suite.benchmark.anchors)


def test_actions_reach_the_group_and_the_quantity_they_are_meant_for(scale: Scale) -> None:
    match = Match(scale, _SEED)
    on_k, on_tau = np.linspace(-0.5, 0.7, match.n_groups), np.linspace(0.9, -0.3, match.n_groups)
    match.step(on_k, on_tau)
    simulator, names = match.you.lanes.simulator, match.you.lanes.observation_names
    seen = dict(zip(names, match.you.lanes.observations[0].tolist(), strict=True))
    of_k = [seen[name] for name in names if "last_action_k" in name]
    of_tau = [seen[name] for name in names if "last_action_tau" in name]
    assert of_k == pytest.approx(on_k, abs=1e-6)
    assert of_tau == pytest.approx(on_tau, abs=1e-6)
    offsets = simulator.wtg_values("k_offset")[0]
    assert np.sign(offsets).tolist() == np.sign(on_k).tolist()
    assert not match.reference.lanes.simulator.wtg_values("k_offset").any()


def test_score_and_points_are_the_evaluators(scale: Scale) -> None:
    """A policy that holds the same action through the scale's scenarios gets the mean of the matches' scores."""

    class Held:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):  # type: ignore[no-untyped-def]
            return np.full((len(observation), 2 * len(scale.suite.plant.groups)), 0.3), state

    seeds = list(scale.suite.validation[:50])
    entry = Entry(name="held", policy=Held(), action_mode="k+tau")
    row = next(
        each
        for each in evaluate([entry], scale.suite.name, "validation", seeds=seeds, duration_s=_LENGTH_S).summaries
        if each.name == "held"
    )
    yours = [_played(scale, 0.3, 0.3, seed).verdicts()[0] for seed in seeds]
    scores = [you.score for you in yours if you.score is not None]
    assert len(scores) == len(seeds)
    assert np.mean(scores) == pytest.approx(row.score.value, abs=1e-9)
    for name in (*POINTS, REST):
        assert np.mean([you.points[name] for you in yours]) == pytest.approx(row.points_by_term[name], abs=1e-9)


@pytest.mark.parametrize(
    ("seed", "failure", "words"),
    [
        (20_003, "under-speed", r"after \d+\.\d s: the rotor of group \d was too slow, below 0\.5 p\.u\."),
        (20_004, "frequency limit", r"after \d+\.\d s: the frequency left 48\.5 … 51\.5 Hz, at 48\.4\d Hz"),
    ],
)
def test_full_action_on_k_fails_and_says_so(seed: int, failure: str, words: str) -> None:
    scale = Scale(suite=get_suite("standard-v1"), duration_s=60.0, value=1.0)
    match = _played(scale, 1.0, seed=seed)
    you = match.verdicts()[0]
    assert you.failure == failure and re.fullmatch(words, match.you.failure())
    assert match.you.time_s < match.scenario.duration_s
    assert match.reference.failure() == ""
    assert you.score is not None and sum(you.points.values()) == pytest.approx(you.score - 100.0)


def test_a_suite_without_a_scale_says_why() -> None:
    scale = Scale.of(get_suite("paper-v1"))
    assert scale.value is None and "is not worse than" in scale.missing
    you = _played(scale, 0.0, seed=0).verdicts()[0]
    assert you.score is None and you.cost > 0.0
    assert sorted(Match(scale, seed).next_seed() for seed in (0, 1)) == [0, 1]


def test_events_are_told_when_they_happen_and_a_line_closes_too() -> None:
    events = (
        LoadStep(time_s=0.0, bus=2, power_mw=10.0),
        LineTrip(time_s=1.0, from_bus=2, to_bus=3, recloses_after_s=0.5),
    )
    scenario = Scenario(name="x", wind_speed=np.full((1, 1), 9.0), events=events)
    assert happened(scenario, -1.0, 0.1) == [(0.0, "+10 MW at bus 2")]
    assert happened(scenario, 0.1, 0.9) == []
    assert happened(scenario, 0.9, 1.0) == [(1.0, "line 2–3 opens for 0.5 s")]
    assert happened(scenario, 1.0, 9.0) == [(1.5, "line 2–3 closes")]


# --- server ----------------------------------------------------------------------------------------------------------


def test_a_port_in_use_and_a_wrong_one_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("bokeh")
    with socket.create_server(("localhost", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"--port {port} is in use" in error_of(capsys, "play", "--no-browser", "--port", str(port))
    assert "--port must be 0 … 65535" in error_of(capsys, "play", "--no-browser", "--port", "70000")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--suite", "none"), "unknown suite 'none'"),
        (("--seed", "-1"), "is in no split of suite 'standard-v1'"),
        (("--seed", str(2**40)), "that can be played: train 1000000"),
        (("--speed", "0"), "--speed"),
        (("--version", "v0", "--suite", "standard-v1"), "unknown suite 'standard-v1'"),
    ],
)
def test_wrong_choices_are_said_before_anything_is_played(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    assert said in error_of(capsys, "play", "--no-browser", *arguments)


def test_without_bokeh_the_extra_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "bokeh", None)
    assert "in a checkout: pip install '.[leaderboard]'" in error_of(capsys, "play", "--no-browser")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems always have a display")
def test_without_a_display_no_browser_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("webbrowser.open", lambda *_: pytest.fail("a browser was opened"))
    assert not open_browser("http://localhost:1/")
