"""Figures of measurements: the error of the step against its cost, and the cost of a step against sizes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym.plotting import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.analysis.benchmarks.growth import Curve
    from wtg_gym.analysis.step_error import Accuracy, AccuracyStudy

#: Markers of the methods.
_MARKERS = ("s", "^", "D", "o", "v", "P")
_TITLES = {
    "groups": "WTG groups",
    "machines": "synchronous machines, in a batch",
    "lanes": "lanes on one thread",
    "threads": "threads of a large batch",
}


@style.printed
def plot_accuracy(study: AccuracyStudy) -> Figure:
    """Draw the error of frequency and of power against the time per simulated second, one line per method.

    Lines join the worst scenario of each step, dots the median one; the ring is the default step. Steps are written at
    the last method, since the others' follow from their numbers of evaluations.
    """
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 82.0)
    panels = figure.subplots(1, 2, sharex=True)
    for axes, quantity, label in (
        (panels[0], "frequency_hz", "error of frequency [Hz]"),
        (panels[1], "power_pu", "error of power [p.u.]"),
    ):
        _draw_errors(axes, study, quantity)
        axes.set_xlabel("time per simulated second [µs]")
        axes.set_ylabel(label)
    times = panels[0].xaxis
    times.set_major_locator(FixedLocator([50, 100, 200, 500, 1000, 2000]))
    times.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    times.set_minor_formatter(NullFormatter())
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    return figure


def _label_steps(axes: Axes, rows: Sequence[Accuracy], cost: Sequence[float], error: Sequence[float]) -> None:
    """Write the steps below a line's points, except where two names would overlap."""
    right = float("inf")
    for row, x, y in reversed(list(zip(rows, cost, error, strict=True))):
        if right / x > 1.3:
            right = x
            text = f"{1e3 * row.step_s:g} ms"
            look: dict[str, Any] = {"ha": "center", "va": "top", "fontsize": style.SMALL_PT}
            axes.annotate(text, (x, y), (0, -4), textcoords="offset points", **look)
    low, high = axes.get_ylim()
    axes.set_ylim(low / 3.0, high)


def _draw_errors(axes: Axes, study: AccuracyStudy, quantity: str) -> None:
    names = list(dict.fromkeys(row.method for row in study.rows))
    for i, name in enumerate(names):
        rows = sorted((row for row in study.rows if row.method == name), key=lambda row: row.microseconds_per_s)
        cost = [row.microseconds_per_s for row in rows]
        worst = [float(getattr(row, quantity).max()) for row in rows]
        median = [float(np.median(getattr(row, quantity))) for row in rows]
        colour, last = style.PALETTE[i % len(style.PALETTE)], name == names[-1]
        axes.loglog(cost, worst, marker=_MARKERS[i % len(_MARKERS)], color=colour, label=name)
        axes.loglog(
            cost, median, ":", color=colour, linewidth=0.9, label="median scenario" if last else None, zorder=1.5
        )
        if last:
            _label_steps(axes, rows, cost, median)
    chosen = study.row("RK4", study.default_step_s)
    at = chosen.microseconds_per_s, float(getattr(chosen, quantity).max())
    axes.plot(*at, "o", markersize=10, markerfacecolor="none", markeredgecolor="black", label="default")


@style.printed
def plot_growth(curves: Sequence[Curve]) -> Figure:
    """Draw the time per environment step against every kind of size, the sizes on logarithmic axes.

    Grey lines go through the first point with the slope that is named: what proportional growth, or an ideal gain,
    would be.
    """
    kinds = list(dict.fromkeys(curve.name.split(", ")[0] for curve in curves))
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 62.0 * -(-len(kinds) // 2))
    panels = figure.subplots(-(-len(kinds) // 2), 2, squeeze=False).ravel()
    for axes, kind, letter in zip(panels, kinds, "abcdefgh", strict=False):
        _draw_growth(axes, [curve for curve in curves if curve.name.split(", ")[0] == kind], kind)
        style.letter_panel(axes, letter, _TITLES[kind])
    for axes in panels[len(kinds) :]:
        axes.set_axis_off()
    return figure


def _draw_growth(axes: Axes, curves: Sequence[Curve], kind: str) -> None:
    for i, curve in enumerate(curves):
        n, cost = [point.n for point in curve.points], [point.microseconds for point in curve.points]
        label = None if len(curves) == 1 else ("single" if curve.name.endswith("single") else "in a batch")
        axes.loglog(n, cost, marker=style.MARKERS[i], color=style.PALETTE[i], label=label)
        slope, guide_label = (-1.0, "ideal") if kind == "threads" else (1.0, "proportional")
        if kind != "lanes":
            guide = cost[0] * (np.array(n) / n[0]) ** slope
            axes.plot(n, guide, ":", color=style.REFERENCE_GREY, zorder=1.0, label=guide_label if i == 0 else None)
    _label_axes(axes, kind, [point.n for point in curves[0].points])
    if len(curves) > 1 or kind != "lanes":
        axes.legend(loc="best")


def _label_axes(axes: Axes, kind: str, sizes: Sequence[int]) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

    axes.set_xlabel(f"number of {kind}")
    axes.set_ylabel("time per step [µs]")
    axes.xaxis.set_major_locator(FixedLocator(list(sizes)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(FixedLocator([]))
    if kind in ("groups", "machines"):
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        # Less than a decade: the eye compares heights from zero.
        axes.set_yscale("linear")
        axes.set_ylim(bottom=0.0)
    axes.tick_params(labelsize=style.SMALL_PT)
