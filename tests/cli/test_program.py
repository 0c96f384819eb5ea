"""The program as a whole: help, errors, pipes, interruptions."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import wtg_gym
import wtg_gym.cli
import wtg_gym.cli.simulate
from tests.cli.calls import ROOT, call, start
from tests.interruption import interrupted
from wtg_gym.cli import build_app, main
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.scenarios import get_suite

_QUICK = ("--duration", "6")


def test_program_runs_as_a_module_and_prints_only_json_on_stdout(tmp_path: Path) -> None:
    done = call("simulate", *_QUICK, "--json", "--csv", "traces.csv", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["runs"][0]["strategy"] == "coordinated-piecewise"
    # A first call that has to compile reports its progress before that.
    assert done.stderr.endswith("wrote traces.csv\n")


@pytest.mark.skipif(sys.platform == "win32", reason="pipes break in another way there")
def test_reader_that_leaves_early_is_no_error() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "wtg_gym.cli", "suites", "standard", "--seed", "20003", "--json"]
    done = subprocess.run(command, env=environment, stdout=writing, stderr=subprocess.PIPE, timeout=300)
    os.close(writing)
    assert done.returncode == 141
    assert done.stderr == b""


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals there")
def test_terminal_gets_a_progress_bar() -> None:
    import pty

    own, theirs = pty.openpty()
    process = start("evaluate", "--entries", "mppt", "--suite", "paper", stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    shown = b""
    # At the end of the output Linux raises, others return nothing.
    with contextlib.suppress(OSError):
        while chunk := os.read(own, 4096):
            shown += chunk
    os.close(own)
    assert process.wait(timeout=100) == 0
    text = shown.decode()
    assert "Traceback" not in text
    assert "coordinated-piecewise" in text
    assert "━" in text


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"wtg-gym {wtg_gym.__version__}\n"


def _help(capsys: pytest.CaptureFixture[str], *command: str) -> str:
    assert main([*command, "--help"]) == 0
    return capsys.readouterr().out


def test_help_of_every_command_teaches_by_examples_that_it_takes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)
    for name in ("my-policy", "my-policy-*"):
        (tmp_path / name).mkdir()
    names = [name for name in build_app([]) if not name.startswith("-")]
    assert len(names) == 9
    for name in names:
        own = [part for part in build_app([name])[name] if not part.startswith("-")]
        for command in [(name, part) for part in own] or [(name,)]:
            text = _help(capsys, *command)
            lines = re.findall(rf"^  (?:\w+=\S+ )?wtg-gym ({' '.join(command)}.*)$", text, re.MULTILINE)
            assert lines, command
            for line in lines:
                words = shlex.split(re.split(r"  +|>", line)[0])
                build_app(words).parse_args(words, exit_on_error=False, print_error=False)


def test_help_is_there_before_the_simulator() -> None:
    """And any other command needs its own packages alone: importing all of them takes a second or two."""
    code = "import sys; from wtg_gym.cli import main\nmain(['--help'])\n"
    code += "print({'numba', 'scipy'} & set(sys.modules))\nmain(['suites', 'paper'])\n"
    code += "print('wtg_gym.cli.simulate' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=100)
    lines = done.stdout.splitlines()
    assert "set()" in lines and lines[-1] == "False", done.stderr


def test_interrupt_exits_with_130(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wtg_gym.cli.simulate, "simulate", interrupted(wtg_gym.cli.simulate.simulate))
    assert main(["simulate", *_QUICK]) == 130
    assert "wtg-gym: interrupted" in capsys.readouterr().err


# --- what a terminal gets --------------------------------------------------------------------------------------------

#: Colours, the title of a window, C1 controls, a changed direction, a line of its own, half a surrogate pair.
NASTY = "a\x1b[31mred\x1b]0;title\x07\x9b2J\x7f\u202eabc\u2066\r\nwtg-gym: all is well\ud800\u2028z"


def _is_harmless(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


def test_lines_tables_notes_and_json_show_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    say(NASTY)
    note(NASTY)
    print_table((NASTY, "b"), [(NASTY, "1")])
    said = capsys.readouterr()
    assert _is_harmless(said.out) and _is_harmless(said.err)
    assert (said.out.count("\n"), said.err.count("\n")) == (4, 1)
    assert r"a\x1b[31mred" in said.err and r"\u202eabc" in said.out
    data = {NASTY: [NASTY, "grün 🜁", {"x": 1.5}]}
    print_json(data)
    out = capsys.readouterr().out
    assert _is_harmless(out) and "grün 🜁" in out and json.loads(out) == data


def test_the_name_of_a_scenario_is_shown_with_escapes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scenario.json"
    scenario = dataclasses.replace(get_suite("paper").scenario(0), name=NASTY, duration_s=1.0)
    path.write_text(scenario.to_json())
    assert main(["simulate", "--scenario", str(path)]) == 0
    said = capsys.readouterr()
    assert _is_harmless(said.out) and _is_harmless(said.err)
    assert r"\x1b[31mred" in said.out


def test_no_command_prints_past_the_one_place_that_escapes() -> None:
    for path in Path(wtg_gym.cli.__file__).parent.glob("*.py"):
        calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        printing = [call for call in calls if isinstance(call, ast.Name) and call.id == "print"]
        assert not printing or path.name in ("output.py", "__init__.py"), path
