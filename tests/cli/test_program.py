"""The program as a whole: help, errors, pipes, interruptions."""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import wtg_gym
import wtg_gym.cli.simulate
from tests.cli.calls import ROOT, call, error_of, start
from tests.interruption import interrupted
from wtg_gym.cli import main

COMMANDS = (
    "simulate",
    "play",
    "evaluate",
    "leaderboard",
    "results",
    "submission",
    "suites",
    "reproduce",
    "warmup",
)
OWN = {
    "results": ("page", "recompute", "gap", "matrix", "front"),
    "submission": ("new", "check", "score"),
}
_QUICK = ("--duration", "6")


def test_program_runs_as_a_module_and_prints_only_json_on_stdout(tmp_path: Path) -> None:
    done = call("simulate", *_QUICK, "--json", "--csv", "traces.csv", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["runs"][0]["strategy"] == "coordinated-piecewise"
    # A first call that has to compile reports its progress before that.
    assert done.stderr.endswith("wrote traces.csv\n")


def test_bad_input_is_one_line_without_a_traceback(tmp_path: Path) -> None:
    done = call("simulate", "--wind", "-3", "--plot", "run.png", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "-3 m/s, outside the allowed range 3 … 25 m/s" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


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
    pytest.importorskip("rich")
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
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"wtg-gym {wtg_gym.__version__}\n"


def _help(capsys: pytest.CaptureFixture[str], *command: str) -> str:
    with pytest.raises(SystemExit) as end:
        main([*command, "--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


def test_help_of_every_command_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    for name in COMMANDS:
        for command in [(name, own) for own in OWN.get(name, ())] or [(name,)]:
            assert f"examples:\n  wtg-gym {' '.join(command)}" in _help(capsys, *command)


def test_help_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    text = _help(capsys)
    assert re.findall(r"^    (\w+)", text[: text.index("first steps")], re.MULTILINE) == list(COMMANDS)
    for name, own in OWN.items():
        assert re.findall(r"^    (\w+)", _help(capsys, name), re.MULTILINE) == list(own)


def test_help_is_there_before_the_simulator() -> None:
    """And any other command needs its own packages alone: importing all of them takes a second or two."""
    code = "import sys, wtg_gym.cli as cli\ncli.build_parser([]).format_help()\n"
    code += "print({'numba', 'scipy'} & set(sys.modules))\n"
    code += "cli.build_parser(['suites'])\nprint('wtg_gym.cli.simulate' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=100)
    assert done.stdout == "set()\nFalse\n", done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "required: COMMAND"),
        (("fly",), "invalid choice: 'fly'"),
        (("simulate", "--wnd", "8"), "--wnd"),
        (("simulate", "--case", "load-increase", "--suite", "paper"), "not allowed with argument --case"),
        (("simulate", "--wind", "strong"), "invalid float value: 'strong'"),
    ],
)
def test_wrong_usage_points_to_the_help(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    line = error_of(capsys, *arguments)
    assert said in line
    assert "--help" in line


def test_interrupt_exits_with_130_and_says_what_is_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wtg_gym.cli.simulate, "simulate", interrupted(wtg_gym.cli.simulate.simulate))
    assert main(["simulate", *_QUICK]) == 130
    assert "wtg-gym: interrupted; nothing was written" in capsys.readouterr().err
