"""Episodes: one row per entry and scenario, and the table of them as CSV."""

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wtg_gym.envs.batch import TERMINATION_REASONS
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.ranges import require_count

#: Columns before the metrics: which entry, which scenario, how long it should last [s], why it failed ("": it did not).
COLUMNS = ("entry", "training_seed", "seed", "scenario", "duration_s", "failure", *METRICS)
#: Rows of a table at most, and those of all training seeds of one entry, whose bootstrap takes 16 kB for each.
MOST_ROWS, MOST_ROWS_OF_ENTRY = 100_000, 30_000
#: Largest number of a table; what is added up of it stays finite.
_LARGEST = 1e12
FAILURES = tuple(TERMINATION_REASONS.values())


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One entry in one scenario."""

    entry: str  # its name
    training_seed: int | None  # its training seed, if it has one
    seed: int  # of the scenario in its suite
    scenario: str  # its name
    duration_s: float  # how long it should last [s]
    failure: str  # why it ended before its time; empty where it did not
    metrics: Mapping[str, float | None]  # every metric by its name in :data:`METRICS`; None where it has none

    @property
    def failed(self) -> bool:
        """Return whether it ended before its time."""
        return self.failure != ""

    @property
    def run(self) -> tuple[str, int | None]:
        """Return which entry and training seed it belongs to."""
        return self.entry, self.training_seed

    def cells(self) -> list[str]:
        """Return the row of the table, in the order of :data:`COLUMNS`; numbers in full precision."""
        training = "" if self.training_seed is None else str(self.training_seed)
        leading = [self.entry, training, str(self.seed), self.scenario, repr(float(self.duration_s)), self.failure]
        return leading + ["" if (value := self.metrics[name]) is None else repr(float(value)) for name in METRICS]


def check_size(names: Iterable[str], n_scenarios: int) -> None:
    """Raise a ValueError if the table of runs, by the names of their entries, would have too many rows."""
    runs = Counter(names)
    require_count("the table of the results", runs.total() * n_scenarios, MOST_ROWS)
    for name, n_runs in runs.items():
        require_count(f"the part of entry {name!r} of the table", n_runs * n_scenarios, MOST_ROWS_OF_ENTRY)


def to_csv(episodes: Sequence[Episode]) -> str:
    """Return the episodes as CSV with a header and line feeds."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(episode.cells() for episode in episodes)
    return buffer.getvalue()


def from_csv(text: str, path: Path) -> list[Episode]:
    """Return the episodes of a table that :func:`to_csv` wrote; a ValueError names file, line and column."""
    try:
        rows = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise ValueError(f"the episodes in {path} are not CSV: {error}") from error
    header = rows[0] if rows else []
    if tuple(header) != COLUMNS:
        raise ValueError(f"the header of {path} must be {', '.join(COLUMNS)}, as of this version; got {header!r:.500}")
    return [episode_from_cells(cells, f"{path}, line {line}") for line, cells in enumerate(rows[1:], start=2)]


def episode_from_cells(cells: Sequence[str], where: str) -> Episode:
    """Return the episode of a row, see :meth:`Episode.cells`; a ValueError names `where` and the column."""
    if len(cells) != len(COLUMNS):
        raise ValueError(f"{where}: expected {len(COLUMNS)} values, got {len(cells)}")
    row = dict(zip(COLUMNS, cells, strict=True))

    def whole(column: str) -> int:
        if not (row[column].isascii() and row[column].isdigit()):
            raise ValueError(f"{where}: {column} must be a whole number from 0 on, got {row[column]!r:.80}")
        return int(row[column])

    def number(column: str, unit: str) -> float:
        try:
            value = float(row[column])
        except ValueError:
            value = math.nan
        if not abs(value) <= _LARGEST:
            allowed = f"a number in -{_LARGEST:g} … {_LARGEST:g} [{unit}]"
            raise ValueError(f"{where}: {column} must be {allowed}, got {row[column]!r:.80}")
        return value

    if (failure := row["failure"]) not in FAILURES:
        raise ValueError(f"{where}: failure must be empty or one of {', '.join(FAILURES[1:])}, got {failure!r:.80}")
    return Episode(
        entry=row["entry"],
        training_seed=None if row["training_seed"] == "" else whole("training_seed"),
        seed=whole("seed"),
        scenario=row["scenario"],
        duration_s=number("duration_s", "s"),
        failure=failure,
        metrics={
            name: None if metric.optional and row[name] == "" else number(name, metric.unit)
            for name, metric in METRICS.items()
        },
    )
