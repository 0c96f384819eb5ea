"""The ranking as rows, and as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from wtg_gym import files
from wtg_gym.evaluation.score import NoScaleError
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.summary import DESIGN_DEVIATION_MHZ, REST, EntryMeasures, EntrySummary, ranked

if TYPE_CHECKING:
    from wtg_gym.evaluation.results import Results

#: Headings of two columns of the short table.
MEDIAN_DEVIATION = "median deviation [mHz]"
LOST_OR_BEYOND = f"lost or beyond {DESIGN_DEVIATION_MHZ / 1000.0:g} Hz [%]"


def signed_interval(interval: Interval) -> str:
    """Return a difference of scores and its interval, with their signs."""
    return f"{_signed(interval.value)} ({_signed(interval.low)} … {_signed(interval.high)})"


def _signed(value: float) -> str:
    return f"{value:+.1f}" if round(value, 1) else "0.0"


def _plain(value: float, digits: int) -> str:
    # Adding 0.0 turns -0.0 into 0.0.
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _interval(interval: Interval) -> str:
    if interval.low == interval.high:
        # No spread: an anchor, whose score is fixed, or a single scenario.
        return _plain(interval.value, 1)
    return f"{_plain(interval.value, 1)} ({_plain(interval.low, 1)} … {_plain(interval.high, 1)})"


def _gap_closed(row: EntryMeasures) -> str:
    """Return the share of the oracle's gap, and the number of scenarios with an oracle if not all have one."""
    if row.gap_closed_percent is None:
        return ""
    every = row.n_oracle * row.n_runs == row.n_episodes
    return _plain(row.gap_closed_percent.value, 1) + ("" if every else f" (n = {row.n_oracle})")


def _entry(row: EntryMeasures) -> str:
    """Return the name, with the number of training seeds and :data:`PRIVILEGED` in brackets."""
    marks = [f"{row.n_runs} seeds"] * (row.n_runs > 1) + [PRIVILEGED] * row.privileged
    return row.name + (f" ({', '.join(marks)})" if marks else "")


def _failures(row: EntryMeasures) -> str:
    """Return the failures with those of frequency (f) and rotors (ω) in brackets, in percent."""
    by_kind = row.failures_percent_by_kind
    kinds = [f"{sign} {by_kind[kind]:.1f}" for sign, kind in (("f", "frequency"), ("ω", "rotor"))]
    return f"{row.failures_percent:.1f}" + (f" ({', '.join(kinds)})" if row.failures_percent else "")


#: What an entry is marked with that sees the state of the grid, and what a page says about it.
PRIVILEGED = "privileged"
_PRIVILEGED_NOTE = f"{PRIVILEGED}: sees the state of the whole grid, which no turbine measures"
_POINTS = ("frequency, RoCoF [points]", "duty [points]", "overload [points]", "rest [points]")
#: The text of a cell by the heading of its column, in the order of the whole table.
_CELLS: dict[str, Callable[[Any], str]] = {
    "entry": _entry,
    "score": lambda row: _interval(row.score),
    "to the entry above": lambda row: signed_interval(row.difference_to_above) if row.difference_to_above else "",
    _POINTS[0]: lambda row: _signed(row.points_by_term["frequency_rocof"]),
    _POINTS[1]: lambda row: _signed(row.points_by_term["duty"]),
    _POINTS[2]: lambda row: _signed(row.points_by_term["overload"]),
    _POINTS[3]: lambda row: _signed(row.points_by_term[REST]),
    "kind": lambda row: row.kind,
    "IQM": lambda row: _plain(row.interquartile_mean.value, 1),
    "P(improvement)": lambda row: f"{row.probability_of_improvement.value:.2f}",
    "gap closed [%]": _gap_closed,
    "failures [%]": lambda row: f"{row.failures_percent:.1f}",
    "failures by kind [%]": _failures,
    LOST_OR_BEYOND: lambda row: f"{row.lost_or_beyond_percent:.1f}",
    "worst decile": lambda row: f"{row.worst_decile_cost:.0f}",
    MEDIAN_DEVIATION: lambda row: f"{row.median_deviation_mhz:.0f}",
    "p95 deviation [mHz]": lambda row: f"{row.p95_deviation_mhz:.0f}",
    "mean pinned cost": lambda row: f"{row.mean_pinned_cost:.1f}",
    "nadir [Hz]": lambda row: f"{row.median_nadir_hz:.3f}",
    "p95 RoCoF [Hz/s]": lambda row: f"{row.p95_rocof_hz_s:.3f}",
    "p95 peak power [p.u.]": lambda row: f"{row.p95_peak_power_pu:.2f}",
    "p95 power change in 1 s [p.u.]": lambda row: f"{row.p95_power_change_pu:.2f}",
    "duty error [%]": lambda row: f"{row.mean_duty_error_percent:.2f}",
    "energy share [%]": lambda row: f"{row.mean_energy_share_percent:.1f}",
    "lost runs": lambda row: f"{row.n_lost} of {row.n_episodes}",
}
#: Columns that only rows with a score have.
_OF_SCORES = ("score", "to the entry above", *_POINTS, "IQM")
#: What the whole table of version v0 leaves out, and that since v1; both count the lost runs in percent.
_SINCE_V1 = ("failures by kind [%]", LOST_OR_BEYOND, "worst decile", MEDIAN_DEVIATION, "p95 deviation [mHz]")
_LEFT_OUT = {"v0": ("lost runs", *_SINCE_V1), "v1": ("lost runs", "failures [%]")}
#: Columns of text.
_TEXTS = ("entry", "kind")
#: Columns of the table in a README and in a notebook: for version v0, and since v1.
SHORT_COLUMNS = ("rank", "entry", "score", *_POINTS, "failures [%]", "nadir [Hz]")
_SHORT_COLUMNS_SINCE_V1 = ("rank", "entry", "score", MEDIAN_DEVIATION, LOST_OR_BEYOND)
#: Columns of the table in a terminal.
TERMINAL_COLUMNS = ("rank", "entry", "score", MEDIAN_DEVIATION, "lost runs", LOST_OR_BEYOND, "mean pinned cost")


def columns_of(version: str) -> dict[str, bool]:
    """Return the headings of the whole table of a version, and whether the column holds numbers."""
    return {column: column not in _TEXTS for column in ("rank", *_CELLS) if column not in _LEFT_OUT[version]}


def short_columns_of(version: str) -> tuple[str, ...]:
    """Return the columns of the short table of a version."""
    return SHORT_COLUMNS if version == "v0" else _SHORT_COLUMNS_SINCE_V1


def _shown(rows: Sequence[EntryMeasures]) -> tuple[str, ...]:
    """Return the columns of a short table: without a score they are those of a terminal, with the cost that ranks."""
    return short_columns_of(rows[0].version) if isinstance(rows[0], EntrySummary) else TERMINAL_COLUMNS


def text_columns(columns: Sequence[str]) -> list[int]:
    """Return which of the columns hold text."""
    return [index for index, column in enumerate(columns) if column in _TEXTS]


def leaderboard_rows(results: Results) -> list[EntrySummary]:
    """Return the entries' summaries, the best score first, equal ones by name.

    Raises:
        NoScaleError: the results have no score, see :attr:`Results.summaries`.
    """
    return ranked(results.summaries)


def table_rows(results: Results) -> list[EntryMeasures]:
    """Return the rows of a table: :func:`leaderboard_rows`, or without a score those of the least mean cost first."""
    if results.has_scale:
        return [*leaderboard_rows(results)]
    return sorted(results.measures, key=lambda row: (row.mean_pinned_cost, row.name))


def no_score_note(results: Results) -> str:
    """Return why there is no score and what the table is ranked by, "" where there is a score."""
    try:
        leaderboard_rows(results)
    except NoScaleError as error:
        return f"ranked by mean pinned cost, as there is no score: {error}"
    return ""


def privileged_note(rows: Sequence[EntryMeasures]) -> str:
    """Return what the mark of privileged entries means, "" where no row has it."""
    return _PRIVILEGED_NOTE if any(row.privileged for row in rows) else ""


def table_cells(rows: Sequence[EntryMeasures], columns: Sequence[str] | None = None) -> list[list[str]]:
    """Return the texts of the table, one list per row, in the order of the columns; equal entries share a rank.

    Args:
        rows: of one version, as :func:`leaderboard_rows` or :func:`table_rows` gives them.
        columns: headings; None for those of the version's whole table.
    """
    columns = tuple(columns_of(rows[0].version)) if columns is None else columns
    places = [-row.score.value if isinstance(row, EntrySummary) else row.mean_pinned_cost for row in rows]
    ranks = [str(1 + sum(other < place for other in places)) for place in places]
    return [
        [rank if column == "rank" else _cell(row, column) for column in columns]
        for rank, row in zip(ranks, rows, strict=True)
    ]


def _cell(row: EntryMeasures, column: str) -> str:
    return "none" if column in _OF_SCORES and not isinstance(row, EntrySummary) else _CELLS[column](row)


def markdown_section(results: Results) -> str:
    """Return the ranking for a Markdown page: since v1 with a sentence on the frequency before the table."""
    rows = table_rows(results)
    notes = (f"{note[0].upper()}{note[1:]}." for note in (no_score_note(results), privileged_note(rows)) if note)
    return "\n\n".join(part for part in (frequency_sentence(results), markdown_table(rows), *notes) if part)


def frequency_sentence(results: Results) -> str:
    """Return what the anchors and the best learned entry do for the frequency [mHz], "" in v0."""
    benchmark, rows = results.benchmark, table_rows(results)
    if benchmark.version == "v0":
        return ""
    learned = next((row for row in rows if row.kind == "learned"), None)
    who = {benchmark.zero: "the published law", benchmark.hundred: "that law tuned to this grid"}
    if learned is not None:
        who[learned.name] = f"`{learned.name}`, the best learned entry"
    deviations = {row.name: row.median_deviation_mhz for row in rows}
    said = [f"{deviations[name]:.0f} mHz with {words}" for name, words in who.items()]
    return (
        f"Median over {len(results.seeds)} {results.split} scenarios of the largest deviation of the frequency: "
        f"{', '.join(said)}."
    )


def markdown_table(rows: Sequence[EntryMeasures], columns: Sequence[str] | None = None) -> str:
    """Return the ranking as a Markdown table without a line feed at the end.

    Args:
        rows: of one version, as :func:`leaderboard_rows` gives them.
        columns: headings; None for those of the version's short table.
    """
    columns = _shown(rows) if columns is None else columns
    numbers = sorted(set(range(len(columns))) - set(text_columns(columns)))
    return files.markdown_table(columns, table_cells(rows, columns), right=numbers)


def html_table(results: Results) -> str:
    """Return the ranking as an HTML table of the version's short columns, its caption with what there is to say."""
    rows = table_rows(results)
    columns = _shown(rows)
    scenarios = f"{results.suite}, {results.split}: {len(results.seeds)} scenarios"
    notes = [scenarios, *filter(None, (no_score_note(results), privileged_note(rows)))]
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    cells = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in table_cells(rows, columns))
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    caption = f"<caption>{escape('; '.join(notes))}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
