"""Learning curves of runs, and the small CSV file that keeps them when the runs' folders are gone."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, get_type_hints

import numpy as np

from agents.runs import Run
from wtg_gym.files import read_text
from wtg_gym.plotting import LearningCurve
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V0


class Validation(NamedTuple):
    """A row of the file: one validation of one run, named as in run.json."""

    algo: str
    action_mode: str
    observation_mode: str
    suite: str
    seed: int
    timesteps: int
    wall_time_s: float
    score: float
    cost: float
    failures_percent: float


def read_runs(folders: Iterable[Path]) -> list[Validation]:
    """Return the validations of the runs in folders, set-up by set-up and seed by seed.

    Raises:
        ValueError: a folder has no run, the run has no validation yet, or two runs are alike in set-up and seed.
    """
    rows: list[Validation] = []
    seen: dict[tuple[str | int, ...], Path] = {}
    for folder in folders:
        run = Run.read(folder)
        s = run.settings
        setup = s.algo, s.action_mode, s.observation_mode, s.suite, s.seed
        if setup in seen:
            raise ValueError(f"the runs {seen[setup]} and {folder} are both of {', '.join(map(str, setup))}; give one")
        if not run.curve:
            raise ValueError(f"{folder} has no validation yet")
        seen[setup] = folder
        for row in run.curve:
            # Digits that say nothing only make the file larger.
            numbers = (("wall_time_s", 1), ("score", 3), ("cost", 4), ("failures_percent", 2))
            rounded = (round(row[key], digits) for key, digits in numbers)
            rows.append(Validation(*setup, int(row["timesteps"]), *rounded))
    return sorted(rows)


def to_csv(rows: Iterable[Validation]) -> str:
    """Return validations as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([Validation._fields, *rows])
    return text.getvalue()


def read_csv(path: Path) -> list[Validation]:
    """Return the validations of a file that :func:`to_csv` wrote.

    Raises:
        ValueError: the file cannot be read, or is none of these.
    """
    types = get_type_hints(Validation)
    lines = list(csv.reader(io.StringIO(read_text(path, "file of learning curves"))))
    if not lines or lines[0] != list(types) or len(lines) < 2:
        raise ValueError(f"{path} must have the columns {', '.join(types)} and a row per validation")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            rows.append(Validation(*(kind(text) for kind, text in zip(types.values(), line, strict=True))))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    return sorted(rows)


def anchors_of(rows: Iterable[Validation]) -> tuple[str, str]:
    """Return the names of the entries that score 0 and 100 in the runs' version of the benchmark.

    Raises:
        ValueError: the runs are of several versions, whose scores cannot be compared.
    """
    found = {get_suite(row.suite).benchmark.anchors: row.suite for row in rows}
    if len(found) > 1:
        raise ValueError(f"runs on {' and '.join(sorted(found.values()))} have different scales: draw them apart")
    return next(iter(found), V0.anchors)


def curves_by_setup(rows: Sequence[Validation]) -> dict[str, list[LearningCurve]]:
    """Return one curve per run, by set-up: algorithm and action mode, and other settings than the usual ones."""
    runs: dict[str, dict[int, list[Validation]]] = {}
    for row in sorted(rows):
        words = [row.algo, row.action_mode]
        words += [row.observation_mode] if row.observation_mode != "local" else []
        words += [row.suite] if row.suite != "standard" else []
        runs.setdefault(", ".join(words), {}).setdefault(row.seed, []).append(row)
    return {
        name: [
            LearningCurve(
                timesteps=np.array([float(row.timesteps) for row in own]),
                wall_time_s=np.array([row.wall_time_s for row in own]),
                score=np.array([row.score for row in own]),
            )
            for own in seeds.values()
        ]
        for name, seeds in runs.items()
    }
