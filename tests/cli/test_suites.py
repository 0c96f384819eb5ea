"""`wtg-gym suites` as a user calls it."""

from __future__ import annotations

import pytest

import wtg_gym
import wtg_gym.cli.scoring
import wtg_gym.cli.simulate
import wtg_gym.cli.suites
from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main
from wtg_gym.scenarios import FROZEN_HASHES, SUITES


def test_suites_lists_every_suite(capsys: pytest.CaptureFixture[str]) -> None:
    listed = json_of(capsys, "suites", "--json")
    assert {suite["name"]: suite["hash"] for suite in listed} == dict(FROZEN_HASHES)
    assert main(["suites"]) == 0
    text = capsys.readouterr().out
    assert all(name in text and FROZEN_HASHES[name][:12] in text for name in SUITES)


def test_suite_is_shown_with_its_splits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["suites", "standard"]) == 0
    text = capsys.readouterr().out
    assert "200 scenarios, seeds 20000 … 20199" in text
    assert "mean_wind_m_s" in text


def test_scenario_is_shown_with_wind_grid_and_events(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["suites", "paper", "--seed", "1"]) == 0
    text = capsys.readouterr().out
    assert "mean wind    11.4, 8 m/s" in text
    assert "5 s: load of bus 4 lost" in text
    assert "inertia 100 %" in text


def test_hash_check_passes_and_fails_by_exit_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["suites", "--check"]) == 0
    assert "DIFFERS" not in capsys.readouterr().out
    monkeypatch.setattr(wtg_gym.cli.suites, "FROZEN_HASHES", {**FROZEN_HASHES, "gust": "0" * 64})
    rows = json_of(capsys, "suites", "--check", "--json", code=1)
    assert [row["name"] for row in rows if not row["agrees"]] == ["gust"]
    assert main(["suites", "--check", "paper"]) == 0


def test_suites_refuses_unknown_names_and_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    assert "unknown suite 'storm'" in error_of(capsys, "suites", "storm")
    assert "seed 5 is in no split" in error_of(capsys, "suites", "standard", "--seed", "5")
    assert "--seed 5 needs a suite" in error_of(capsys, "suites", "--seed", "5")
