"""How fast policies were learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.plotting import style
from wtg_gym.scenarios.benchmark import V0

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Longer times are counted in hours [s].
_HOURS_FROM_S = 3.0 * 3600.0
#: Ends of curves that lie further apart than this share a logarithmic axis.
_LARGEST_LINEAR_RATIO = 12.0


@dataclass(frozen=True, kw_only=True)
class LearningCurve:
    """A run's validations, in their order."""

    timesteps: Floats  # environment steps done (n,)
    wall_time_s: Floats  # time since the start (n,) [s]
    score: Floats  # validation score (n,)


@style.printed
def plot_learning_curves(
    curves: Mapping[str, Sequence[LearningCurve]], anchors: tuple[str, str] = V0.anchors
) -> Figure:
    """Draw the validation score against (a) environment steps and (b) wall time, one colour per set-up.

    Lines are means over the training seeds, bands reach from the worst to the best; both end with the shortest run.
    Wall times are means, too.

    Args:
        curves: at least one, by set-up, one per training seed.
        anchors: names of the entries that score 0 and 100.

    Raises:
        ValueError: no curve is given, or a set-up's curves have no step in common.
    """
    from matplotlib.ticker import EngFormatter, FuncFormatter

    if not curves or not all(curves.values()):
        raise ValueError("there is no learning curve to plot")
    means = {name: _common(name, own) for name, own in curves.items()}
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 76.0 + 4.0 * -(-len(curves) // 3))
    by_steps, by_time = figure.subplots(1, 2, sharey=True)
    style.letter_panel(by_steps, "a", "against environment steps")
    style.letter_panel(by_time, "b", "against wall time")
    # Blue is the reference's in the figures beside this one.
    looks = style.strategy_looks([REFERENCE_STRATEGY, *curves])
    hours = max(own.wall_time_s[-1] for own in means.values()) > _HOURS_FROM_S
    for i, (name, own) in enumerate(means.items()):
        n = len(curves[name])
        label = f"{name} ({n} seed{'s' if n > 1 else ''})"
        line = {"color": looks[name].colour, "marker": style.MARKERS[i % len(style.MARKERS)], "markersize": 2.6}
        for axes, x in ((by_steps, own.timesteps), (by_time, own.wall_time_s / (3600.0 if hours else 60.0))):
            axes.plot(x, own.score.mean(axis=0), label=label, **line)
            if n > 1:
                axes.fill_between(
                    x, own.score.min(axis=0), own.score.max(axis=0), color=line["color"], alpha=0.18, linewidth=0.0
                )
    _scale(by_steps, [own.timesteps[-1] for own in means.values()])
    _scale(by_time, [own.wall_time_s[-1] for own in means.values()])
    # Scores far below 0 are cut off, so that the better ones stay readable.
    low, high = by_steps.get_ylim()
    by_steps.set_ylim(max(low, -5.0), max(high, 102.0))
    for axes in (by_steps, by_time):
        for name, score in zip(anchors, (0.0, 100.0), strict=True):
            if by_steps.get_ylim()[0] < score:
                axes.axhline(score, linewidth=0.8, zorder=1.5, **style.REFERENCE)
                if axes is by_time:
                    style.name_at_right(axes, name, score)
    by_steps.xaxis.set_major_formatter(EngFormatter(sep=" "))
    by_time.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    by_steps.set_xlabel("environment steps")
    by_time.set_xlabel(f"wall time [{'h' if hours else 'min'}]")
    by_steps.set_ylabel("validation score")
    handles, names = by_steps.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=min(3, len(names)))
    return figure


def _common(name: str, curves: Sequence[LearningCurve]) -> LearningCurve:
    """Return the steps at which all runs of a set-up were validated, mean times, and all scores (n_runs, n)."""
    steps = curves[0].timesteps
    for curve in curves[1:]:
        steps = np.intersect1d(steps, curve.timesteps)
    if steps.size == 0:
        raise ValueError(f"the runs of {name!r} were never validated at the same step")
    rows = [np.isin(curve.timesteps, steps) for curve in curves]
    times = np.stack([curve.wall_time_s[row] for curve, row in zip(curves, rows, strict=True)])
    scores = np.stack([curve.score[row] for curve, row in zip(curves, rows, strict=True)])
    return LearningCurve(timesteps=steps, wall_time_s=times.mean(axis=0), score=scores)


def _scale(axes: Axes, ends: Sequence[float]) -> None:
    """Give the horizontal axis a scale on which the shortest curve can be seen as well as the longest."""
    if max(ends) > _LARGEST_LINEAR_RATIO * min(ends) > 0.0:
        axes.set_xscale("log")
    else:
        axes.set_xlim(left=0.0)
        axes.locator_params(axis="x", nbins=7)
