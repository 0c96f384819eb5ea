"""Calls of the command line, in the test's own process and in one of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from wtg_gym.cli import main


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line of an error, once the exit code and the silence of stdout are checked."""
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    lines = said.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("wtg-gym: error: ")
    return lines[0]


def json_of(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> Any:
    """What a command prints as JSON on stdout."""
    assert main(arguments) == code
    return json.loads(capsys.readouterr().out)


ROOT = Path(__file__).resolve().parents[2]


def start(*arguments: str, cwd: Path | None = None, **options: Any) -> subprocess.Popen[str]:
    """Start the command line in a process of its own; `options` are those of Popen."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-m", "wtg_gym.cli", *arguments]
    return subprocess.Popen(command, cwd=cwd, env=environment, encoding="utf-8", **options)
