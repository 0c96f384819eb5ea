"""`python -m tests.integrations [NAME …]`: runs the programs of docs/integrations, each in an environment of its own.

A program's head names its packages with their versions, as PEP 723 has it.
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

ROOT = Path(__file__).resolve().parent.parent
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


def run(program: Path) -> None:
    """Install what a program needs and run it in an empty folder; an error of `subprocess` says why not."""
    packages = packages_of(program)
    environment = ROOT / "build" / "integrations" / program.stem
    venv.create(environment, with_pip=True)
    pip = [environment / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--editable", f"{ROOT}[agents]", *packages], check=True)
    with tempfile.TemporaryDirectory() as folder:
        variables = {**os.environ, "PATH": f"{environment / 'bin'}:/usr/bin:/bin", "MINARI_DATASETS_PATH": folder}
        command = ["python", str(program)] if program.suffix == ".py" else ["bash", "-eu", str(program)]
        subprocess.run(command, cwd=folder, env=variables, check=True, timeout=_LIMIT_S)


def main(names: list[str]) -> int:
    """Run the programs of these names, or all; return 1 if one does not run, else 0."""
    failed = []
    for program in programs():
        if not names or program.stem.removeprefix("with_") in names:
            try:
                run(program)
                print(f"{program.stem}: runs", flush=True)
            except subprocess.SubprocessError as error:
                print(f"{program.stem}: {error}", flush=True)
                failed.append(program.stem)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
