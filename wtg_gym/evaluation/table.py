"""The table of results: every column once, for a terminal and for Markdown."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from wtg_gym import files
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.summary import REST, EntrySummary, place

#: What follows the name of an entry that sees the state of the grid, and what a page says about it.
_PRIVILEGED = "privileged"
_PRIVILEGED_NOTE = f"{_PRIVILEGED}: sees the state of the whole grid, which no turbine measures"
#: What :attr:`EntrySummary.marked` is shown by, and what a page says about it.
_MARK = "✓"
_MARK_NOTE = f"{_MARK}: no less reliable than the reference at 100 (blackouts, |Δf| > 0.8 Hz) beyond chance"


def _plain(value: float) -> str:
    # Adding 0.0 turns -0.0 into 0.0.
    return f"{round(value, 1) + 0.0:.1f}"


def _signed(value: float) -> str:
    return f"{value:+.1f}" if round(value, 1) else "0.0"


def _interval(interval: Interval | None, text: Callable[[float], str]) -> str:
    """Return a value with its interval; an anchor or a single scenario has none."""
    if interval is None:
        return ""
    value = text(interval.value)
    return value if interval.low == interval.high else f"{value} ({text(interval.low)} … {text(interval.high)})"


def signed_interval(interval: Interval | None) -> str:
    """Return a difference and its interval, with their signs."""
    return _interval(interval, _signed)


def _entry(row: EntrySummary) -> str:
    remarks = [f"{row.n_runs} seeds"] * (row.n_runs > 1) + [_PRIVILEGED] * row.privileged
    return row.name + (f" ({', '.join(remarks)})" if remarks else "")


def _has_mark(row: EntrySummary) -> bool:
    return row.marked and row.version != "v0"


def _stratum(name: str) -> Callable[[EntrySummary], str]:
    return lambda row: _plain(row.strata[name].value) if name in row.strata else ""


def _points(term: str) -> Callable[[EntrySummary], str]:
    return lambda row: _signed(row.points_by_term[term]) if row.points_by_term else "none"


class _Column(NamedTuple):
    heading: str
    text: Callable[[EntrySummary], str]
    tables: str  # which show it: "terminal"; "v0" and "v1", Markdown of that version; "details", more


#: In the order of every table, that of each stratum behind the score.
_COLUMNS = (
    _Column("rank", lambda row: "", "terminal v0 v1 details"),
    _Column("entry", _entry, "terminal v0 v1 details"),
    _Column("score", lambda row: _interval(row.score, _plain) or "none", "terminal v0 v1 details"),
    _Column("frequency, RoCoF [points]", _points("frequency_rocof"), "v0"),
    _Column("duty [points]", _points("duty"), "v0"),
    _Column("overload [points]", _points("overload"), "v0"),
    _Column("rest [points]", _points(REST), "v0"),
    _Column("failures [%]", lambda row: f"{row.failures_percent:.1f}", "v0 details"),
    _Column("median deviation [mHz]", lambda row: f"{row.median_deviation_mhz:.0f}", "terminal v1"),
    _Column(
        "lost or beyond 0.8 Hz [%]",
        lambda row: f"{row.lost_or_beyond_percent:.1f}" + f" {_MARK}" * _has_mark(row),
        "terminal v1 details",
    ),
    _Column("to the anchor [%-points]", lambda row: signed_interval(row.lost_or_beyond_to_hundred), "details"),
    _Column("worst tenth to the anchor [%]", lambda row: signed_interval(row.worst_decile_to_hundred), "details"),
    _Column("mean cost", lambda row: f"{row.mean_pinned_cost:.1f}", "terminal"),
    _Column("nadir [Hz]", lambda row: f"{row.median_nadir_hz:.3f}", "v0"),
)


def _columns(rows: Sequence[EntrySummary]) -> list[_Column]:
    strata = dict.fromkeys(name for row in rows for name in row.strata)
    of_strata = (_Column(name, _stratum(name), "terminal details") for name in strata)
    behind = 1 + [column.heading for column in _COLUMNS].index("score")
    return [*_COLUMNS[:behind], *of_strata, *_COLUMNS[behind:]]


def columns_of(table: str, rows: Sequence[EntrySummary]) -> list[str]:
    """Return the headings of a table, see :class:`_Column`, without empty columns."""
    columns = [column for column in _columns(rows) if table in column.tables.split()]
    return [column.heading for column in columns if column.heading == "rank" or any(map(column.text, rows))]


def table_cells(rows: Sequence[EntrySummary], columns: Sequence[str] | None = None) -> list[list[str]]:
    """Return the texts of the table, one list per row, in the order of the columns; equal entries share a rank.

    Rows are of one version; columns are headings, None for those of the detailed table that these rows fill.
    """
    texts = {column.heading: column.text for column in _columns(rows)}
    places = [place(row) for row in rows]
    columns = columns or columns_of("details", rows)
    ranks = [str(1 + sum(other < position for other in places)) for position in places]
    return [
        [rank if column == "rank" else texts[column](row) for column in columns]
        for rank, row in zip(ranks, rows, strict=True)
    ]


def markdown_table(rows: Sequence[EntrySummary], columns: Sequence[str] | None = None) -> str:
    """Return a ranking of one version as a Markdown table; columns are headings, None for those that a page shows."""
    # Without a score they are those of a terminal, with the cost that ranks.
    columns = columns or columns_of("terminal" if rows[0].score is None else rows[0].version, rows)
    numbers = [index for index, column in enumerate(columns) if column != "entry"]
    return files.markdown_table(columns, table_cells(rows, columns), right=numbers)


def notes_on_marks(rows: Sequence[EntrySummary]) -> list[str]:
    """Return what the mark and "privileged" mean, each if any row has it."""
    notes = ((_has_mark, _MARK_NOTE), (lambda row: row.privileged, _PRIVILEGED_NOTE))
    return [note for applies, note in notes if any(map(applies, rows))]
