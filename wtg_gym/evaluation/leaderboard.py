"""The ranking as rows, and as a Markdown table."""

from __future__ import annotations

from collections.abc import Sequence

from wtg_gym import files
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.summary import EntrySummary

#: Headings of the table, and whether the column holds numbers.
COLUMNS: dict[str, bool] = {
    "rank": True,
    "entry": False,
    "kind": False,
    "score": True,
    "IQM": True,
    "P(improvement)": True,
    "gap closed [%]": True,
    "failures [%]": True,
    "mean cost": True,
    "median nadir [Hz]": True,
    "p95 RoCoF [Hz/s]": True,
    "duty error [%]": True,
    "energy share [%]": True,
}


def leaderboard_rows(results: Results) -> list[EntrySummary]:
    """Return the entries' summaries, the best score first, equal ones by name.

    Raises:
        NoScaleError: there is no score, see :attr:`Results.summaries`.
    """
    return sorted(results.summaries, key=lambda row: (-row.score.value, row.name))


def table_cells(rows: Sequence[EntrySummary]) -> list[list[str]]:
    """Return the texts of the table, one list per row, in the order of :data:`COLUMNS`; equal scores share a rank."""
    scores = [row.score.value for row in rows]
    return [[str(1 + sum(other > row.score.value for other in scores)), *_cells(row)] for row in rows]


def _cells(row: EntrySummary) -> list[str]:
    name = row.name if row.n_runs == 1 else f"{row.name} ({row.n_runs} seeds)"
    return [
        name,
        f"{row.kind}, privileged" if row.privileged else row.kind,
        _interval(row.score),
        f"{_plain(row.interquartile_mean.value, 1)}",
        f"{row.probability_of_improvement.value:.2f}",
        _gap_closed(row),
        f"{row.failures_percent:.1f}",
        f"{row.mean_cost:.1f}",
        f"{row.median_nadir_hz:.3f}",
        f"{row.p95_rocof_hz_s:.3f}",
        f"{row.mean_duty_error_percent:.2f}",
        f"{row.mean_energy_share_percent:.1f}",
    ]


def _plain(value: float, digits: int) -> str:
    # The zero takes the sign off a negative number that rounds to nought.
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _interval(interval: Interval) -> str:
    return f"{_plain(interval.value, 1)} ({_plain(interval.low, 1)} … {_plain(interval.high, 1)})"


def _gap_closed(row: EntrySummary) -> str:
    """The share of the oracle's gap, and of how many scenarios where not all have an oracle."""
    if row.gap_closed_percent is None:
        return ""
    every = row.n_oracle * row.n_runs == row.n_episodes
    return _plain(row.gap_closed_percent.value, 1) + ("" if every else f" (n = {row.n_oracle})")


def markdown_table(rows: Sequence[EntrySummary]) -> str:
    """Return the ranking as a Markdown table without a line feed at the end."""
    numbers = [index for index, is_number in enumerate(COLUMNS.values()) if is_number]
    return files.markdown_table(list(COLUMNS), table_cells(rows), right=numbers)


__all__ = ["COLUMNS", "leaderboard_rows", "markdown_table", "table_cells"]
