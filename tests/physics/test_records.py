"""Records as data: ranges and sources of parameters, and scenarios through JSON."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.checked import Checked
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import SOURCES, default_groups
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

MACHINE = modified_ieee14().machines[0]
RECORDS = [
    kind()
    for kind in (*vars(parameters).values(), *vars(machine_parameters).values())
    if isinstance(kind, type)
    and issubclass(kind, Checked)
    and kind not in (Checked, machine_parameters.SynchronousMachineParameters)
]
RECORDS += [MACHINE, MACHINE.governor, MACHINE.exciter, *modified_ieee14().buses[:1], *modified_ieee14().branches[:1]]


def test_every_parameter_has_unit_source_and_description_and_every_source_is_used() -> None:
    metadata = [field.metadata for record in RECORDS for field in dataclasses.fields(record)]
    assert len(metadata) > 100
    assert all(meta["unit"] and meta["doc"] for meta in metadata)
    assert {meta["source"] for meta in metadata} == set(SOURCES)


def test_every_number_of_every_record_has_a_range() -> None:
    for record in RECORDS:
        for field in dataclasses.fields(record):
            if field.type in ("float", "float | None"):
                low, high = field.metadata["low"], field.metadata["high"]
                assert math.isfinite(low) and math.isfinite(high) and low < high, (record, field.name)
                with pytest.raises(ValueError, match=rf"{type(record).__name__}.{field.name} = inf"):
                    dataclasses.replace(record, **{field.name: math.inf})


def test_default_groups_share_the_papers_hundred_megawatt() -> None:
    for n_groups in (1, 2, 20):
        groups = default_groups(n_groups)
        assert len(groups) == n_groups
        assert sum(group.n_turbines for group in groups) * 5.0 == pytest.approx(100.0)


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
    with pytest.raises(ValueError, match="read-only"):
        scenario.wind_speed[0, 0] = 1.0
    again = Scenario.from_json(scenario.to_json())
    assert again.to_dict() == scenario.to_dict()
    assert again.events == scenario.events
    assert (again.wind_speed == scenario.wind_speed).all()
