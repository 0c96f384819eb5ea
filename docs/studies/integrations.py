"""Run the programs of docs/integrations, each in a virtual environment of its own, which is made in build/integrations.

    python docs/studies/integrations.py [NAME …]

runs all, or those that are named, such as torchrl, for seconds. A program's head names its packages, as PEP 723 has it.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_HEAD = re.compile(r"\A# /// script\n(.*?)^# ///\n", re.MULTILINE | re.DOTALL)
_LIMIT_S = 900


def programs() -> list[Path]:
    """Return the programs."""
    return sorted((ROOT / "docs" / "integrations").glob("with_*"))


def packages_of(program: Path) -> list[str]:
    """Return what a program's head names."""
    head = _HEAD.match(program.read_text(encoding="utf-8"))
    assert head is not None, f"{program} has no head"
    packages: list[str] = tomllib.loads(head[1].replace("# ", ""))["dependencies"]
    return packages


def environment_of(program: Path) -> Path:
    """Return the environment of a program, made anew, with what it needs."""
    environment = ROOT / "build" / "integrations" / program.stem
    venv.create(environment, with_pip=True, clear=True)
    pip = [environment / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--editable", str(ROOT), *packages_of(program)], check=True)
    return environment


def run(program: Path, environment: Path, folder: str) -> None:
    """Run a program in a folder; an error of `subprocess` says why not."""
    variables = {**os.environ, "PATH": f"{environment / 'bin'}:/usr/bin:/bin", "MINARI_DATASETS_PATH": folder}
    command = ["python", str(program)] if program.suffix == ".py" else ["bash", "-eu", str(program)]
    subprocess.run(command, cwd=folder, env=variables, check=True, timeout=_LIMIT_S, stdout=subprocess.DEVNULL)


def runs(names: list[str]) -> int:
    """Run the programs of these names, or all; return 1 if one does not run, else 0."""
    failed = []
    for program in programs():
        if not names or program.stem.removeprefix("with_") in names:
            try:
                with tempfile.TemporaryDirectory() as folder:
                    run(program, environment_of(program), folder)
                print(f"{program.stem}: runs", flush=True)
            except subprocess.SubprocessError as error:
                print(f"{program.stem}: {error}", flush=True)
                failed.append(program.stem)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(runs(sys.argv[1:]))
