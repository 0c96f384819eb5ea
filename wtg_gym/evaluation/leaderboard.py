"""The ranking of results, and the section of a page that shows it."""

from __future__ import annotations

from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.summary import EntrySummary, ranked
from wtg_gym.evaluation.table import markdown_table, privileged_note


def leaderboard_rows(results: Results) -> list[EntrySummary]:
    """Return the entries' summaries, the best score first, equal ones by name.

    Raises:
        NoScaleError: the results have no score, see :attr:`Results.summaries`.
    """
    return ranked(results.summaries)


def markdown_section(results: Results) -> str:
    """Return the ranking for a Markdown page: since v1 with a sentence on the frequency before the table."""
    rows = results.ranking
    notes = (f"{note[0].upper()}{note[1:]}." for note in (results.no_score, privileged_note(rows)) if note)
    return "\n\n".join(part for part in (_frequency_sentence(results), markdown_table(rows), *notes) if part)


def _frequency_sentence(results: Results) -> str:
    """Return what the anchors and the best learned entry do for the frequency [mHz], "" in v0."""
    benchmark, rows = results.benchmark, results.ranking
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
