"""Records as data: ranges and sources of parameters."""

import dataclasses
import math

import pytest

from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.parameters import SOURCES
from wtg_gym.ranges import Checked

CASE = get_grid("ieee14").case
MACHINE = CASE.machines[0]
RECORDS = [
    kind()
    for kind in (*vars(parameters).values(), *vars(machine_parameters).values())
    if isinstance(kind, type)
    and issubclass(kind, Checked)
    and kind not in (Checked, machine_parameters.SynchronousMachineParameters)
]
RECORDS += [MACHINE, MACHINE.governor, MACHINE.exciter, *CASE.buses[:1], *CASE.branches[:1]]


def test_every_parameter_has_unit_source_and_description_and_every_source_is_used():
    metadata = [field.metadata for record in RECORDS for field in dataclasses.fields(record)]
    assert len(metadata) > 100
    assert all(meta["unit"] and meta["doc"] for meta in metadata)
    assert {meta["source"] for meta in metadata} == set(SOURCES)


def test_every_number_of_every_record_has_a_range():
    for record in RECORDS:
        for field in dataclasses.fields(record):
            if field.type in ("float", "float | None"):
                low, high = field.metadata["low"], field.metadata["high"]
                assert math.isfinite(low) and math.isfinite(high) and low < high, (record, field.name)
                with pytest.raises(ValueError, match=rf"{type(record).__name__}.{field.name} = inf"):
                    dataclasses.replace(record, **{field.name: math.inf})
