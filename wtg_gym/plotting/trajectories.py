"""The figure of recorded runs of one scenario under several strategies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import coordinated_piecewise
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import draw_run, endings, explain_events, mark_instants

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: A reference line this far outside the data, in shares of their span, is still brought into view.
_REACH = 0.25


class Panel(NamedTuple):
    """One quantity."""

    label: str
    values: Callable[[Trajectory], npt.NDArray[np.float64]]  # (n,) or (n, n_wtg)
    references: Mapping[str, float] = {}  # dashed lines by their names
    shows_all_references: bool = False  # however far away


@style.printed
def plot_trajectories(
    trajectories: Mapping[str, Trajectory],
    scenario: Scenario,
    overload_pu: float = GridFormingParameters().overload_limit_pu,
) -> Figure:
    """Draw frequency, RoCoF, wind, rotor speeds, powers and tracking coefficients on a shared time axis.

    One colour per run and one dash pattern per WTG group. Events are numbered and explained above the panels. A cross
    marks where a run ended before its time.

    Args:
        trajectories: recorded runs of the scenario by label, at least one, all with the same number of WTG groups.
        scenario: what happened in them.
        overload_pu: power above which a converter counts as overloaded [p.u.].
    """
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 150.0)
    grid = figure.subplots(3, 2, sharex=True)
    panels = _panels(next(iter(trajectories.values())).nominal_frequency_hz, overload_pu)
    colours = {label: look.colour for label, look in style.strategy_looks(trajectories).items()}
    for axes, panel in zip(grid.T.flat, panels, strict=True):
        if panel.label.startswith("wind"):
            # Every run has the same wind: the longest one shows all of it.
            longest = max(trajectories.values(), key=lambda run: run.time_s.size)
            _draw_groups(axes, longest, panel.values(longest), "0.25")
        else:
            for label, run in trajectories.items():
                _draw_groups(axes, run, panel.values(run), colours[label])
        _draw_references(axes, panel)
        mark_instants(axes, scenario, numbered=axes in grid[0])
        axes.set_ylabel(panel.label)
    grid[0, 0].set_xlim(0.0, scenario.duration_s)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    explain_events(figure, scenario)
    _draw_legend(figure, trajectories, colours)
    figure.align_ylabels()
    return figure


def _panels(nominal_hz: float, overload_pu: float) -> tuple[Panel, ...]:
    """Return the panels, down the left column and then down the right one."""
    control, law = GridFormingParameters(), coordinated_piecewise()
    bounds = {
        r"$\omega_{min}$": nominal_hz * control.frequency_min_pu,
        r"$\omega_{max}$": nominal_hz * control.frequency_max_pu,
        # Beyond them the deviation costs four times as much.
        "+0.2 Hz": nominal_hz + 0.2,
        "−0.2 Hz": nominal_hz - 0.2,
    }
    coefficients = {"$K_{opt}$": law.k_min, "$K_n$": law.k_nominal, "$K_{pr}$": law.k_max}
    return (
        Panel("frequency [Hz]", lambda run: run.frequency_hz, bounds),
        Panel("RoCoF, 500 ms [Hz/s]", lambda run: run.rocof_hz_s()),
        Panel("wind speed [m/s]", lambda run: run.wind_m_s),
        Panel("rotor speed [p.u.]", lambda run: run.rotor_speed_pu),
        Panel("power [p.u.]", lambda run: run.power_pu, {"overload": overload_pu}),
        Panel("coefficient k [p.u.]", lambda run: run.coefficient_pu, coefficients, shows_all_references=True),
    )


def _draw_groups(axes: Axes, run: Trajectory, values: npt.NDArray[np.float64], colour: str) -> None:
    columns = values.reshape(run.time_s.size, -1).T
    for group, own in enumerate(columns):
        # More groups than dash patterns get thin plain lines.
        many = len(columns) > len(style.GROUP_STYLES)
        dashes, width = ("-", 0.5) if many else (style.GROUP_STYLES[group], 1.1)
        draw_run(axes, run, own, colour, linestyle=dashes, linewidth=width)
    axes.margins(y=0.08)


def _draw_references(axes: Axes, panel: Panel) -> None:
    """Draw and name those reference lines that are near the data."""
    low, high = axes.get_ylim()
    reach = np.inf if panel.shows_all_references else _REACH * (high - low)
    for name, y in panel.references.items():
        if low - reach <= y <= high + reach:
            style.draw_reference(axes, y, name)


def _draw_legend(figure: Figure, trajectories: Mapping[str, Trajectory], colours: Mapping[str, str]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colours[label], linewidth=2.0, label=label) for label in trajectories]
    n_groups = next(iter(trajectories.values())).power_pu.shape[1]
    names = {dashes: f"WTG group {group}" for group, dashes in enumerate(style.GROUP_STYLES[:n_groups], start=1)}
    if n_groups > len(style.GROUP_STYLES):
        names = {"-": f"one line per WTG group ({n_groups})"}
    handles += [Line2D([], [], color="0.25", linestyle=dashes, label=name) for dashes, name in names.items()]
    if reasons := endings(trajectories.values()):
        handles.append(Line2D([], [], color="0.25", marker="x", linestyle="none", label=f"run ended: {reasons}"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(5, len(handles)))
