"""Facts about the environment's fingerprint: it tells environments apart, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import environment_fingerprint

BASE: dict[str, Any] = {"suite": "standard", "duration_s": 10.0}


def fingerprint(**settings: Any) -> str:
    return environment_fingerprint(EnvSettings(**{**BASE, **settings}))


@pytest.mark.parametrize(
    "change", [{"strategy": "mppt"}, {"action_mode": "k"}, {"observation_mode": "privileged"}, {"split": "validation"}]
)
def test_is_the_same_whatever_an_entry_chooses(change: dict[str, Any]) -> None:
    assert fingerprint(**change) == fingerprint()


@pytest.mark.parametrize(
    "change",
    [
        {"suite": "gust"},
        {"suite": "standard-v1"},
        {"weights": {"duty": 2.000001}},
        {"groups": 1},
        {"groups": 3},
        {"simulation_dt": 0.02},
        {"control_dt": 0.2},
        {"machine_model": "classical"},
        {"duration_s": 9.0},
    ],
)
def test_is_another_for_another_environment(change: dict[str, Any]) -> None:
    assert fingerprint(**change) != fingerprint()


def test_sensors_and_plant_of_v1_count() -> None:
    settings = ({}, {"sensors": "exact"}, {"sensors": {"wind_sensor": False}}, {"suite": "low-share-v1"})
    found = {fingerprint(**{"suite": "standard-v1", **own}) for own in settings}
    assert len(found) == len(settings)


def test_fixed_cases_have_one_too() -> None:
    assert len(fingerprint(suite="paper")) == 64
