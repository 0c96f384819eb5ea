"""Frequency support against captured energy, entry by entry, and the front of those that no other one beats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from wtg_gym.plotting import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from wtg_gym.evaluation import EntrySummary

#: Entries with this share of failures or more are left out: a failed run pays for the frequency only until it ends.
MOST_FAILURES_PERCENT = 5.0


def support_points(row: EntrySummary) -> float:
    """Return what frequency and RoCoF add to a score of 100 [points]."""
    return row.points_by_term["frequency_rocof"]


def undominated(rows: Sequence[EntrySummary]) -> list[EntrySummary]:
    """Return the entries that no other one beats in support and energy, the least energy first."""
    places = [
        (row.mean_energy_share_percent, support_points(row), row)
        for row in rows
        if row.failures_percent <= MOST_FAILURES_PERCENT
    ]
    best = [(x, row) for x, y, row in places if not any(p >= x and q >= y and (p, q) != (x, y) for p, q, _ in places)]
    return [row for _, row in sorted(best, key=lambda each: each[0])]


@style.printed
def plot_front(rows: Sequence[EntrySummary]) -> Figure:
    """Draw points of frequency and RoCoF against the captured share of the energy, a marker per entry.

    A line joins the entries that no other one beats in both. Hollow markers fail in more than 5 % of the scenarios.
    """
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 88.0)
    axes = figure.subplots()
    looks = style.strategy_looks([row.name for row in rows])
    axes.axhline(0.0, linewidth=0.8, zorder=1.0, **style.REFERENCE)
    best = undominated(rows)
    line = [(row.mean_energy_share_percent, support_points(row)) for row in best]
    if line:
        axes.plot(*zip(*line, strict=True), color=style.REFERENCE_GREY, linewidth=1.0, zorder=1.5)
    for i, row in enumerate(rows):
        colour = looks[row.name].colour
        axes.plot(
            row.mean_energy_share_percent,
            support_points(row),
            linestyle="none",
            marker=style.MARKERS[i % len(style.MARKERS)],
            markersize=5.0,
            color=colour,
            markerfacecolor=colour if row.failures_percent <= MOST_FAILURES_PERCENT else "white",
            label=row.name if row.n_runs == 1 else f"{row.name} ({row.n_runs} seeds)",
        )
    axes.set_xlabel("captured share of the available energy [%]")
    axes.set_ylabel("frequency and RoCoF [points]")
    axes.margins(0.06)
    figure.legend(loc="outside right center", fontsize=style.SMALL_PT)
    return figure
