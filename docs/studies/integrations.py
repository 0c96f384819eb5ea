"""Run the programs of docs/integrations, each in a virtual environment of its own, which is made in build/integrations.

    python docs/studies/integrations.py [NAME …]

runs all, or those that are named, such as torchrl, for seconds. A program's head names its packages, as PEP 723 has it.
"""

import os
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = sorted(ROOT.glob("docs/integrations/with_*"))
_HEAD = re.compile(r"\A# /// script\n(.*?)^# ///\n", re.MULTILINE | re.DOTALL)
_LIMIT_S = 900


def packages_of(program: Path) -> list[str]:
    """Return what a program's head names."""
    head = _HEAD.match(program.read_text(encoding="utf-8"))
    assert head is not None, f"{program} has no head"
    return tomllib.loads(head[1].replace("# ", ""))["dependencies"]


def run(program: Path) -> None:
    """Run a program in a new environment and a folder of its own; an error of `subprocess` says why not."""
    scripts = ROOT / "build" / "integrations" / program.stem / "bin"
    venv.create(scripts.parent, with_pip=True, clear=True)
    pip = [scripts / "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--editable", str(ROOT), *packages_of(program)], check=True)
    command = ["python", str(program)] if program.suffix == ".py" else ["bash", "-eu", str(program)]
    with tempfile.TemporaryDirectory() as folder:
        variables = {**os.environ, "PATH": f"{scripts}:/usr/bin:/bin", "MINARI_DATASETS_PATH": folder}
        subprocess.run(command, cwd=folder, env=variables, check=True, timeout=_LIMIT_S, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    names, failed = sys.argv[1:], False
    for program in (each for each in PROGRAMS if not names or each.stem.removeprefix("with_") in names):
        try:
            run(program)
            print(f"{program.stem}: runs", flush=True)
        except subprocess.SubprocessError as error:
            print(f"{program.stem}: {error}", flush=True)
            failed = True
    sys.exit(int(failed))
