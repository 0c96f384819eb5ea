"""The accuracy of the integration against its cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.plotting.style import DOUBLE_COLUMN_MM, PALETTE, SMALL_PT, new_figure, printed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.validation.accuracy import AccuracyStudy

_MARKERS = ("s", "^", "D", "o", "v", "P")


@printed
def plot_accuracy(study: AccuracyStudy) -> Figure:
    """Draw the worst error of frequency and of power over all scenarios against the time per simulated second.

    One line per method, one marker per step; the line below is the median scenario, the ring the default step.

    Args:
        study: what :func:`wtg_gym.validation.accuracy.study_accuracy` returns.
    """
    figure = new_figure(DOUBLE_COLUMN_MM, 78.0)
    panels = figure.subplots(1, 2)
    for axes, quantity, label in (
        (panels[0], "frequency_hz", "error of frequency [Hz]"),
        (panels[1], "power_pu", "error of power [p.u.]"),
    ):
        _draw(axes, study, quantity)
        axes.set_xlabel("time per simulated second, one environment [µs]")
        axes.set_ylabel(label)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    return figure


def _draw(axes: Axes, study: AccuracyStudy, quantity: str) -> None:
    names = list(dict.fromkeys(row.method for row in study.rows))
    for i, name in enumerate(names):
        rows = sorted((row for row in study.rows if row.method == name), key=lambda row: row.microseconds_per_s)
        cost = [row.microseconds_per_s for row in rows]
        worst = [float(getattr(row, quantity).max()) for row in rows]
        median = [float(np.median(getattr(row, quantity))) for row in rows]
        colour = PALETTE[i % len(PALETTE)]
        axes.loglog(cost, worst, marker=_MARKERS[i % len(_MARKERS)], color=colour, label=f"{name}, worst scenario")
        axes.loglog(cost, median, linestyle=":", color=colour, linewidth=0.9)
        if name == names[-1]:
            for row, x, y in zip(rows, cost, worst, strict=True):
                axes.annotate(
                    f"{1e3 * row.step_s:g} ms", (x, y), xytext=(4, 4), textcoords="offset points", fontsize=SMALL_PT
                )
    chosen = study.row("RK4", study.default_step_s)
    axes.plot(
        chosen.microseconds_per_s,
        getattr(chosen, quantity).max(),
        "o",
        markersize=11,
        markerfacecolor="none",
        markeredgecolor="black",
        label="default" if quantity == "frequency_hz" else None,
    )


__all__ = ["plot_accuracy"]
