"""The ranking as rows, and as a Markdown table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape

from wtg_gym import files
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.score import NoScaleError
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.summary import REST, EntrySummary, ranked


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


def _gap_closed(row: EntrySummary) -> str:
    """Return the share of the oracle's gap, and the number of scenarios with an oracle if not all have one."""
    if row.gap_closed_percent is None:
        return ""
    every = row.n_oracle * row.n_runs == row.n_episodes
    return _plain(row.gap_closed_percent.value, 1) + ("" if every else f" (n = {row.n_oracle})")


def _kind(row: EntrySummary) -> str:
    return f"{row.kind}, privileged" if row.privileged else row.kind


def _failures(row: EntrySummary) -> str:
    """Return the failures with those of frequency (f) and rotors (ω) in brackets, in percent."""
    by_kind = row.failures_percent_by_kind
    kinds = [f"{sign} {by_kind[kind]:.1f}" for sign, kind in (("f", "frequency"), ("ω", "rotor"))]
    return f"{row.failures_percent:.1f}" + (f" ({', '.join(kinds)})" if row.failures_percent else "")


#: The cells of a row by the headings of their columns; the rank stands before them.
_CELLS: dict[str, Callable[[EntrySummary], str]] = {
    "entry": lambda row: row.name if row.n_runs == 1 else f"{row.name} ({row.n_runs} seeds)",
    "score": lambda row: _interval(row.score),
    "to the entry above": lambda row: signed_interval(row.difference_to_above) if row.difference_to_above else "",
    "frequency, RoCoF [points]": lambda row: _signed(row.points_by_term["frequency_rocof"]),
    "duty [points]": lambda row: _signed(row.points_by_term["duty"]),
    "overload [points]": lambda row: _signed(row.points_by_term["overload"]),
    "rest [points]": lambda row: _signed(row.points_by_term[REST]),
    "kind": _kind,
    "IQM": lambda row: _plain(row.interquartile_mean.value, 1),
    "P(improvement)": lambda row: f"{row.probability_of_improvement.value:.2f}",
    "gap closed [%]": _gap_closed,
    "failures [%]": lambda row: f"{row.failures_percent:.1f}",
    "failures by kind [%]": _failures,
    "worst decile": lambda row: f"{row.worst_decile_cost:.0f}",
    "deviation [mHz]": lambda row: f"{row.median_deviation_mhz:.0f}",
    "p95 deviation [mHz]": lambda row: f"{row.p95_deviation_mhz:.0f}",
    "mean cost": lambda row: f"{row.mean_cost:.1f}",
    "nadir [Hz]": lambda row: f"{row.median_nadir_hz:.3f}",
    "p95 RoCoF [Hz/s]": lambda row: f"{row.p95_rocof_hz_s:.3f}",
    "p95 peak power [p.u.]": lambda row: f"{row.p95_peak_power_pu:.2f}",
    "p95 power change in 1 s [p.u.]": lambda row: f"{row.p95_power_change_pu:.2f}",
    "duty error [%]": lambda row: f"{row.mean_duty_error_percent:.2f}",
    "energy share [%]": lambda row: f"{row.mean_energy_share_percent:.1f}",
}
_ALL_COLUMNS = {column: column not in ("entry", "kind") for column in ("rank", *_CELLS)}
_SINCE_V1 = ("failures by kind [%]", "worst decile", "deviation [mHz]", "p95 deviation [mHz]")
#: Headings of the whole table of version v0, and whether the column holds numbers.
COLUMNS = {column: is_number for column, is_number in _ALL_COLUMNS.items() if column not in _SINCE_V1}
#: Columns of the table in a README and in a terminal, for version v0.
SHORT_COLUMNS = (
    "rank",
    "entry",
    "score",
    "frequency, RoCoF [points]",
    "duty [points]",
    "overload [points]",
    "rest [points]",
    "failures [%]",
    "nadir [Hz]",
)
_SHORT_COLUMNS_SINCE_V1 = (
    *SHORT_COLUMNS[: SHORT_COLUMNS.index("failures [%]")],
    _SINCE_V1[0],
    "mean cost",
    *_SINCE_V1[1:],
    "p95 peak power [p.u.]",
    "p95 power change in 1 s [p.u.]",
    "energy share [%]",
)


def columns_of(version: str) -> dict[str, bool]:
    """Return the headings of the whole table of a version, and whether the column holds numbers."""
    if version == "v0":
        return COLUMNS
    return {column: is_number for column, is_number in _ALL_COLUMNS.items() if column != "failures [%]"}


def short_columns_of(version: str) -> tuple[str, ...]:
    """Return the columns of the short table of a version."""
    return SHORT_COLUMNS if version == "v0" else _SHORT_COLUMNS_SINCE_V1


def leaderboard_rows(results: Results) -> list[EntrySummary]:
    """Return the entries' summaries, the best score first, equal ones by name.

    Raises:
        NoScaleError: the results have no score, see :attr:`Results.summaries`.
    """
    return ranked(results.summaries)


def table_cells(rows: Sequence[EntrySummary], columns: Sequence[str] | None = None) -> list[list[str]]:
    """Return the texts of the table, one list per row, in the order of the columns; equal scores share a rank.

    Args:
        rows: of one version.
        columns: headings; None for those of the version's whole table.
    """
    columns = tuple(columns_of(rows[0].version)) if columns is None else columns
    scores = [row.score.value for row in rows]
    ranks = [str(1 + sum(other > score for other in scores)) for score in scores]
    return [
        [rank if column == "rank" else _CELLS[column](row) for column in columns]
        for rank, row in zip(ranks, rows, strict=True)
    ]


def markdown_section(results: Results) -> str:
    """Return the ranking for a Markdown page: since v1 with a sentence on the frequency before the table."""
    rows = leaderboard_rows(results)
    return f"{frequency_sentence(results)}{markdown_table(rows)}"


def frequency_sentence(results: Results) -> str:
    """Return what the anchors and the best learned entry do for the frequency [mHz], "" in v0; then an empty line."""
    benchmark, rows = results.benchmark, leaderboard_rows(results)
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
        f"{', '.join(said)}.\n\n"
    )


def markdown_table(rows: Sequence[EntrySummary]) -> str:
    """Return the ranking as a Markdown table of the version's short columns, without a line feed at the end."""
    columns = short_columns_of(rows[0].version)
    numbers = [index for index, column in enumerate(columns) if _ALL_COLUMNS[column]]
    return files.markdown_table(list(columns), table_cells(rows, columns), right=numbers)


def html_table(results: Results) -> str:
    """Return the ranking as an HTML table of the version's short columns, or why there is none."""
    columns = short_columns_of(results.benchmark.version)
    scenarios = f"{results.suite}, {results.split}: {len(results.seeds)} scenarios"
    try:
        rows = table_cells(leaderboard_rows(results), columns)
    except NoScaleError as error:
        return f"<p>{escape(scenarios)}; no ranking: {escape(str(error))}</p>"
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    cells = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    caption = f"<caption>{escape(scenarios)}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
