"""What a trained policy does: its k and τ over what it sees, its runs beside the reference's, and what they cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from wtg_gym.evaluation.recording import Recording
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.plotting.event_marks import explain_events, mark_end, mark_instants
from wtg_gym.plotting.style import (
    DOUBLE_COLUMN_MM,
    GROUP_STYLES,
    REFERENCE_GREY,
    SINGLE_COLUMN_MM,
    SMALL_PT,
    Look,
    letter_panel,
    name_at_right,
    new_figure,
    printed,
    share_limits,
    strategy_looks,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Quantity = Callable[[Recording], Floats]

#: Share of the samples drawn, from the middle, and of those in a bin that lie within its band.
_DRAWN, _BAND = 0.98, 0.8
_N_BINS = 24
#: A bin with fewer samples says nothing: neighbours in time are alike.
_LEAST_SAMPLES = 60
#: Groups are drawn apart where their means differ by this share of the scatter (root mean square over bins).
_GROUPS_APART = 0.25
_LARGEST_NUMBER_OF_GROUPS = 4
#: What a line may move by thinning, as a share of its panel's height: a tenth of a millimetre.
_INVISIBLE = 0.0035
_THIN_DASHES = (0.0, (5.0, 2.0))

_K_OPT = tracking_point(0.0).coefficient
_SEEN: dict[str, Quantity] = {
    "frequency deviation\n[Hz]": lambda run: run.deviation_hz,
    "RoCoF over 0.1 s\n[Hz/s]": lambda run: run.rocof_hz_s,
    "tip-speed ratio λ above\nits target [–]": lambda run: run.ratio_above_target,
    "rotor speed $\\omega_m$\n[p.u.]": lambda run: run.rotor_speed_pu,
    "wind speed\n[m/s]": lambda run: run.wind_m_s,
}


@dataclass(frozen=True)
class Bins:
    """A quantity over another one, in bins of equal width: centres, and quantiles of what lies in each (n_bins,)."""

    centre: Floats
    low: Floats
    median: Floats
    high: Floats


def binned(x: Floats, y: Floats, edges: Floats) -> Bins:
    """Return the quantiles 10, 50 and 90 % of y over x, not a number in bins of fewer than 60 samples.

    Args:
        x, y: samples of one shape; those that are not finite do not count.
        edges: of the bins, rising (n_bins + 1,).
    """
    finite = np.isfinite(x) & np.isfinite(y)
    place, values = np.digitize(x[finite], edges) - 1, y[finite]
    quantiles = np.full((3, edges.size - 1), np.nan)
    for i in range(edges.size - 1):
        inside = values[place == i]
        if inside.size >= _LEAST_SAMPLES:
            quantiles[:, i] = np.quantile(inside, [0.5 - 0.5 * _BAND, 0.5, 0.5 + 0.5 * _BAND])
    return Bins(0.5 * (edges[1:] + edges[:-1]), *quantiles)


@printed
def plot_responses(
    name: str, policy: Recording, reference: Recording, looks: Mapping[str, Look] | None = None
) -> Figure:
    """Draw k and τ in use over what a policy sees, with the reference's beside them.

    Lines are medians of bins, bands hold the middle 80 %; the lowest row says where the samples are. Groups are taken
    together; where the policy treats them differently, it has a median for each.

    Args:
        name: of the policy.
        policy: its recording.
        reference: that of the reference in the same scenarios.
        looks: of policy and reference by name; None for ones of their own.
    """
    looks = looks or strategy_looks([REFERENCE_STRATEGY, name])
    runs = {REFERENCE_STRATEGY: reference, name: policy}
    used: dict[str, Quantity] = {
        "k / $K_{opt}$ [–]": lambda run: run.coefficient_pu / _K_OPT,
        "added to the\nlaw's k / $K_{opt}$ [–]": lambda run: run.offset_pu / _K_OPT,
        "τ [s]": lambda run: run.time_constant_s,
    }
    apart = _groups_differ(policy)
    figure = new_figure(DOUBLE_COLUMN_MM, 128.0)
    grid = figure.subplots(4, len(_SEEN), sharex="col", sharey="row", height_ratios=(1.0, 1.0, 1.0, 0.4))
    for column, (seen, x_of) in enumerate(_SEEN.items()):
        edges = _edges([x_of(run) for run in runs.values()])
        for row, (label, y_of) in enumerate(used.items()):
            axes = grid[row, column]
            for own, run in runs.items():
                _draw_bins(axes, binned(x_of(run), y_of(run), edges), looks[own], with_median=own != name or not apart)
            if apart:
                for group, style in zip(range(policy.n_wtg), GROUP_STYLES, strict=False):
                    bins = binned(x_of(policy)[:, :, group], y_of(policy)[:, :, group], edges)
                    axes.plot(bins.centre, bins.median, style, color=looks[name].colour, linewidth=1.0)
            if column == 0:
                axes.set_ylabel(label)
        for own, run in runs.items():
            counts = np.histogram(x_of(run), edges)[0] / np.isfinite(x_of(run)).sum()
            grid[3, column].stairs(100.0 * counts, edges, color=looks[own].colour, linewidth=0.9)
        grid[3, column].set_xlabel(seen)
        grid[3, column].set_xlim(edges[0], edges[-1])
    grid[3, 0].set_ylabel("samples\n[% per bin]")
    grid[3, 0].set_ylim(bottom=0.0)
    _scale_time_constant(grid[2, 0], [policy.time_constant_s, reference.time_constant_s])
    figure.align_ylabels(grid[:, 0])
    # Dashes tell groups apart here, so that the legend shows colours only.
    solid = {own: Look(looks[own].colour) for own in runs}
    _draw_legend(figure, runs, solid, policy.n_wtg if apart else 1)
    return figure


def _groups_differ(policy: Recording) -> bool:
    """Whether groups lie apart by a quarter of their scatter, at the same value of whatever is seen."""
    if not 1 < policy.n_wtg <= len(GROUP_STYLES):
        return False
    for y in (policy.offset_pu, np.log(policy.time_constant_s)):
        scatter = float(np.nanstd(y)) if np.isfinite(y).any() else 0.0
        # One quantity that explains the difference is enough: groups see different winds.
        least = min(_distance_of_groups(x_of(policy), y) for x_of in _SEEN.values())
        if least > _GROUPS_APART * scatter > 1e-9:
            return True
    return False


def _distance_of_groups(x: Floats, y: Floats) -> float:
    """Return the root mean square of how far the groups' mean y lie from each other at the same x.

    Args:
        x, y: samples (n_scenarios, n, n_wtg).
    """
    edges = _edges([x])
    finite = np.isfinite(x) & np.isfinite(y)
    rows = [
        (np.histogram(x[..., g][finite[..., g]], edges, weights=w)[0])
        for g in range(x.shape[2])
        for w in (None, y[..., g][finite[..., g]])
    ]
    counts, sums = np.array(rows[::2], dtype=np.float64), np.array(rows[1::2])
    counts, sums = (each[:, (counts >= _LEAST_SAMPLES).all(axis=0)] for each in (counts, sums))
    if counts.size == 0:
        return 0.0
    return float(np.sqrt(np.average((sums / counts).var(axis=0), weights=counts.sum(axis=0))))


def _edges(samples: Sequence[Floats]) -> Floats:
    values = np.concatenate([each[np.isfinite(each)] for each in samples])
    low, high = np.quantile(values, [0.5 - 0.5 * _DRAWN, 0.5 + 0.5 * _DRAWN])
    if not low < high:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, _N_BINS + 1)


def _draw_bins(axes: Axes, bins: Bins, look: Look, *, with_median: bool) -> None:
    axes.fill_between(bins.centre, bins.low, bins.high, color=look.colour, alpha=0.2, linewidth=0.0)
    if with_median:
        axes.plot(bins.centre, bins.median, color=look.colour, linewidth=1.2)


def _scale_time_constant(axes: Axes, values: Sequence[Floats]) -> None:
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


def _draw_legend(
    figure: Figure, names: Iterable[str], looks: Mapping[str, Look], n_groups: int = 1, linewidth: float = 1.6
) -> None:
    """Draw a legend of entries and, where there is more than one, of groups by their dashes."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=looks[name].colour, linestyle=looks[name].dashes, linewidth=linewidth, label=_label(name))
        for name in names
    ]
    if n_groups > 1:
        styles = enumerate(GROUP_STYLES[:n_groups], start=1)
        handles += [Line2D([], [], color="0.3", linestyle=style, label=f"WTG group {group}") for group, style in styles]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(4, len(handles)), handlelength=3.0)


def _label(name: str) -> str:
    return f"reference ({name})" if name == REFERENCE_STRATEGY else name


@printed
def plot_runs(
    scenario: Scenario, runs: Mapping[str, Sequence[Recording]], looks: Mapping[str, Look] | None = None
) -> Figure:
    """Draw frequency, power, tip-speed ratio, k and τ of each WTG group over time, one column per group.

    A cross marks where a run ended before its time. Wind is drawn where it changes. Grey lines: λ_opt, λ_pr, overload.

    Args:
        scenario: what happened.
        runs: recordings of this one scenario by entry; an entry with several training seeds has several.
        looks: of the entries by name; None for ones of their own.

    Raises:
        ValueError: there is no run, or there are more than four groups.
    """
    if not any(runs.values()):
        raise ValueError("there is no run to plot")
    first = next(recordings[0] for recordings in runs.values() if recordings)
    if first.n_wtg > _LARGEST_NUMBER_OF_GROUPS:
        raise ValueError(f"runs are drawn of 1 … {_LARGEST_NUMBER_OF_GROUPS} WTG groups, got {first.n_wtg}")
    looks = looks or strategy_looks(runs)
    # Wind is the same for all: the longest run shows most of it.
    longest = max((run for each in runs.values() for run in each), key=lambda run: int(np.isfinite(run.wind_m_s).sum()))
    n_rows = len(_OVER_TIME) + bool(np.nanstd(longest.wind_m_s[0], axis=0).max() > 1e-9)
    width = DOUBLE_COLUMN_MM if first.n_wtg > 1 else SINGLE_COLUMN_MM
    figure = new_figure(width, 30.0 + 32.0 * n_rows)
    grid = figure.subplots(n_rows, first.n_wtg, sharex=True, sharey="row", squeeze=False)
    for group in range(first.n_wtg):
        wind = float(np.nanmean(longest.wind_m_s[0, :, group]))
        letter_panel(grid[0, group], "abcd"[group], f"GFM-WTG {group + 1} (mean wind {wind:.3g} m/s)")
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
    _draw_limits(grid)
    _scale_time_constant(grid[4, 0], [run.time_constant_s for each in runs.values() for run in each])
    grid[0, 0].set_xlim(0.0, float(first.time_s[-1]))
    for axes in grid.ravel():
        _thin(axes)
    figure.align_ylabels(grid[:, 0])
    _draw_legend(figure, runs, looks)
    explain_events(figure, scenario)
    return figure


_OVER_TIME: dict[str, Quantity] = {
    "frequency [Hz]": lambda run: np.repeat(run.frequency_hz[:, :, None], run.n_wtg, axis=2),
    "power p [p.u.]": lambda run: run.power_pu,
    "tip-speed ratio λ [–]": lambda run: run.tip_speed_ratio,
    "k / $K_{opt}$ [–]": lambda run: run.coefficient_pu / _K_OPT,
    "τ [s]": lambda run: run.time_constant_s,
}


def _draw_run(axes: Axes, time: Floats, values: Floats, look: Look, name: str, n_seeds: int) -> None:
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
    """Leave out the points of long lines that nobody would miss, so that files stay small."""
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


def _draw_limits(grid: npt.NDArray[Any]) -> None:
    """Draw the limits of power and tip-speed ratio that are in sight, named at the last column."""
    control = GridFormingParameters()
    limits = {
        1: {"overload": control.overload_limit_pu},
        2: {
            r"$\lambda_{opt}$": tracking_point(0.0).tip_speed_ratio,
            r"$\lambda_{pr}$": tracking_point(control.deloading_limit).tip_speed_ratio,
        },
    }
    for row, named in limits.items():
        share_limits(list(grid[row]))
        low, high = grid[row, 0].get_ylim()
        for name, value in named.items():
            if low < value < high:
                for axes in grid[row]:
                    axes.axhline(value, color=REFERENCE_GREY, linewidth=0.7, linestyle=_THIN_DASHES, zorder=2.0)
                name_at_right(grid[row, -1], name, value)


@printed
def plot_costs(
    costs: Mapping[str, Mapping[str, float]], looks: Mapping[str, Look] | None = None, suite: str = ""
) -> Figure:
    """Draw the mean cost of an episode, the total and term by term, one bar per entry.

    Args:
        costs: by entry and term; every entry has the same terms. A term that nobody pays is left out.
        looks: of the entries by name; None for ones of their own.
        suite: where the costs come from, for the axis.

    Raises:
        ValueError: there is no entry.
    """
    if not costs:
        raise ValueError("there is no entry whose costs could be drawn")
    looks = looks or strategy_looks(costs)
    terms = [term for term in next(iter(costs.values())) if any(own[term] > 0.0 for own in costs.values())]
    rows = {"total": {name: sum(own.values()) for name, own in costs.items()}}
    rows |= {term: {name: own[term] for name, own in costs.items()} for term in terms}
    n = len(costs)
    figure = new_figure(DOUBLE_COLUMN_MM, 24.0 + len(rows) * (3.0 + 3.4 * n))
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
            fontsize=SMALL_PT,
        )
    axes.set_yticks(range(len(rows)), ["RoCoF" if term == "rocof" else term for term in rows])
    axes.tick_params(axis="y", length=0.0)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(False, axis="y")
    axes.margins(x=0.08)
    axes.set_xlabel(f"mean cost of an episode{suite and f' of {suite}'} [–]")
    _draw_legend(figure, costs, {name: Look(looks[name].colour) for name in costs}, linewidth=5.0)
    return figure
