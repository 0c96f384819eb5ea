"""Ranges and sources of parameters, and groups that share the paper's plant."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.checked import Checked
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import default_groups
from wtg_gym.physics.sources import SOURCES

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


# Record, field, wrong value, and what the message says of it.
BAD: list[tuple[str, str, Any, str]] = [
    ("GridFormingParameters", "inertia_constant_s", -5.0, r"= -5 s is outside the allowed range 0.001 … 10000 s"),
    ("GridFormingParameters", "inertia_constant_s", 0.0, r"= 0 s is outside"),
    ("GridFormingParameters", "droop_gain_pu", "62", r"must be a number in 0 … 100000 p.u./p.u., got '62'"),
    ("GridFormingParameters", "droop_gain_pu", -62.5, r"= -62.5 p.u./p.u. is outside"),
    ("GridFormingParameters", "droop_gain_pu", math.nan, r"= nan p.u./p.u. is outside"),
    ("GridFormingParameters", "reactance_pu", -0.55, r"= -0.55 p.u. is outside"),
    ("GridFormingParameters", "reactance_pu", 0.0, r"= 0 p.u. is outside"),
    ("GridFormingParameters", "deloading_limit", 0.95, r"= 0.95 is outside the allowed range 0 … 0.9"),
    (
        "GridFormingParameters",
        "frequency_min_pu",
        1.004,
        r"< frequency_setpoint_pu < .* hold, got 1.004, 1, 1.008",
    ),
    ("GridFormingParameters", "frequency_min_pu", 1.0, r"must hold, got 1, 1, 1.008"),
    ("TurbineParameters", "inertia_constant_s", -6.5, r"= -6.5 s is outside"),
    ("TurbineParameters", "rated_power_mw", 0.0, r"= 0 MW is outside"),
    ("TurbineParameters", "conserves_energy", "no", r"must be bool, got 'no'"),
    ("TurbineParameters", "power_coefficient", None, r"must be PowerCoefficientParameters \| RotorTable, got None"),
    ("PitchParameters", "actuator_time_s", 0.0, r"= 0 s is outside"),
    ("ProtectionParameters", "low_voltage_pu", math.nan, r"= nan p.u. is outside"),
    ("ProtectionParameters", "frequency_max_pu", 0.95, r"= 0.95 p.u. is outside the allowed range 1 … 10 p.u."),
    ("ProtectionParameters", "rotor_speed_min_pu", 1.5, r"= 1.5 p.u. is outside the allowed range 0 … 1 p.u."),
    ("ConverterLimitParameters", "power_max_pu", 1.3, r"= 1.3 p.u. exceeds current_max_pu = 1.2 p.u."),
    ("ConverterLimitParameters", "power_min_pu", 0.1, r"= 0.1 p.u. is outside the allowed range -10 … 0 p.u."),
    ("VoltageControlParameters", "integral_gain", 0.0, r"= 0 p.u./\(p.u. s\) is outside"),
    ("SheddingStage", "share", 1.5, r"= 1.5 is outside the allowed range 0 … 1"),
    ("WtgGroup", "n_turbines", 0.0, r"= 0 is outside the allowed range 0.001 … 10000"),
    ("WtgGroup", "bus", 2.0, r"must be a bus number of the network .* got 2.0"),
    ("GovernorParameters", "droop_pu", -0.02, r"= -0.02 p.u. is outside"),
    ("GovernorParameters", "gate_time_s", 0.0, r"= 0 s is outside"),
    ("GovernorParameters", "reheat_time_s", 0.0, r"= 0 s is outside"),
    ("GovernorParameters", "gate_min_pu", 1.3, r"< gate_max_pu must hold, got 1.3, 1.2"),
    ("HydroGovernorParameters", "water_time_s", 0.0, r"= 0 s is outside"),
    ("ExciterParameters", "gain", -100.0, r"= -100 p.u./p.u. is outside"),
    ("SynchronousMachineParameters", "rating_mva", 0.0, r"= 0 MVA is outside"),
    ("SynchronousMachineParameters", "two_h_s", -10.0, r"= -10 s is outside"),
    ("SynchronousMachineParameters", "t_d0_transient_s", -7.4, r"= -7.4 s is outside"),
    ("SynchronousMachineParameters", "x_d_transient", 0.0, r"= 0 p.u. is outside"),
    ("SynchronousMachineParameters", "governor", 0.02, r"must be GovernorParameters .* None, got 0.02"),
    ("Bus", "voltage_pu", 0.0, r"= 0 p.u. is outside the allowed range 0.1 … 10 p.u."),
    ("Bus", "load_mw", math.nan, r"= nan MW is outside"),
    ("Bus", "number", 14.0, r"must be a bus number of the network .* got 14.0"),
    ("Branch", "tap", 0.0, r"= 0 is outside the allowed range 0.01 … 100"),
    ("Branch", "reactance", math.nan, r"= nan p.u. is outside"),
]


@pytest.mark.parametrize(("record", "field", "value", "message"), BAD)
def test_a_parameter_out_of_range_is_named_with_value_unit_and_range(
    record: str, field: str, value: Any, message: str
) -> None:
    good = next(found for found in RECORDS if type(found).__name__ == record)
    with pytest.raises(ValueError, match=rf"{record}.*{field}.*{message}|{field} {message}"):
        dataclasses.replace(good, **{field: value})


def test_every_number_of_every_record_has_a_range() -> None:
    for record in RECORDS:
        for field in dataclasses.fields(record):
            if field.type in ("float", "float | None"):
                low, high = field.metadata["low"], field.metadata["high"]
                assert math.isfinite(low) and math.isfinite(high) and low < high, (record, field.name)
                with pytest.raises(ValueError, match=rf"{type(record).__name__}.{field.name} = inf"):
                    dataclasses.replace(record, **{field.name: math.inf})


@pytest.mark.parametrize("n_groups", [1, 2, 20])
def test_default_groups_share_the_papers_hundred_megawatt(n_groups: int) -> None:
    groups = default_groups(n_groups)
    assert len(groups) == n_groups
    assert sum(group.n_turbines for group in groups) * 5.0 == pytest.approx(100.0)


@pytest.mark.parametrize("n_groups", [0, -1, 2.0, True, "2", 1025])
def test_impossible_numbers_of_groups_are_refused(n_groups: object) -> None:
    with pytest.raises(ValueError, match="must be 1 … 1024"):
        default_groups(n_groups)  # type: ignore[arg-type]
