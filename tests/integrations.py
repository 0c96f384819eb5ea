"""`python -m tests.integrations`: the programs of docs/integrations.md, each run in an environment of its own.

A program's head names its packages with their versions, as PEP 723 has it. The page has a table of what came of each.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from wtg_gym.files import markdown_table, update_between_markers

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "integrations.md"
#: The programs by their names.
PROGRAMS = {path.stem.removeprefix("with_"): path for path in sorted((ROOT / "docs" / "integrations").glob("with_*"))}
#: Libraries that could not be installed beside this package; the command tries it again.
TRIED = {"safety-gymnasium": "safety-gymnasium", "OmniSafe": "omnisafe", "imitation": "imitation"}
_TABLE = "integrations"
_HEAD = re.compile(r"\A# /// script\n(.*?)^# ///\n\n?", re.MULTILINE | re.DOTALL)
_LIMIT_S = 900


def packages(program: Path) -> list[str]:
    """Return the packages that a program's head names."""
    head = _HEAD.match(program.read_text(encoding="utf-8"))
    assert head is not None, f"{program} has no head"
    text = "".join(line.removeprefix("# ") for line in head.group(1).splitlines(keepends=True))
    return list(tomllib.loads(text)["dependencies"])


def name_of(package: str) -> str:
    """Return a package's name, without extras and version."""
    return re.split(r"[\[=<>]", package, maxsplit=1)[0]


def run(name: str, environments: Path) -> tuple[str, str]:
    """Install what a program needs and run it in an empty folder; return the versions, and a verdict."""
    program = PROGRAMS[name]
    named = packages(program)
    python = _environment(environments / name)
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--editable"]
    done = subprocess.run([*install, f"{ROOT}[agents]", *named], capture_output=True, text=True)
    pinned = ", ".join(f"{name_of(each)} {each.partition('==')[2]}".strip() for each in named)
    if done.returncode != 0:
        return pinned, f"cannot be installed: {_last_error(done.stderr)}"
    listed = subprocess.run(
        [python, "-m", "pip", "list", "--format", "json"], capture_output=True, text=True, check=True
    )
    there = {each["name"].lower().replace("_", "-"): each["version"] for each in json.loads(listed.stdout)}
    # The same everywhere, or what is asked for anyway.
    names = [each for each in dict.fromkeys([*map(name_of, named), "gymnasium"]) if each not in ("pandas", "requests")]
    versions = ", ".join(f"{each} {there[each.lower().replace('_', '-')].partition('+')[0]}" for each in names)
    command = [python, str(program)] if program.suffix == ".py" else ["bash", "-eu", str(program)]
    with tempfile.TemporaryDirectory() as folder:
        path = f"{Path(python).parent}:/usr/bin:/bin"
        variables = {"PATH": path, "HOME": str(Path.home()), "MINARI_DATASETS_PATH": folder, "OMP_NUM_THREADS": "1"}
        try:
            done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=_LIMIT_S)
        except subprocess.TimeoutExpired:
            return versions, f"takes more than {_LIMIT_S} s"
    return versions, "runs" if done.returncode == 0 else f"fails: {_last_error(done.stderr)}"


def tried(package: str, environments: Path) -> str:
    """Return whether pip finds a library that fits beside this package."""
    python = _environment(environments / "tried")
    command = [python, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", package]
    done = subprocess.run([*command, "gymnasium>=1.2.2", "torch==2.13.0"], capture_output=True, text=True)
    if done.returncode == 0:
        return "can be installed, not tested"
    conflict = "conflicting dependencies" in done.stderr or "ResolutionImpossible" in done.stderr
    return f"cannot be {'installed beside Gymnasium 1.2.2 or newer' if conflict else 'built where this was run'}"


def _environment(folder: Path) -> str:
    """Return the Python of an environment, which is made if it is not there."""
    if not (folder / "bin" / "python").exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    return str(folder / "bin" / "python")


def _last_error(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no message"


def main() -> int:
    """Run the programs, renew the page and return 1 if one does not run, else 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.integrations", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=list(PROGRAMS), help="run these, and leave the other rows")
    parser.add_argument("--environments", type=Path, default=ROOT / "build" / "integrations", help="folder for them")
    given = parser.parse_args()
    rows = _rows(PAGE)
    for name in given.only or PROGRAMS:
        rows[name] = list(run(name, given.environments))
        print(name, *rows[name], sep=": ", flush=True)
    for name, package in TRIED.items() if given.only is None else ():
        rows[name] = ["the newest", tried(package, given.environments)]
    there = [name for name in (*PROGRAMS, *TRIED) if name in rows]
    links = {name: f"[{name}](integrations/{program.name})" for name, program in PROGRAMS.items()}
    cells = [[links.get(name, name), *rows[name]] for name in there]
    update_between_markers(PAGE, markdown_table(["program", "versions", "verdict"], cells), _TABLE)
    return int(any(rows[name][1] != "runs" for name in given.only or PROGRAMS))


def _rows(page: Path) -> dict[str, list[str]]:
    """Return versions and verdicts in the page's table by the names of programs."""
    text = page.read_text(encoding="utf-8")
    table = text[text.index(f"<!-- {_TABLE}:start -->") : text.index(f"<!-- {_TABLE}:end -->")]
    found = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines() if "|" in line]
    return {re.sub(r"\[(.*)\].*", r"\1", name): cells for name, *cells in found[2:]}


if __name__ == "__main__":
    sys.exit(main())
