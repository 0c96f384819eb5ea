"""Cost of a step against the size of the plant, the number of lanes and the number of threads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.plotting.style import (
    DOUBLE_COLUMN_MM,
    MARKERS,
    PALETTE,
    REFERENCE_GREY,
    SMALL_PT,
    letter_panel,
    new_figure,
    printed,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.analysis.benchmarks.growth import Curve


@printed
def plot_growth(curves: Sequence[Curve]) -> Figure:
    """Draw the time per environment step against every kind of size, the sizes on logarithmic axes.

    Grey lines go through the first point with the slope that is named: what proportional growth, or an ideal gain,
    would be.

    Args:
        curves: what :func:`wtg_gym.analysis.benchmarks.growth.growth_curves` returns.
    """
    kinds = list(dict.fromkeys(curve.name.split(", ")[0] for curve in curves))
    figure = new_figure(DOUBLE_COLUMN_MM, 62.0 * -(-len(kinds) // 2))
    panels = figure.subplots(-(-len(kinds) // 2), 2, squeeze=False).ravel()
    for axes, kind, letter in zip(panels, kinds, "abcdefgh", strict=False):
        _draw(axes, [curve for curve in curves if curve.name.split(", ")[0] == kind], kind)
        letter_panel(axes, letter, _TITLES[kind])
    for axes in panels[len(kinds) :]:
        axes.set_axis_off()
    return figure


_TITLES = {
    "groups": "WTG groups",
    "machines": "synchronous machines, in a batch",
    "lanes": "lanes on one thread",
    "threads": "threads of a large batch",
}


def _draw(axes: Axes, curves: Sequence[Curve], kind: str) -> None:
    for i, curve in enumerate(curves):
        n, cost = [point.n for point in curve.points], [point.microseconds for point in curve.points]
        label = None if len(curves) == 1 else ("single" if curve.name.endswith("single") else "in a batch")
        axes.loglog(n, cost, marker=MARKERS[i], color=PALETTE[i], label=label)
        slope = 1.0 if kind in ("groups", "machines") else -1.0
        if kind != "lanes":
            guide = cost[0] * (np.array(n) / n[0]) ** slope
            axes.plot(n, guide, ":", color=REFERENCE_GREY, zorder=1.0, label=_guide_label(kind) if i == 0 else None)
    _label_axes(axes, kind, [point.n for point in curves[0].points])
    if len(curves) > 1 or kind != "lanes":
        axes.legend(loc="best")


def _guide_label(kind: str) -> str:
    return "ideal" if kind == "threads" else "proportional"


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
    axes.tick_params(labelsize=SMALL_PT)


__all__ = ["plot_growth"]
