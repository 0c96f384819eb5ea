"""The accuracy of the integration against its cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.plotting.style import DOUBLE_COLUMN_MM, PALETTE, SMALL_PT, new_figure, printed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.analysis.step_error import Accuracy, AccuracyStudy

_MARKERS = ("s", "^", "D", "o", "v", "P")


@printed
def plot_accuracy(study: AccuracyStudy) -> Figure:
    """Draw the error of frequency and of power against the time per simulated second, one line per method.

    Lines join the worst scenario of each step, dots the median one; the ring is the default step. Steps are written at
    the last method, since the others' follow from their numbers of evaluations.

    Args:
        study: what :func:`wtg_gym.analysis.step_error.study_accuracy` returns.
    """
    figure = new_figure(DOUBLE_COLUMN_MM, 82.0)
    panels = figure.subplots(1, 2, sharex=True)
    for axes, quantity, label in (
        (panels[0], "frequency_hz", "error of frequency [Hz]"),
        (panels[1], "power_pu", "error of power [p.u.]"),
    ):
        _draw(axes, study, quantity)
        axes.set_xlabel("time per simulated second [µs]")
        axes.set_ylabel(label)
    _label_times(panels[0])
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    return figure


def _label_times(axes: Axes) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    axes.xaxis.set_major_locator(FixedLocator([50, 100, 200, 500, 1000, 2000]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _label_steps(axes: Axes, rows: Sequence[Accuracy], cost: Sequence[float], error: Sequence[float]) -> None:
    """Write the steps below a line's points, but for those that would run into their neighbour on the right."""
    right = float("inf")
    for row, x, y in reversed(list(zip(rows, cost, error, strict=True))):
        if right / x > 1.3:
            right = x
            text = f"{1e3 * row.step_s:g} ms"
            offset = (0, -4)
            axes.annotate(text, (x, y), offset, textcoords="offset points", ha="center", va="top", fontsize=SMALL_PT)
    low, high = axes.get_ylim()
    axes.set_ylim(low / 3.0, high)


def _draw(axes: Axes, study: AccuracyStudy, quantity: str) -> None:
    names = list(dict.fromkeys(row.method for row in study.rows))
    for i, name in enumerate(names):
        rows = sorted((row for row in study.rows if row.method == name), key=lambda row: row.microseconds_per_s)
        cost = [row.microseconds_per_s for row in rows]
        worst = [float(getattr(row, quantity).max()) for row in rows]
        median = [float(np.median(getattr(row, quantity))) for row in rows]
        colour, last = PALETTE[i % len(PALETTE)], name == names[-1]
        axes.loglog(cost, worst, marker=_MARKERS[i % len(_MARKERS)], color=colour, label=name)
        axes.loglog(
            cost, median, ":", color=colour, linewidth=0.9, label="median scenario" if last else None, zorder=1.5
        )
        if last:
            _label_steps(axes, rows, cost, median)
    chosen = study.row("RK4", study.default_step_s)
    at = chosen.microseconds_per_s, float(getattr(chosen, quantity).max())
    axes.plot(*at, "o", markersize=10, markerfacecolor="none", markeredgecolor="black", label="default")


__all__ = ["plot_accuracy"]
