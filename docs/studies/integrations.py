"""Run the programs of docs/integrations, each in a virtual environment of its own, which is made in build/integrations.

    python docs/studies/integrations.py [NAME …]

runs them for seconds each, or those that are named.

    python docs/studies/integrations.py --table

trains with PPO of four libraries, ten minutes of a processor core and three seeds each, scores what they learned on
validation scenarios, and puts the table into docs/integrations.md. It takes an hour on two cores.

A program's head names its packages with their versions, as PEP 723 has it.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from wtg_gym.evaluation import evaluate, load_entries, table_cells
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite

ROOT = Path(__file__).resolve().parents[2]
#: Programs that take `SECONDS SEED` and write an entry into a folder of their own name.
LEARNERS = ("stable_baselines3", "cleanrl", "skrl", "rllib")
SECONDS, TRAINING_SEEDS, N_SCENARIOS = 600, range(3), 300
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
    subprocess.run([*pip, "--editable", f"{ROOT}[agents]", *packages_of(program)], check=True)
    return environment


def run(program: Path, environment: Path, folder: str, arguments: tuple[int, ...] = (), limit_s: int = _LIMIT_S) -> str:
    """Run a program in a folder and return how many steps it says it took; an error of `subprocess` says why not."""
    variables = {**os.environ, "PATH": f"{environment / 'bin'}:/usr/bin:/bin", "MINARI_DATASETS_PATH": folder}
    command = ["python", str(program)] if program.suffix == ".py" else ["bash", "-eu", str(program)]
    done = subprocess.run(
        [*command, *map(str, arguments)],
        cwd=folder,
        env=variables,
        check=True,
        timeout=limit_s,
        stdout=subprocess.PIPE,
        encoding="utf-8",
    )
    return next((line for line in done.stdout.splitlines() if line.endswith(" steps")), "")


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


def table(folder: Path) -> str:
    """Train with every learner, and return a row for each, the best first: steps of a run, score and mark."""
    shutil.rmtree(folder, ignore_errors=True)
    by_name = {program.stem.removeprefix("with_"): program for program in programs()}
    environments = {name: environment_of(by_name[name]) for name in LEARNERS}

    def trained(part: tuple[str, int]) -> float:
        name, seed = part
        own = folder / f"{name}-{seed}"
        own.mkdir(parents=True)
        printed = run(by_name[name], environments[name], str(own), (SECONDS, seed), limit_s=6 * SECONDS)
        print(f"{name}, seed {seed}: {printed}", flush=True)
        return int(printed.split()[0]) / 1e6

    parts = list(itertools.product(LEARNERS, TRAINING_SEEDS))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        millions = dict(zip(parts, pool.map(trained, parts), strict=True))
    seeds = list(get_suite(DEFAULT_SUITE).seeds("validation"))[:N_SCENARIOS]
    found = {part: load_entries(folder / f"{part[0]}-{part[1]}" / part[0])[0] for part in parts}
    results = evaluate(list(found.values()), DEFAULT_SUITE, seeds=seeds)
    libraries = {entry.name: name for (name, _), entry in found.items()}
    rows = []
    for row, (score,) in zip(results.ranking, table_cells(results.ranking, ["score"]), strict=True):
        if name := libraries.get(row.name):
            steps = sum(millions[name, seed] for seed in TRAINING_SEEDS) / len(TRAINING_SEEDS)
            label = f"[{row.name.removeprefix('my agent of ')}](integrations/{by_name[name].name})"
            rows.append([label, f"{steps:.1f}", f"{score}{' ✓' if row.marked else ''}"])
    return markdown_table(("library", "million steps", "score"), rows, right=(1, 2))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="for example skrl")
    parser.add_argument("--table", action="store_true", help="train for ten minutes and make the table")
    given = parser.parse_args()
    if given.table and given.names:
        parser.error("--table trains with its own four programs: leave out the names")
    if not given.table:
        sys.exit(runs(given.names))
    made = table(ROOT / "build" / "integrations" / "learned")
    update_between_markers(ROOT / "docs" / "integrations.md", made, "learned")
