"""`wtg-gym analyse statics` as a user calls it."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main
from wtg_gym.physics.tracking_law import STRATEGIES


def test_table_has_a_row_per_law_and_wind(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", "statics", "--wind", "8", "14", "--points", "2"]) == 0
    said = capsys.readouterr().out
    for name in STRATEGIES:
        assert sum(line.startswith(name + " ") for line in said.splitlines()) == 2
    assert "0.99787 p.u., 49.893 Hz" in said and "never" in said
    # At 14 m/s the pitch protection holds the rotor.
    assert "1.0500, 1.0084*" in said


def test_json_has_critical_frequency_points_and_branches(capsys: pytest.CaptureFixture[str]) -> None:
    data = json_of(
        capsys,
        "analyse",
        "statics",
        "--law",
        "deloaded-5",
        "--wind",
        "8",
        "--frequency",
        "0.996",
        "1",
        "--points",
        "5",
        "--json",
    )
    (entry,) = data["statics"]
    assert entry["critical_frequency_pu"] == pytest.approx(0.99698, abs=5e-6)
    assert entry["critical_frequency_hz"] == pytest.approx(49.849, abs=1e-3)
    assert set(entry["named_points"]) == {"A", "B", "C", "M"}
    counts = [len(row["equilibria"]) for row in entry["characteristic"]]
    assert counts == [0, 2, 2, 2, 2]
    assert [point["stable"] for point in entry["characteristic"][-1]["equilibria"]] == [False, True]
    assert entry["stable_equilibrium_at"]["frequency_min"] is None


def test_law_file_is_one_of_any_laws(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    law = tmp_path / "law.toml"
    law.write_text('name = "mine"\ndeloading_min = 0\ndeloading_nominal = 20\ndeloading_max = 40\n')
    data = json_of(capsys, "analyse", "statics", "--law", str(law), "--wind", "9", "--points", "2", "--json")
    assert data["laws"][0]["damping_time_constant_s"] == "inf"
    assert data["statics"][0]["named_points"]["A"]["power_pu"] == pytest.approx(
        0.8 * data["statics"][0]["available_power_pu"], rel=1e-6
    )


def test_law_without_an_equilibrium_is_told_not_crashed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    law = tmp_path / "greedy.toml"
    law.write_text("k_min = 3\nk_nominal = 3\nk_max = 3\n")
    data = json_of(capsys, "analyse", "statics", "--law", str(law), "--wind", "8", "--points", "2", "--json")
    (entry,) = data["statics"]
    # Above the set-point its droop lets go.
    assert not entry["has_equilibrium_at_setpoint"] and entry["has_equilibrium_from_setpoint_on"]
    assert entry["critical_frequency_pu"] == pytest.approx(1.00005, abs=5e-6)
    law.write_text("k_min = 3\nk_nominal = 3\nk_max = 3\ntau_s = 0.8\n")
    assert main(["analyse", "statics", "--law", str(law), "--wind", "8", "--points", "2"]) == 0
    assert "none from ω_st on" in capsys.readouterr().out


def test_csv_and_plot_are_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table, plot = tmp_path / "c.csv", tmp_path / "c.svg"
    assert main(["analyse", "statics", "--law", "mppt", "--points", "3", "--csv", str(table), "--plot", str(plot)]) == 0
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["wind_m_s"] for row in rows} == {"8", "11.4"}
    assert {"frequency_pu", "rotor_speed_pu", "power_pu", "pitch_deg", "stable"} <= set(rows[0])
    assert plot.read_text(encoding="utf-8").startswith("<?xml")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--law", "best"), "unknown strategy 'best'; known strategies: mppt,"),
        (("--wind", "2"), "--wind = 2 m/s is outside the allowed range 3 … 25 m/s"),
        (("--frequency", "1", "0.9"), "the first value must be the lower one"),
        (("--frequency", "0", "1"), "--frequency = 0 p.u. is outside the allowed range 0.5 … 1.5 p.u."),
        (("--points", "1"), "--points = 1 is outside the allowed range 2 … 100000"),
        (("--plot", "x.png"), "--plot draws one law, 6 are given"),
        (("--plot", "x.jpg"), "unknown kind of file '.jpg'"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in error_of(capsys, "analyse", "statics", *arguments)
