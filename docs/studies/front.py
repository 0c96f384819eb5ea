"""Support of the frequency against captured energy, entry by entry.

    wtg-gym evaluate --suite standard-v1 --entries baselines policies --results results
    python docs/studies/front.py [--output DOCS]

draws DOCS/images/front-v1.svg from those results.
"""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
from output import folder as output_folder

from wtg_gym.evaluation import EntrySummary, Results, leaderboard_rows
from wtg_gym.plotting import save_figure, style

#: Entries with more failures are hollow and not joined: a failed run pays for the frequency only until it ends.
MOST_FAILURES_PERCENT = 5.0


def undominated(rows: Sequence[EntrySummary]) -> list[EntrySummary]:
    """Return the entries that no other one beats in support and energy, the least energy first."""
    places = {row.name: place(row) for row in rows if row.failures_percent <= MOST_FAILURES_PERCENT}
    beaten = {
        name
        for name, (x, y) in places.items()
        if any(p >= x and q >= y and (p, q) != (x, y) for p, q in places.values())
    }
    return sorted((row for row in rows if row.name in places.keys() - beaten), key=place)


def place(row: EntrySummary) -> tuple[float, float]:
    """Return the captured share of the available energy [%], and what frequency and RoCoF add to a score of 100."""
    return row.mean_energy_share_percent, row.points_by_term["frequency_rocof"]


@style.printed
def plot_front(rows: Sequence[EntrySummary]) -> Figure:
    """Draw a marker per entry; a line joins those that no other one beats in both."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 88.0)
    axes = figure.subplots()
    looks = style.strategy_looks([row.name for row in rows])
    axes.axhline(0.0, linewidth=0.8, zorder=1.0, **style.REFERENCE)
    line = zip(*map(place, undominated(rows)), strict=True)
    axes.plot(*line, color=style.REFERENCE_GREY, linewidth=1.0, zorder=1.5)
    for i, row in enumerate(rows):
        colour = looks[row.name].colour
        axes.plot(
            *place(row),
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


if __name__ == "__main__":
    docs = output_folder(__doc__)
    rows = leaderboard_rows(Results.read("results/standard-v1-validation.json"))
    save_figure(plot_front(rows), docs / "images" / "front-v1", ["svg"])
