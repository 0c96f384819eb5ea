"""Scenarios that the twin has to play as the environment does: events of every kind, limits, early ends."""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.envs.lanes import TaskLanes
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


def _given(name: str, *events: Any, wind: Any = 9.0) -> Scenario:
    series = np.full((2, 1), wind) if np.isscalar(wind) else np.tile(wind, (2, 1))
    return Scenario(name=name, wind_speed=series, events=events, load_noise_bus=3)


def cases(lanes: TaskLanes) -> dict[str, Scenario]:
    """Return scenarios by name."""
    plant, time = lanes.simulator.settings, np.arange(0.0, 61.0, 0.1)
    governed = next(machine.bus for machine in plant.case.machines if machine.governor is not None)
    step = LoadStep(time_s=0.525, bus=4, power_mw=15.0)
    given = [
        _given("far too much load", LoadStep(time_s=1.0, bus=4, power_mw=600.0)),
        _given("lost governor", step, GovernorLoss(time_s=2.35, bus=governed)),
        _given("far too little load", LoadStep(time_s=1.0, bus=4, power_mw=-300.0)),
        _given("outage at the start", MachineOutage(time_s=0.0, bus=3), LoadTrip(time_s=20.0, bus=9)),
        _given("lost group", step, GroupTrip(time_s=7.05, group=0)),
        _given("lost line", step, LineTrip(time_s=1.075, from_bus=4, to_bus=5, recloses_after_s=0.225)),
        _given("ramp", LoadRamp(time_s=2.025, bus=9, power_mw=20.0, duration_s=5.1)),
        _given("gusts", step, wind=10.0 + 5.0 * np.sin(0.5 * time)),
    ]
    drawn = lanes.scenarios(list(lanes.suite.seeds("validation")[:4]))
    return {scenario.name: scenario for scenario in [*given, *drawn]}
