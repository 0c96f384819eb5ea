"""Scenarios as data: limits, round trips, clear refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.scenario import LineTrip, LoadRamp, LoadStep, LoadTrip, Scenario

WIND = np.full((2, 11), 9.0)


def test_scenario_survives_json_exactly() -> None:
    scenario = Scenario(
        name="all",
        wind_speed=np.random.default_rng(0).uniform(5.0, 12.0, (2, 601)),
        events=(
            LoadStep(time_s=5.0, bus=2, power_mw=75.0, reactive_mvar=10.0),
            LoadRamp(time_s=6.0, bus=3, power_mw=-20.0, duration_s=4.0),
            LoadTrip(time_s=7.0, bus=9),
            LineTrip(time_s=8.0, from_bus=2, to_bus=4),
        ),
        load_noise_mw=np.concatenate([[0.0], np.random.default_rng(1).normal(size=20)]),
        governor_droop=0.04,
        inertia_scale=0.7,
        load_level=0.9,
        seed=3,
    )
    again = Scenario.from_json(scenario.to_json())
    assert again.to_dict() == scenario.to_dict()
    assert again.events == scenario.events
    assert (again.wind_speed == scenario.wind_speed).all()


def test_series_cannot_be_changed_afterwards() -> None:
    scenario = Scenario(name="x", wind_speed=WIND)
    with pytest.raises(ValueError, match="read-only"):
        scenario.wind_speed[0, 0] = 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wind_speed": np.array([[9.0, -1.0], [9.0, 9.0]])}, r"group 0 at t = 0.1 s is -1 m/s.* 3 … 25 m/s"),
        ({"wind_speed": np.array([[9.0, np.nan]])}, r"is nan m/s, outside the allowed range"),
        ({"wind_speed": np.zeros(3)}, r"shape \(n_wtg, n_samples\), got shape \(3,\)"),
        ({"wind_dt_s": 0.0}, r"wind_dt_s = 0 s is outside the allowed range"),
        ({"duration_s": float("inf")}, r"duration_s = inf s is outside"),
        ({"duration_s": "60"}, r"duration_s must be a number"),
        ({"load_noise_mw": np.array([1.0, 0.0])}, r"must start at 0 MW, got 1 MW"),
        ({"load_noise_mw": np.array([0.0, np.inf])}, r"at t = 0.1 s is inf MW, outside the allowed range"),
        ({"load_noise_mw": np.array([0.0, 1.0, 1e200])}, r"at t = 0.2 s is 1e\+200 MW, outside .* -10000 … 10000 MW"),
        ({"load_noise_mw": np.array([0.0, np.nan])}, r"at t = 0.1 s is nan MW"),
        ({"load_noise_mw": np.zeros((2, 2))}, r"must have shape \(n_samples,\), got shape \(2, 2\)"),
        ({"name": 3}, r"name of a scenario must be text, got 3"),
        ({"load_level": 2.0}, r"load_level = 2 is outside the allowed range 0.3 … 1.5"),
        ({"governor_droop": 0.0}, r"governor_droop = 0 p.u. is outside"),
        ({"inertia_scale": -1.0}, r"inertia_scale = -1 is outside"),
        ({"load_noise_bus": 0}, r"must be a bus number"),
        ({"events": ("boom",)}, r"unknown event 'boom'; known kinds: load_step"),
    ],
)
def test_impossible_values_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenario(**{"name": "x", "wind_speed": WIND, **changes})


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"wind_speed": [[9.0]]}, r"missing 1 required .*name"),
        ({"name": "x", "wind_speed": [[9.0]], "windd": 1}, r"unknown scenario keys \['windd'\]; known keys"),
        ({"name": "x", "wind_speed": [[9.0]], "events": [{"kind": "quake"}]}, r"needs a kind out of load_step"),
        ({"name": "x", "wind_speed": [[9.0]], "events": [{"kind": "load_trip", "bus": 4}]}, r"time_s"),
        ({"name": "x", "wind_speed": [["fast"]]}, r"could not convert"),
        ([1, 2], r"must be an object"),
    ],
)
def test_broken_descriptions_are_named(data: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenario.from_dict(data)


@pytest.mark.parametrize(
    "make",
    [
        lambda: LoadStep(time_s=-1.0, bus=2, power_mw=1.0),
        lambda: LoadStep(time_s=1.0, bus=2.5, power_mw=1.0),  # type: ignore[arg-type]
        lambda: LoadStep(time_s=1.0, bus=2, power_mw=float("nan")),
        lambda: LoadRamp(time_s=1.0, bus=2, power_mw=1.0, duration_s=0.0),
        lambda: LineTrip(time_s=1.0, from_bus=-1, to_bus=2),
        lambda: LoadTrip(time_s=float("inf"), bus=2),
    ],
)
def test_impossible_events_are_refused(make: Any) -> None:
    with pytest.raises(ValueError):
        make()
