"""The first use compiles and says so; `wtg-gym warmup` does it beforehand; damaged machine code heals."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.cli.calls import ROOT, call
from wtg_gym.cli import main
from wtg_gym.physics.compiled import cache_folder

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


def test_a_command_over_damaged_machine_code_gives_the_same_and_mends_it(tmp_path: Path) -> None:
    intact = call("simulate", "--duration", "3")
    folder = cache_folder()
    assert intact.returncode == 0 and folder is not None
    own = tmp_path / "wtg_gym" / folder.name
    shutil.copytree(folder, own)
    # Those that step, one for each number of groups, get the bytes of another function; the others lose some.
    steps, others = (list(own.glob(f"physics.{name}-*")) for name in ("integration.advance_blocks", "aerodynamics.*"))
    for path in steps:
        path.write_bytes(others[0].read_bytes())
    for path in others:
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])
    damaged = {path: path.read_bytes() for path in steps}
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8", "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-m", "wtg_gym.cli", "simulate", "--duration", "3"]
    done = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", timeout=600)
    assert (done.returncode, done.stdout) == (0, intact.stdout)
    assert "Traceback" not in done.stderr
    assert sum(path.read_bytes() != content for path, content in damaged.items()) == 1
