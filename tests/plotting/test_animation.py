"""The moving picture of recorded runs."""

from __future__ import annotations

import io

import numpy as np
import pytest

from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import STRATEGY_LOOKS, animate_trajectories
from wtg_gym.plotting.animation import LAST_PICTURE_MS, N_PICTURES, PICTURE_MS, SIZE
from wtg_gym.plotting.event_marks import event_lines, instant_labels

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")

CaseStudy = tuple[Scenario, dict[str, Trajectory]]


@pytest.fixture(scope="module")
def content(load_increase: CaseStudy) -> bytes:
    scenario, runs = load_increase
    return animate_trajectories({name: runs[name] for name in ("mppt", "coordinated-piecewise")}, scenario, [2, 2])


def _pixels(content: bytes, index: int) -> np.ndarray:
    with Image.open(io.BytesIO(content)) as picture:
        picture.seek(index)
        return np.asarray(picture.convert("RGB")).astype(int)


def _columns(content: bytes, index: int, colour: str) -> np.ndarray:
    """Return in which columns of the panels a colour is."""
    rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    hits = np.abs(_pixels(content, index)[:, 400:] - rgb).max(axis=2) < 24
    return np.flatnonzero(hits.any(axis=0))


def test_it_repeats_and_fits_into_a_page(content: bytes) -> None:
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.size == SIZE and picture.info["loop"] == 0 and picture.n_frames == N_PICTURES + 1
        durations = []
        for index in range(picture.n_frames):
            picture.seek(index)
            durations.append(picture.info["duration"])
    assert durations == [PICTURE_MS] * N_PICTURES + [LAST_PICTURE_MS]
    assert len(content) < 900_000


def test_curves_grow_until_their_run_ends(content: bytes) -> None:
    # MPPT stalls at 44.8 of 120 s, the reference goes on.
    mppt, reference = (STRATEGY_LOOKS[name].colour for name in ("mppt", "coordinated-piecewise"))
    ends = {
        colour: [_columns(content, index, colour).max() for index in (30, 60, N_PICTURES)]
        for colour in (mppt, reference)
    }
    assert ends[reference][0] < ends[reference][1] < ends[reference][2]
    assert ends[mppt][0] < ends[mppt][1] == ends[mppt][2] < 0.5 * ends[reference][2]


def test_it_is_the_same_file_each_time(load_increase: CaseStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, runs = load_increase
    monkeypatch.setattr("wtg_gym.plotting.animation.N_PICTURES", 6)
    alone = {"mppt": runs["mppt"]}
    assert animate_trajectories(alone, scenario, [2, 2]) == animate_trajectories(alone, scenario, [2, 2])


def test_numbers_of_close_instants_share_a_label(load_increase: CaseStudy) -> None:
    wind = load_increase[0].wind_speed
    events = tuple(LoadStep(time_s=time, bus=3, power_mw=5.0) for time in (10.0, 12.0, 40.0, 70.0))
    scenario = Scenario(name="", duration_s=60.0, wind_speed=wind, events=events)
    assert instant_labels(scenario) == [(11.0, "(1, 2)"), (40.0, "(3)")]


def test_events_in_words_stay_apart_where_blanks_in_a_row_count_as_one(load_increase: CaseStudy) -> None:
    assert event_lines(load_increase[0]) == ["(1) 5 s: +75 MW at bus 2;  (2) 30 s: +75 MW at bus 3"]
