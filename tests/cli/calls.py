"""Calls of the command line, in the test's own process and in one of its own."""

import json
from pathlib import Path

import pytest

from wtg_gym.cli import main

ROOT = Path(__file__).resolve().parents[2]


def printed_by(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0):
    """What a command writes to `out` and `err`, once its exit code is checked."""
    assert main(arguments) == code
    return capsys.readouterr()


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line of an error, once the exit code and the silence of stdout are checked."""
    printed = printed_by(capsys, *arguments, code=2)
    (line,) = printed.err.splitlines()
    assert printed.out == "" and line.startswith("wtg-gym: error: ")
    return line


def json_of(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0):
    return json.loads(printed_by(capsys, *arguments, code=code).out)
