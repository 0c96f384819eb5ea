"""Learning curves of runs, and the small CSV file that keeps them when the runs' folders are gone."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from agents.runs import Run
from wtg_gym.files import read_text
from wtg_gym.plotting import LearningCurve


@dataclass(frozen=True, kw_only=True, order=True)
class Validation:
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
    seen: dict[tuple[str, str, str, str, int], Path] = {}
    for folder in folders:
        run = Run.read(folder)
        s = run.settings
        key = s.algo, s.action_mode, s.observation_mode, s.suite, s.seed
        if key in seen:
            raise ValueError(f"the runs {seen[key]} and {folder} are both of {', '.join(map(str, key))}; give one")
        if not run.curve:
            raise ValueError(f"{folder} has no validation yet")
        seen[key] = folder
        for row in run.curve:
            rows.append(
                Validation(
                    algo=s.algo,
                    action_mode=s.action_mode,
                    observation_mode=s.observation_mode,
                    suite=s.suite,
                    seed=s.seed,
                    timesteps=int(row["timesteps"]),
                    # Digits that say nothing only make the file larger.
                    wall_time_s=round(row["wall_time_s"], 1),
                    score=round(row["score"], 3),
                    cost=round(row["cost"], 4),
                    failures_percent=round(row["failures_percent"], 2),
                )
            )
    return sorted(rows)


def to_csv(rows: Iterable[Validation]) -> str:
    """Return validations as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in fields(Validation)])
    writer.writerows(astuple(row) for row in rows)
    return text.getvalue()


def read_csv(path: Path) -> list[Validation]:
    """Return the validations of a file that :func:`to_csv` wrote.

    Raises:
        ValueError: the file cannot be read, or is none of these.
    """
    lines = list(csv.reader(io.StringIO(read_text(path, "file of learning curves"))))
    names = [field.name for field in fields(Validation)]
    if not lines or lines[0] != names or len(lines) < 2:
        raise ValueError(f"{path} must have the columns {', '.join(names)} and a row per validation")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            texts = dict(zip(names, line, strict=True))
            rows.append(
                Validation(
                    **{name: texts[name] for name in names[:4]},  # type: ignore[arg-type]
                    seed=int(texts["seed"]),
                    timesteps=int(texts["timesteps"]),
                    **{name: float(texts[name]) for name in names[6:]},  # type: ignore[arg-type]
                )
            )
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    return sorted(rows)


def curves_by_setup(rows: Sequence[Validation]) -> dict[str, list[LearningCurve]]:
    """Return one curve per run, by set-up: algorithm and action mode, and what else is not as usual."""
    runs: dict[str, dict[int, list[Validation]]] = {}
    for row in sorted(rows):
        words = [row.algo, row.action_mode]
        words += [row.observation_mode] if row.observation_mode != "local" else []
        words += [row.suite] if row.suite != "standard" else []
        runs.setdefault(", ".join(words), {}).setdefault(row.seed, []).append(row)
    return {name: [_curve(own) for own in seeds.values()] for name, seeds in runs.items()}


def _curve(rows: Sequence[Validation]) -> LearningCurve:
    return LearningCurve(
        timesteps=np.array([float(row.timesteps) for row in rows]),
        wall_time_s=np.array([row.wall_time_s for row in rows]),
        score=np.array([row.score for row in rows]),
    )


__all__ = ["Validation", "curves_by_setup", "read_csv", "read_runs", "to_csv"]
