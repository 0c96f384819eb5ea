"""Whatever is in a file or a name, a terminal gets text and no commands."""

from __future__ import annotations

import ast
import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import pytest

import wtg_gym.cli
from tests.cli.calls import error_of
from wtg_gym import progress as progress_module
from wtg_gym.cli import main
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite

#: Colours, the title of a window, C1 controls, a changed direction, a line of its own, half a surrogate pair.
NASTY = "a\x1b[31mred\x1b]0;title\x07\x9b2J\x7f\u202eabc\u2066\r\nwtg-gym: all is well\ud800\u2028z"


def is_harmless(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


def test_lines_tables_and_notes_show_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    say(NASTY)
    note(NASTY)
    print_table((NASTY, "b"), [(NASTY, "1")])
    said = capsys.readouterr()
    assert is_harmless(said.out) and is_harmless(said.err)
    assert (said.out.count("\n"), said.err.count("\n")) == (4, 1)
    assert r"a\x1b[31mred" in said.err and r"\u202eabc" in said.out


def test_remaining_time_counts_from_the_first_call_since_compiling_comes_before_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter((0.0, 60.0, 70.0, 130.0))
    monkeypatch.setattr(progress_module, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    with Progress("episodes") as progress:
        progress.update("mppt", 10, 80)
        progress.update("mppt", 20, 80)
        progress.update("mppt", 90, 80)
    assert capsys.readouterr().err.splitlines() == [
        "mppt: 10 of 80 episodes",
        "mppt: 20 of 80 episodes, about 60 s left",
        "mppt: 90 of 80 episodes",
    ]


def test_json_shows_escapes_and_means_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    data = {NASTY: [NASTY, "grün 🜁", {"x": 1.5}]}
    print_json(data)
    out = capsys.readouterr().out
    assert is_harmless(out) and "grün 🜁" in out
    assert json.loads(out) == data


def test_no_command_prints_past_the_one_place_that_escapes() -> None:
    for path in Path(wtg_gym.cli.__file__).parent.glob("*.py"):
        calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        printing = [call for call in calls if isinstance(call, ast.Name) and call.id == "print"]
        assert not printing or path.name in ("output.py", "__init__.py"), path


def test_the_name_of_a_scenario_is_shown_with_escapes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scenario.json"
    scenario = dataclasses.replace(get_suite("paper").scenario(0), name=NASTY, duration_s=1.0)
    path.write_text(scenario.to_json())
    assert main(["simulate", "--scenario", str(path)]) == 0
    said = capsys.readouterr()
    assert is_harmless(said.out) and is_harmless(said.err)
    assert r"\x1b[31mred" in said.out


@pytest.mark.parametrize("name", ["no-\x1b[31m-file.json", "no\nfile.json", "no-\u202efile.json"])
def test_names_of_files_in_errors_are_shown_with_escapes(capsys: pytest.CaptureFixture[str], name: str) -> None:
    for arguments in (
        ("simulate", "--scenario", name),
        ("results", "gap", name, name),
        ("evaluate", "--entries", name),
    ):
        assert error_of(capsys, *arguments).isprintable()


def test_an_error_that_quotes_a_whole_file_is_short(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps({"events": "x" * 100_000}))
    assert len(error_of(capsys, "simulate", "--scenario", str(path))) < 2000
