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


def test_numbers_of_numpy_become_python_s_own() -> None:
    events = (LoadStep(time_s=np.float32(1.0), bus=np.int64(3), power_mw=np.float64(5.0)),)
    scenario = Scenario(name="x", wind_speed=[[8.0]], events=events, seed=np.int64(3), load_level=np.float32(1.0))
    assert Scenario.from_json(scenario.to_json()).to_dict() == scenario.to_dict()
