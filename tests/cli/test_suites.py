"""`wtg-gym suites` as a user calls it."""

from __future__ import annotations

import pytest

from tests.cli.calls import json_of
from wtg_gym.cli import main
from wtg_gym.scenarios import FROZEN_HASHES, SUITES


def test_suites_lists_every_suite(capsys: pytest.CaptureFixture[str]) -> None:
    listed = json_of(capsys, "suites", "--json")
    hashes = {suite["name"]: suite["hash"] for suite in listed}
    assert list(hashes) == list(SUITES) and FROZEN_HASHES.items() <= hashes.items()
    assert main(["suites"]) == 0
    text = capsys.readouterr().out
    assert all(name in text and own[:12] in text for name, own in hashes.items())


def test_suite_of_v1_is_shown_with_its_grid_sensors_and_task(capsys: pytest.CaptureFixture[str]) -> None:
    (data,) = json_of(capsys, "suites", "standard-v1")
    assert (data["environment"], data["hash"]) == ("GFMWTG-14bus-v1", SUITES["standard-v1"].hash)
    assert [(group["bus"], group["n_turbines"]) for group in data["plant"]["groups"]] == [
        *((2, 20.0), (3, 14.0), (6, 10.0), (8, 8.0))
    ]
    assert data["sensors"]["delay_s"] == [0.1, 0.3]
    (data,) = json_of(capsys, "suites", "no-wind-sensor-v1", "--json")
    assert data["sensors"]["wind_sensor"] is False and data["plant"]["physics"] == "extended"


def test_scenario_is_shown_with_wind_grid_and_events(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["suites", "paper", "--seed", "1"]) == 0
    text = capsys.readouterr().out
    assert "mean wind    11.4, 8 m/s" in text
    assert "5 s: load of bus 4 lost" in text
    assert "inertia 100 %" in text
