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


def test_is_another_for_another_environment() -> None:
    v1 = {"suite": "standard-v1"}
    changes = (
        *(
            {},
            {"suite": "gust"},
            {"suite": "paper"},
            {"weights": {"duty": 2.000001}},
            {"plant": {"simulation_dt": 0.02}},
        ),
        *({"control_dt": 0.2}, {"plant": {"machine_model": "classical"}}, {"duration_s": 9.0}),
        *(v1, {**v1, "sensors": "exact"}, {**v1, "sensors": {"wind_sensor": False}}, {"suite": "low-share-v1"}),
    )
    assert len({fingerprint(**change) for change in changes}) == len(changes)
