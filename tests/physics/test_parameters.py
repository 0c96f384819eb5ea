"""Every parameter has a unit and a source."""

from __future__ import annotations

import dataclasses
import inspect

import pytest

from wtg_gym.physics import parameters
from wtg_gym.physics.parameters import SOURCES, default_groups

CLASSES = [
    cls
    for _, cls in inspect.getmembers(parameters, inspect.isclass)
    if dataclasses.is_dataclass(cls) and cls.__module__ == parameters.__name__
]


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_parameter_has_unit_source_and_description(cls: type) -> None:
    for field in dataclasses.fields(cls):
        assert field.metadata.get("unit"), field.name
        assert field.metadata.get("source") in SOURCES, field.name
        assert field.metadata.get("doc"), field.name


def test_there_are_parameter_classes_to_check() -> None:
    assert len(CLASSES) >= 9


@pytest.mark.parametrize("n_groups", [1, 2, 20])
def test_default_groups_share_the_papers_hundred_megawatt(n_groups: int) -> None:
    groups = default_groups(n_groups)
    assert len(groups) == n_groups
    assert sum(group.n_turbines for group in groups) * 5.0 == pytest.approx(100.0)


@pytest.mark.parametrize("n_groups", [0, -1, 2.0, True, "2", 1025])
def test_impossible_numbers_of_groups_are_refused(n_groups: object) -> None:
    with pytest.raises(ValueError, match="must be 1 … 1024"):
        default_groups(n_groups)  # type: ignore[arg-type]
