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
    assert main(["suites", "standard-v1"]) == 0
    text = capsys.readouterr().out
    assert "GFMWTG-14bus-v1" in text and SUITES["standard-v1"].hash in text
    assert "bus 2, n_turbines 20.0; bus 3, n_turbines 14.0; bus 6, n_turbines 10.0; bus 8, n_turbines 8.0" in text
    assert "generator_mva              250.0" in text and "delay_s                    0.1; 0.3" in text
    (data,) = json_of(capsys, "suites", "no-wind-sensor-v1", "--json")
    assert data["sensors"]["wind_sensor"] is False and data["plant"]["physics"] == "extended"
