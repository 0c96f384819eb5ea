"""Runs of policies over time beside the reference's, and their costs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from wtg_gym.evaluation.recording import Recording
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import explain_events, mark_end, mark_instants

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Quantity = Callable[[Recording], Floats]

K_OPT = tracking_point(0.0).coefficient
#: Distance that thinning may move a line, as a share of its panel's height: a tenth of a millimetre.
_INVISIBLE = 0.0035


@style.printed
def plot_runs(
    scenario: Scenario,
    runs: Mapping[str, Sequence[Recording]],
    looks: Mapping[str, style.Look] | None = None,
    overload_pu: float = style.OVERLOAD_PU,
) -> Figure:
    """Draw frequency, power, tip-speed ratio, k and τ of each WTG group over time, one column per group.

    A cross marks where a run ended before its time. Wind is drawn where it changes. Grey lines: λ_opt, λ_pr, overload.

    Args:
        runs: recordings of this one scenario, of one to four WTG groups, by entry; one per training seed.
        looks: of the entries by name; None for ones of their own.
        overload_pu: power above which a converter counts as overloaded [p.u.].
    """
    first = next(recordings[0] for recordings in runs.values() if recordings)
    looks = looks or style.strategy_looks(runs)
    # Wind is the same for all: the longest run shows most of it.
    longest = max((run for each in runs.values() for run in each), key=lambda run: int(np.isfinite(run.wind_m_s).sum()))
    n_rows = len(_OVER_TIME) + bool(np.nanstd(longest.wind_m_s[0], axis=0).max() > 1e-9)
    width = style.DOUBLE_COLUMN_MM if first.n_wtg > 1 else style.SINGLE_COLUMN_MM
    figure = style.new_figure(width, 30.0 + 32.0 * n_rows)
    grid = figure.subplots(n_rows, first.n_wtg, sharex=True, sharey="row", squeeze=False)
    for group in range(first.n_wtg):
        wind = float(np.nanmean(longest.wind_m_s[0, :, group]))
        mean = "mean wind " if first.n_wtg < 3 else ""
        style.letter_panel(grid[0, group], "abcd"[group], f"GFM-WTG {group + 1} ({mean}{wind:.3g} m/s)")
        for axes, (label, quantity) in zip(grid[:, group], _OVER_TIME.items(), strict=False):
            for name, recordings in runs.items():
                for run in recordings:
                    _draw_run(axes, run.time_s, quantity(run)[0, :, group], looks[name], name, len(recordings))
            if group == 0:
                axes.set_ylabel(label)
        if n_rows > len(_OVER_TIME):
            grid[-1, group].plot(longest.time_s, longest.wind_m_s[0, :, group], color="0.25")
            grid[-1, 0].set_ylabel("wind [m/s]")
        for axes in grid[:, group]:
            mark_instants(axes, scenario, numbered=axes is grid[0, group])
        grid[-1, group].set_xlabel("time [s]")
    _draw_limits(grid, overload_pu)
    scale_time_constant(grid[4, 0], [run.time_constant_s for each in runs.values() for run in each])
    grid[0, 0].set_xlim(0.0, float(first.time_s[-1]))
    for axes in grid.ravel():
        _thin(axes)
    figure.align_ylabels(grid[:, 0])
    draw_legend(figure, runs, looks)
    explain_events(figure, scenario)
    return figure


_OVER_TIME: dict[str, Quantity] = {
    "frequency [Hz]": lambda run: np.repeat(run.frequency_hz[:, :, None], run.n_wtg, axis=2),
    "power p [p.u.]": lambda run: run.power_pu,
    "tip-speed ratio λ [–]": lambda run: run.tip_speed_ratio,
    "k / $K_{opt}$ [–]": lambda run: run.coefficient_pu / K_OPT,
    "τ [s]": lambda run: run.time_constant_s,
}


def _draw_run(axes: Axes, time: Floats, values: Floats, look: style.Look, name: str, n_seeds: int) -> None:
    is_reference = name == REFERENCE_STRATEGY
    axes.plot(
        time,
        values,
        color=look.colour,
        linestyle=look.dashes,
        linewidth=1.6 if is_reference else 1.0 if n_seeds == 1 else 0.6,
        zorder=2.5 if is_reference else 3.0,
    )
    last = int(np.flatnonzero(np.isfinite(values))[-1]) if np.isfinite(values).any() else time.size - 1
    if last < time.size - 1:
        mark_end(axes, float(time[last]), float(values[last]), look.colour)


def _thin(axes: Axes) -> None:
    """Leave out points of long lines that move them by less than a tenth of a millimetre, so that files stay small."""
    low, high = axes.yaxis.get_transform().transform(np.array(axes.get_ylim()))
    for line in axes.lines:
        x, y = np.asarray(line.get_xdata(), dtype=np.float64), np.asarray(line.get_ydata(), dtype=np.float64)
        if x.size > 2:
            height = (axes.yaxis.get_transform().transform(y) - low) / (high - low)
            kept = needed_points(x, height, _INVISIBLE)
            line.set_data(x[kept], y[kept])


def needed_points(x: Floats, y: Floats, tolerance: float) -> npt.NDArray[np.bool_]:
    """Return which points a line needs to stay within a vertical distance of all that are left out, (n,).

    The method of Ramer, Douglas and Peucker; points next to one that is not finite are kept.

    Args:
        x, y: points of the line (n,), x rising.
        tolerance: the distance.
    """
    finite = np.isfinite(y)
    kept = ~(finite & np.roll(finite, 1) & np.roll(finite, -1))
    kept[[0, -1]] = True
    corners = np.flatnonzero(kept).tolist()
    parts = list(pairwise(corners))
    while parts:
        a, b = parts.pop()
        if b - a < 2 or not (finite[a] and finite[b]):
            continue
        inside = slice(a + 1, b)
        distance = np.abs(y[inside] - np.interp(x[inside], x[[a, b]], y[[a, b]]))
        worst = int(np.argmax(distance))
        if distance[worst] > tolerance:
            middle = a + 1 + worst
            kept[middle] = True
            parts += [(a, middle), (middle, b)]
    return kept


def _draw_limits(grid: npt.NDArray[Any], overload_pu: float) -> None:
    """Draw the limits of power and tip-speed ratio that are in sight, named at the last column."""
    control = GridFormingParameters()
    limits = {
        1: {"overload": overload_pu},
        2: {
            r"$\lambda_{opt}$": tracking_point(0.0).tip_speed_ratio,
            r"$\lambda_{pr}$": tracking_point(control.deloading_limit).tip_speed_ratio,
        },
    }
    for row, named in limits.items():
        style.share_limits(list(grid[row]))
        low, high = grid[row, 0].get_ylim()
        for name, value in named.items():
            if low < value < high:
                for axes in grid[row]:
                    axes.axhline(value, linewidth=0.7, zorder=2.0, **style.REFERENCE)
                style.name_at_right(grid[row, -1], name, value)


@style.printed
def plot_costs(
    costs: Mapping[str, Mapping[str, float]], looks: Mapping[str, style.Look] | None = None, suite: str = ""
) -> Figure:
    """Draw the mean cost of an episode, the total and term by term, one bar per entry.

    Args:
        costs: by entry and term; every entry has the same terms. A term that is zero for all entries is left out.
        looks: of the entries by name; None for ones of their own.
        suite: where the costs come from, for the axis.
    """
    looks = looks or style.strategy_looks(costs)
    terms = [term for term in next(iter(costs.values())) if any(own[term] > 0.0 for own in costs.values())]
    rows = {"total": {name: sum(own.values()) for name, own in costs.items()}}
    rows |= {term: {name: own[term] for name, own in costs.items()} for term in terms}
    n = len(costs)
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 24.0 + len(rows) * (3.0 + 3.4 * n))
    axes = figure.subplots()
    height = 0.86 / n
    for i, name in enumerate(costs):
        place = np.arange(len(rows)) + (i - 0.5 * (n - 1)) * height
        values = [row[name] for row in rows.values()]
        bars = axes.barh(place, values, 0.92 * height, color=looks[name].colour, alpha=0.85)
        axes.bar_label(
            bars,
            [f"{value:.1f}" if value >= 10.0 else f"{value:.2f}" for value in values],
            padding=2.0,
            fontsize=style.SMALL_PT,
        )
    axes.set_yticks(range(len(rows)), ["RoCoF" if term == "rocof" else term for term in rows])
    axes.tick_params(axis="y", length=0.0)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(False, axis="y")
    axes.margins(x=0.08)
    axes.set_xlabel(f"mean cost of an episode{suite and f' of {suite}'} [–]")
    draw_legend(figure, costs, {name: style.Look(looks[name].colour) for name in costs}, linewidth=5.0)
    return figure


def scale_time_constant(axes: Axes, values: Sequence[Floats]) -> None:
    """Give τ an axis in doublings: a policy multiplies and divides it."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    finite = np.concatenate([each[np.isfinite(each)] for each in values])
    if finite.size == 0:
        return
    axes.set_yscale("log", base=2)
    tau = GridFormingParameters().damping_time_constant_s
    axes.yaxis.set_major_locator(FixedLocator([tau * 2.0**power for power in range(-3, 4)]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.45 * tau), max(high, 2.2 * tau))


def draw_legend(
    figure: Figure, names: Iterable[str], looks: Mapping[str, style.Look], n_groups: int = 1, linewidth: float = 1.6
) -> None:
    """Draw a legend of entries and, where there is more than one, of groups by their dashes."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=looks[name].colour, linestyle=looks[name].dashes, linewidth=linewidth, label=_label(name))
        for name in names
    ]
    if n_groups > 1:
        styles = enumerate(style.GROUP_STYLES[:n_groups], start=1)
        handles += [Line2D([], [], color="0.3", linestyle=style, label=f"WTG group {group}") for group, style in styles]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(4, len(handles)), handlelength=3.0)


def _label(name: str) -> str:
    return f"reference ({name})" if name == REFERENCE_STRATEGY else name
