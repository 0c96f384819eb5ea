"""`wtg-gym warmup` compiles all that later commands need."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.cli.calls import ROOT
from wtg_gym.cli import main
from wtg_gym.systems.compiled import cache_folder

_COMMANDS = """
from wtg_gym.cli import main

for arguments in (
    "warmup",
    "simulate --duration 3",
    "evaluate --suite paper --entries mppt",
    "simulate --suite standard-v1 --duration 3",
    "evaluate --suite standard-v1 --scenarios 2 --duration 3 --entries mppt",
):
    assert main(arguments.split()) == 0
"""


def test_after_a_warmup_nothing_is_compiled_and_nothing_said() -> None:
    assert main(["warmup"]) == 0
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-c", _COMMANDS]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, encoding="utf-8", timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"nothing to compile: all machine code is in {cache_folder()}\n")
    assert "compile" not in done.stderr
