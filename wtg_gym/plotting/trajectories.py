"""Recorded runs side by side, as a figure for the screen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import coordinated_piecewise
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting.event_marks import endings, event_lines, instant_labels, numbered_events
from wtg_gym.plotting.style import GROUP_STYLES, OVERLOAD_PU, LineStyle, name_at_right, strategy_looks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "0.45"
_FONT = {"title": 12.0, "label": 10.0, "small": 8.5}
#: A reference line this far outside the data, in shares of their span, is still brought into view.
_REACH = 0.25


class _Panel(NamedTuple):
    """One quantity: axis label, one (n,) or (n, n_wtg) series per run, and reference lines by name."""

    label: str
    series: Mapping[str, npt.NDArray[np.float64]]
    references: Mapping[str, float] = {}
    #: A lightly shaded range of values.
    band: tuple[float, float] | None = None
    #: Bring every reference line into view, however far away.
    shows_all_references: bool = False


def plot_trajectories(
    trajectories: Mapping[str, Trajectory], scenario: Scenario, overload_pu: float = OVERLOAD_PU
) -> Figure:
    """Draw frequency, RoCoF, wind, rotor speeds, powers and tracking coefficients on a shared time axis.

    One colour per run and one dash pattern per WTG group. Events are numbered and explained above the panels. A cross
    marks where a run ended before its time.

    Args:
        trajectories: recorded runs of the scenario by label, at least one, all with the same number of WTG groups.
        scenario: what happened in them.
        overload_pu: power above which a converter counts as overloaded [p.u.].

    Returns:
        The figure, with an Agg canvas: `figure.savefig("run.pdf")` writes it in any format of matplotlib.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    colours = {label: look.colour for label, look in strategy_looks(trajectories).items()}
    figure = Figure(figsize=(11.5, 9.0), facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(3, 2, sharex=True, height_ratios=(1.15, 1.2, 0.9))
    panels = _panels(trajectories, overload_pu)
    for column in range(2):
        for row in range(3):
            _draw_panel(grid[row, column], panels[3 * column + row], trajectories, colours)
            _mark_events(grid[row, column], scenario, numbered=row == 0)
        grid[2, column].set_xlabel("time [s]", fontsize=_FONT["label"])
    _draw_wind(grid[2, 0], trajectories)
    grid[0, 0].set_xlim(0.0, scenario.duration_s)
    events = event_lines(scenario)
    n_legend_rows = _draw_legend(figure, trajectories, colours)
    top = 0.925 - 0.021 * len(events)
    figure.subplots_adjust(
        left=0.075, right=0.938, top=top, bottom=0.085 + 0.026 * n_legend_rows, wspace=0.32, hspace=0.1
    )
    figure.text(0.075, 0.975, scenario.name, fontsize=_FONT["title"], fontweight="bold", va="top")
    if events:
        figure.text(0.075, 0.945, "\n".join(events), fontsize=_FONT["small"], va="top", linespacing=1.35)
    figure.align_ylabels()
    return figure


def _panels(trajectories: Mapping[str, Trajectory], overload_pu: float) -> tuple[_Panel, ...]:
    """The six panels, down the left column and then down the right one."""
    control, law = GridFormingParameters(), coordinated_piecewise()
    nominal = next(iter(trajectories.values())).nominal_frequency_hz
    omega = {
        r"$\omega_{min}$": nominal * control.frequency_min_pu,
        r"$\omega_{max}$": nominal * control.frequency_max_pu,
    }
    coefficients = {"$K_{opt}$": law.k_min, "$K_n$": law.k_nominal, "$K_{pr}$": law.k_max}

    def series(quantity: Callable[[Trajectory], npt.NDArray[np.float64]]) -> dict[str, npt.NDArray[np.float64]]:
        return {label: quantity(run) for label, run in trajectories.items()}

    return (
        _Panel("frequency [Hz]", series(lambda run: run.frequency_hz), omega, band=(nominal - 0.2, nominal + 0.2)),
        _Panel("RoCoF, 500 ms [Hz/s]", series(lambda run: run.rocof_hz_s()), {"": 0.0}),
        _Panel("wind speed [m/s]", {}),
        _Panel("rotor speed [p.u.]", series(lambda run: run.rotor_speed_pu)),
        _Panel("power [p.u.]", series(lambda run: run.power_pu), {"overload": overload_pu}),
        _Panel("coefficient k [p.u.]", series(lambda run: run.coefficient_pu), coefficients, shows_all_references=True),
    )


def _draw_panel(axes: Axes, panel: _Panel, trajectories: Mapping[str, Trajectory], colours: Mapping[str, str]) -> None:
    for label, values in panel.series.items():
        run, colour = trajectories[label], colours[label]
        columns = values[:, None] if values.ndim == 1 else values
        for group, column in enumerate(columns.T):
            style, width = line_of_group(group, columns.shape[1])
            axes.plot(run.time_s, column, style, color=colour, linewidth=width)
            if run.status != Status.RUNNING:
                axes.plot(run.time_s[-1], column[-1], "x", color=colour, markersize=7, markeredgewidth=1.8, zorder=5)
    low, high = axes.get_ylim()
    reach = (high - low) * (np.inf if panel.shows_all_references else _REACH)
    shown = {name: y for name, y in panel.references.items() if low - reach <= y <= high + reach}
    for name, y in shown.items():
        axes.axhline(y, color=_GREY, linewidth=0.9, linestyle=(0, (5, 3)) if name else "-", zorder=1)
        low, high = min(low, y - 0.03 * (high - low)), max(high, y + 0.03 * (high - low))
    axes.set_ylim(low, high)
    for name, y in shown.items():
        name_at_right(axes, name, y, size_pt=_FONT["small"])
    if panel.band is not None:
        axes.axhspan(*panel.band, color="#009E73", alpha=0.08, linewidth=0, zorder=0)
        for edge in panel.band:
            if low < edge < high:
                middle = 0.5 * (panel.band[0] + panel.band[1])
                name_at_right(axes, f"{edge - middle:+.1f} Hz".replace("-", "−"), edge, size_pt=_FONT["small"])
    axes.set_ylabel(panel.label, fontsize=_FONT["label"])
    axes.tick_params(labelsize=_FONT["small"] + 0.5)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(True, color="0.9", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _draw_wind(axes: Axes, trajectories: Mapping[str, Trajectory]) -> None:
    # Every run has the same wind: the longest one shows all of it.
    run = max(trajectories.values(), key=lambda run: run.time_s.size)
    n_groups = run.wind_m_s.shape[1]
    for group in range(n_groups):
        style, width = line_of_group(group, n_groups)
        axes.plot(run.time_s, run.wind_m_s[:, group], style, color="0.25", linewidth=width)
    axes.autoscale(axis="y")
    axes.margins(y=0.15)


def line_of_group(group: int, n_groups: int) -> tuple[LineStyle, float]:
    """Return dashes and width of a group's lines [pt]; more groups than dash patterns get thin plain lines."""
    return (GROUP_STYLES[group], 1.5) if n_groups <= len(GROUP_STYLES) else ("-", 0.7)


def _mark_events(axes: Axes, scenario: Scenario, *, numbered: bool) -> None:
    for _, events in numbered_events(scenario):
        start = events[0].time_s
        axes.axvline(start, color=_GREY, linewidth=0.8, linestyle=":", zorder=1)
        for event in events:
            end = min(event.end_s, scenario.duration_s)
            if end > start:
                axes.axvspan(start, end, color="0.5", alpha=0.08, linewidth=0, zorder=0)
    if numbered:
        where = axes.get_xaxis_transform()
        for place, text in instant_labels(scenario):
            axes.text(place, 1.02, text, transform=where, fontsize=_FONT["small"], ha="center", va="bottom")


def _draw_legend(figure: Figure, trajectories: Mapping[str, Trajectory], colours: Mapping[str, str]) -> int:
    """Draw the legend below the panels; return its number of rows."""
    from matplotlib.lines import Line2D

    n_groups = next(iter(trajectories.values())).power_pu.shape[1]
    handles = [Line2D([], [], color=colours[label], linewidth=2.2, label=label) for label in trajectories]
    if n_groups <= len(GROUP_STYLES):
        styles: list[tuple[LineStyle, str]] = [
            (GROUP_STYLES[group], f"WTG group {group + 1}") for group in range(n_groups)
        ]
    else:
        styles = [("-", f"one line per WTG group ({n_groups})")]
    handles += [Line2D([], [], color="0.25", linestyle=style, label=label) for style, label in styles]
    reasons = endings(trajectories.values())
    if reasons:
        cross = Line2D([], [], color="0.25", marker="x", linestyle="none", markersize=7.0, markeredgewidth=1.8)
        cross.set_label(f"run ended: {reasons}")
        handles.append(cross)
    n_columns = min(5, len(handles))
    figure.legend(
        handles=handles,
        loc="lower center",
        ncols=n_columns,
        frameon=False,
        fontsize=_FONT["label"] - 0.5,
        bbox_to_anchor=(0.5, 0.005),
        handlelength=2.6,
    )
    return -(-len(handles) // n_columns)
