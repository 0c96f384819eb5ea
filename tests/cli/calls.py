"""Calls of the command line, in the test's own process and in one of its own."""

import json
from pathlib import Path

import pytest

from wtg_gym.cli import main

ROOT = Path(__file__).resolve().parents[2]


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line of an error, once the exit code and the silence of stdout are checked."""
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = printed.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("wtg-gym: error: ")
    return lines[0]


def json_of(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0):
    assert main(arguments) == code
    return json.loads(capsys.readouterr().out)
