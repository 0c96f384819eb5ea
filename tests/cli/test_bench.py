"""`wtg-gym bench` as a user calls it: what it measures, not how fast it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main

QUICK = ("--seconds", "0.01", "--repeats", "1")


def test_every_case_is_measured_against_the_yardstick(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- bench:start -->\n<!-- bench:end -->\n", encoding="utf-8")
    data = json_of(capsys, "bench", *QUICK, "--json", "--page", str(page))
    cases = {case["name"]: case for case in data["cases"]}
    assert cases["Pendulum-v1"]["ratio"] == 1.0
    assert {"GFMWTG-14bus-v0", "GFMWTG-14bus-v0, vector of 1024", "CartPole-v1"} <= set(cases)
    assert {"SB3 adapter of 64", "SB3 DummyVecEnv of 8"} <= set(cases)
    for case in cases.values():
        assert case["steps_per_s"] > 0.0 and len(case["all"]) == 1
        assert case["ratio"] == pytest.approx(case["steps_per_s"] / cases["Pendulum-v1"]["steps_per_s"])
    assert data["machine"] and data["versions"]["numba"]
    text = page.read_text(encoding="utf-8")
    assert text.count("\n| ") == 1 + 1 + len(cases) and data["machine"] in text


def test_table_names_the_machine(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["bench", *QUICK]) == 0
    said = capsys.readouterr().out
    assert "processors, Python 3." in said and "GFMWTG-14bus-v0, vector of 64" in said
    assert "SB3" not in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--seconds", "0"), "--seconds = 0 s is outside the allowed range 0.01 … 600 s"),
        (("--repeats", "0"), "--repeats = 0 is outside the allowed range 1 … 1000"),
        (("--page", "nowhere.md"), "--page: cannot read the file with the markers"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in error_of(capsys, "bench", *arguments)
