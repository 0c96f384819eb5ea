"""`wtg-gym compare` as a user calls it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.cli.calls import error_of, json_of
from tests.golden_cases import GOLDEN
from wtg_gym.cli import main

PARAMS = str(GOLDEN / "genrou" / "params.json")
TRACE = str(GOLDEN / "genrou" / "a.csv")


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the parameters and the first ten of sixty seconds of each trace, with the event at 5 s."""
    folder = tmp_path_factory.mktemp("short") / "genrou"
    folder.mkdir()
    shutil.copy(PARAMS, folder)
    for name in ("a.csv", "b.csv"):
        head, *rows = (GOLDEN / "genrou" / name).read_text().splitlines()
        (folder / name).write_text("\n".join([head, *(row for row in rows if float(row.split(",")[0]) <= 10.0)]))
    return folder


def test_agreement_is_exit_code_0_and_a_table(capsys: pytest.CaptureFixture[str], short: Path) -> None:
    assert main(["compare", PARAMS, str(short / "a.csv")]) == 0
    said = capsys.readouterr().out
    assert "14 buses, 6 machines, 2 events" in said
    rows = [line for line in said.splitlines() if line.endswith("agrees")]
    assert [row.split("  ")[0] for row in rows] == ["machine speed", "active power", "bus voltage"]


def test_json_has_every_quantity(capsys: pytest.CaptureFixture[str]) -> None:
    data = json_of(capsys, "compare", PARAMS, TRACE, "--json")
    assert data["agrees"] is True
    # The step is halved until its own error does not matter.
    assert data["step_s"] == 0.00125 and data["default_step_s"] == 0.025
    assert [event["time_s"] for event in data["events"]] == [5.0, 30.0]
    found = {row["quantity"]: row for row in data["differences"]}
    assert found["w"]["largest"] < found["w"]["tolerance"] == 2e-7
    assert found["w"]["largest"] < found["w"]["largest_at_default_step"] < 1e-6


def test_disagreement_is_exit_code_1(capsys: pytest.CaptureFixture[str], short: Path) -> None:
    # The trace is of the other events.
    trace = str(short / "a.csv")
    assert main(["compare", PARAMS, trace, "--events", "b"]) == 1
    assert "DIFFERS" in capsys.readouterr().out
    data = json_of(capsys, "compare", PARAMS, trace, "--events", "b", "--json", code=1)
    assert not any(row["agrees"] for row in data["differences"])


def test_folder_stands_for_all_its_traces(capsys: pytest.CaptureFixture[str], short: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Page\n<!-- golden:start -->\n<!-- golden:end -->\n", encoding="utf-8")
    data = json_of(capsys, "compare", str(short), "--json", "--page", str(page))
    assert [Path(result["trace"]).name for result in data] == ["a.csv", "b.csv"]
    text = page.read_text(encoding="utf-8")
    assert text.count("| genrou | ") == 2 and "2 of 2 traces agree." in text


def test_unknown_columns_are_said_and_left_out(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "trace_a.csv"
    path.write_text("t,w1,temperature\n0,1,20\n0.5,1,21\n", encoding="utf-8")
    assert main(["compare", PARAMS, str(path)]) == 0
    said = capsys.readouterr()
    assert "columns that are not compared: temperature" in said.err
    assert "machine speed" in said.out and "bus voltage" not in said.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((PARAMS,), "give a trace (.csv) to compare with"),
        ((TRACE,), "give the parameter file (.json) before its traces"),
        (("nowhere.json", TRACE), "cannot read the parameter file nowhere.json: No such file"),
        ((PARAMS, "nowhere_a.csv"), "cannot read the trace nowhere_a.csv: No such file"),
        ((PARAMS, TRACE, "--events", "c"), "unknown event list 'c'; the parameter file has: a, b"),
        ((PARAMS, TRACE, "--page", "nowhere.md"), "--page: cannot read the file with the markers nowhere.md"),
        ((str(GOLDEN),), "must hold params.json and at least one trace"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in error_of(capsys, "compare", *arguments)


def test_trace_whose_events_are_unclear_is_asked_for(
    capsys: pytest.CaptureFixture[str], short: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "trace.csv"
    shutil.copy(short / "a.csv", copy)
    assert "which events does trace.csv show?" in error_of(capsys, "compare", PARAMS, str(copy))
    assert main(["compare", PARAMS, str(copy), "--events", "a"]) == 0
