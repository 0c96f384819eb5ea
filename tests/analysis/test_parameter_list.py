"""Traceability: every number of the model has a unit and a source, and the page lists all of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from wtg_gym.analysis.parameter_list import parameter_classes, parameter_rows, parameters_page
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.sources import SOURCES

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "parameters.md"


@pytest.mark.parametrize("cls", parameter_classes(), ids=lambda cls: cls.__name__)
def test_every_parameter_has_unit_source_and_description(cls: type) -> None:
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        assert field.metadata.get("unit"), field.name
        assert field.metadata.get("source") in SOURCES, field.name
        assert field.metadata.get("doc"), field.name


def test_coverage_is_complete() -> None:
    """Every field of every parameter object of the default plant is a row, except fields that group others."""
    assert len(parameter_classes()) >= 12
    rows = parameter_rows()
    assert all(all(cell for cell in row) for row in rows)
    assert {row[4] for row in rows} <= set(SOURCES)
    names = {row[1] for row in rows}
    grouping = {"bus", "number", "from_bus", "to_bus", "phase_rad", "classical", "exciter", "power_coefficient"}
    for cls in parameter_classes():
        missing = {field.name for field in dataclasses.fields(cls)} - names - grouping  # type: ignore[arg-type]
        # The 14-bus system has no shunt conductance.
        assert missing <= {"shunt_mw"}, cls
    case = modified_ieee14()
    assert sum(row[0].startswith("branch") and row[1] == "reactance" for row in rows) == len(case.branches)
    assert sum(row[1] == "load_mw" for row in rows) == sum(bus.load_mw != 0.0 for bus in case.buses)


def test_sources_are_all_used() -> None:
    assert {row[4] for row in parameter_rows()} == set(SOURCES)


def test_page_is_up_to_date() -> None:
    assert parameters_page() in _PAGE.read_text(encoding="utf-8")
