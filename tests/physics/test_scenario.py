"""Scenarios as data: limits, round trips, clear refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.scenario import (
    EVENT_KINDS,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
    Scenario,
)

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
            LineTrip(time_s=8.5, from_bus=1, to_bus=5, recloses_after_s=0.4),
            GovernorLoss(time_s=9.0, bus=1),
            MachineOutage(time_s=10.0, bus=3),
            GroupTrip(time_s=11.0, group=0),
        ),
        load_noise_mw=np.concatenate([[0.0], np.random.default_rng(1).normal(size=20)]),
        governor_droop=0.04,
        inertia_scale=0.7,
        load_level=0.9,
        seed=3,
    )
    assert {type(event) for event in scenario.events} == set(EVENT_KINDS.values())
    again = Scenario.from_json(scenario.to_json())
    assert again.to_dict() == scenario.to_dict()
    assert again.events == scenario.events
    assert (again.wind_speed == scenario.wind_speed).all()


def test_a_line_that_stays_open_is_written_as_before_lines_could_close_again() -> None:
    def written(**more: float) -> dict[str, Any]:
        line = LineTrip(time_s=8.0, from_bus=2, to_bus=4, **more)
        event: dict[str, Any] = Scenario(name="x", wind_speed=WIND, events=(line,)).to_dict()["events"][0]
        return event

    assert list(written()) == ["kind", "time_s", "from_bus", "to_bus"]
    assert written(recloses_after_s=0.5) == {**written(), "recloses_after_s": 0.5}


def test_series_cannot_be_changed_afterwards() -> None:
    scenario = Scenario(name="x", wind_speed=WIND)
    with pytest.raises(ValueError, match="read-only"):
        scenario.wind_speed[0, 0] = 1.0


# For each rule values that break it, and what the message says.
VALUES: list[tuple[dict[str, Any], str]] = [
    ({"name": 3}, r"name of a scenario must be text, got 3"),
    ({"wind_speed": np.array([[9.0, -1.0], [9.0, 9.0]])}, r"group 1 at t = 0.1 s is -1 m/s.* 3 … 25 m/s"),
    ({"wind_speed": np.array([[9.0, np.nan]])}, r"is nan m/s, outside the allowed range"),
    ({"wind_speed": np.zeros(3)}, r"shape \(n_wtg, n_samples\), got shape \(3,\)"),
    ({"wind_speed": [[8.0], [8.0, 9.0]]}, r"wind_speed must be numbers in a regular array"),
    ({"wind_dt_s": 0.0}, r"wind_dt_s = 0 s is outside the allowed range"),
    ({"duration_s": float("inf")}, r"duration_s = inf s is outside"),
    ({"duration_s": "60"}, r"duration_s must be a number"),
    ({"load_noise_mw": np.array([1.0, 0.0])}, r"must start at 0 MW, got 1 MW"),
    ({"load_noise_mw": np.array([0.0, 1.0, 1e200])}, r"at t = 0.2 s is 1e\+200 MW, outside .* -10000 … 10000 MW"),
    ({"load_noise_mw": np.array([0.0, np.nan])}, r"at t = 0.1 s is nan MW"),
    ({"load_noise_mw": np.zeros((2, 2))}, r"must have shape \(n_samples,\), got shape \(2, 2\)"),
    ({"load_noise_bus": 0}, r"must be a bus number"),
    ({"load_level": 2.0}, r"load_level = 2 is outside the allowed range 0.3 … 1.5"),
    ({"governor_droop": 0.0}, r"governor_droop = 0 p.u. is outside the allowed range 0.005 … 1 p.u."),
    ({"wind_speed": [["8"], ["8"]]}, r"wind_speed must be numbers .* got \['8', '8'\]"),
    ({"wind_speed": np.full((2, 1), 8.0 + 1.0j)}, r"wind_speed must be numbers"),
    ({"events": None}, r"events must be a tuple of events, got None"),
    ({"events": LoadTrip(time_s=1.0, bus=3)}, r"events must be a tuple of events, got LoadTrip"),
    ({"inertia_scale": -1.0}, r"inertia_scale = -1 is outside"),
    ({"seed": 1.5}, r"seed of a scenario must be a whole number in 0 … 2\^63 - 1, got 1.5"),
    ({"seed": 2**70}, r"seed of a scenario must be a whole number"),
    ({"events": ("boom",)}, r"unknown event 'boom'; known kinds: load_step"),
]


@pytest.mark.parametrize(("changes", "message"), VALUES)
def test_impossible_values_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenario(**{"name": "x", "wind_speed": WIND, **changes})


# The same for a scenario as JSON has it.
STEP = {"kind": "load_step", "time_s": 1.0, "bus": 2, "power_mw": 5.0}
DESCRIPTIONS: list[tuple[Any, str]] = [
    ([1, 2], r"must be an object"),
    ({"wind_speed": [[9.0]]}, r"missing 1 required .*name"),
    ({"name": "x", "wind_speed": [[9.0]], "windd": 1}, r"unknown scenario keys \['windd'\]; known keys"),
    ({"name": "x", "wind_speed": [["fast"]]}, r"could not convert"),
    ({"name": "x", "wind_speed": [[9.0]], "events": 3}, r"events must be a list, got 3"),
    ({"name": "x", "wind_speed": [[9.0]], "events": [{**STEP, "kind": "quake"}]}, r"needs a kind out of load_step"),
    ({"name": "x", "wind_speed": [[9.0]], "events": [{"kind": "load_trip", "bus": 4}]}, r"time_s"),
    ({"name": "x", "wind_speed": [[9.0]], "events": [{**STEP, "foo": 1}]}, r"foo"),
    ({"name": "x", "wind_speed": [[9.0]], "events": [{**STEP, "time_s": -1.0}]}, r"event time = -1 s is outside"),
    ({"name": "x", "wind_speed": [[9.0]], "events": [{**STEP, "bus": 2.5}]}, r"bus"),
    ({"name": "x", "wind_speed": [[9.0]], "events": [{**STEP, "power_mw": float("nan")}]}, r"= nan MW is outside"),
    *(
        ({"name": "x", "wind_speed": [[9.0]], "events": [{"time_s": 1.0, **event}]}, message)
        for event, message in (
            ({"kind": "group_trip", "group": -1}, r"group must be the index of a WTG group \(0 or more\), got -1"),
            ({"kind": "group_trip", "group": 1.0}, r"index of a WTG group \(0 or more\), got 1.0"),
            ({"kind": "group_trip", "group": True}, r"index of a WTG group \(0 or more\), got True"),
            ({"kind": "group_trip", "bus": 2}, r"unexpected keyword argument 'bus'"),
            ({"kind": "group_trip", "group": 0, "time_s": -1.0}, r"event time = -1 s is outside"),
            ({"kind": "governor_loss", "bus": "1"}, r"bus must be a bus number .* got '1'"),
            ({"kind": "machine_outage", "bus": 0}, r"bus must be a bus number .* got 0"),
            ({"kind": "machine_outage"}, r"missing 1 required keyword-only argument: 'bus'"),
        )
    ),
    *(
        (
            {
                "name": "x",
                "wind_speed": [[9.0]],
                "events": [
                    {"kind": "line_trip", "time_s": 1.0, "from_bus": 1, "to_bus": 2, "recloses_after_s": after_s}
                ],
            },
            message,
        )
        for after_s, message in (
            (-0.5, r"recloses_after_s = -0.5 s is outside the allowed range 0.001 … 86400 s"),
            (0.0, r"recloses_after_s = 0 s is outside"),
            (float("nan"), r"recloses_after_s = nan s is outside"),
            ("soon", r"recloses_after_s must be a number in .* got 'soon'"),
        )
    ),
    (
        {"name": "x", "wind_speed": [[9.0]], "events": [{**STEP, "kind": "load_ramp", "duration_s": 0.0}]},
        r"ramp duration = 0 s is outside",
    ),
]


@pytest.mark.parametrize(("data", "message"), DESCRIPTIONS)
def test_broken_descriptions_are_named(data: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenario.from_dict(data)


def test_numbers_of_numpy_become_python_s_own() -> None:
    events = (LoadStep(time_s=np.float32(1.0), bus=np.int64(3), power_mw=np.float64(5.0)),)
    scenario = Scenario(name="x", wind_speed=[[8.0]], events=events, seed=np.int64(3), load_level=np.float32(1.0))
    assert Scenario.from_json(scenario.to_json()).to_dict() == scenario.to_dict()


def test_an_event_whose_kind_is_no_text_is_refused() -> None:
    data = {"name": "x", "wind_speed": [[8.0]], "events": [{"kind": ["x"]}]}
    with pytest.raises(ValueError, match=r"an event needs a kind out of load_step"):
        Scenario.from_dict(data)
