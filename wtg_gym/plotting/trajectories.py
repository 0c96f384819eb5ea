"""The figure of recorded runs of one scenario under several laws; marks of events and ends over time."""

import itertools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym.envs.rendering import undone
from wtg_gym.physics import protection, tracking_law, trajectory
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Event, Scenario
from wtg_gym.plotting import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Most WTG groups that are drawn, and the width of a column at the least [mm].
_MOST_COLUMNS, _COLUMN_MM = 4, 70.0
#: Instants closer than this, as a share of the time axis, share a label, for theirs would overprint.
_LABEL_WIDTH = 0.05
#: Most characters of a line of events.
_LINE_LENGTH = 100
#: What is drawn of the WTG groups, each (n, n_wtg), by its label.
_PANELS: Mapping[str, Callable[[trajectory.Trajectory], Floats]] = {
    "frequency [Hz]": lambda run: run.wtg_frequency_hz,
    "power [p.u.]": lambda run: run.power_pu,
    "rotor speed [p.u.]": lambda run: run.rotor_speed_pu,
    "coefficient k [p.u.]": lambda run: run.coefficient_pu,
}


@style.printed
def plot_trajectories(runs: Mapping[str, trajectory.Trajectory], scenario: Scenario) -> "Figure":
    """Draw frequency, power, rotor speed and k of the first four WTG groups, a column each, in runs by their labels.

    The reference law is drawn on top and thick; a cross marks where a run ended before its time; events are
    numbered and explained above.
    """
    n_columns = min(next(iter(runs.values())).power_pu.shape[1], _MOST_COLUMNS)
    figure = style.new_figure(max(style.DOUBLE_COLUMN_MM, _COLUMN_MM * n_columns), 178.0)
    grid = figure.subplots(4, n_columns, sharex=True, squeeze=False, height_ratios=(1.0, 1.15, 1.15, 0.85))
    looks = style.law_looks(runs)
    for group in range(n_columns):
        style.letter_panel(grid[0, group], "abcd"[group], f"WTG group {1 + group}")
        for axes, (label, values) in zip(grid[:, group], _PANELS.items(), strict=True):
            for name, run in runs.items():
                width, order = (1.7, 3.5) if name == tracking_law.REFERENCE_LAW else (1.0, 3.0)
                failed, line = run.status != protection.Status.RUNNING, {"linewidth": width, "zorder": order}
                draw_run(axes, run.time_s, values(run)[:, group], looks[name], failed=failed, label=name, **line)
            mark_instants(axes, scenario, numbered=axes is grid[0, group])
            if group == 0:
                axes.set_ylabel(label)
        grid[3, group].set_xlabel("time [s]")
    grid[0, 0].set_xlim(0.0, scenario.duration_s)
    for row in (grid[0], grid[3]):
        limits = [axes.get_ylim() for axes in row]
        for axes in row:
            axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    statuses = sorted({run.status for run in runs.values()} - {protection.Status.RUNNING})
    if reasons := " or ".join(status.name.lower().replace("_", " ") for status in statuses):
        grid[0, 0].plot([], [], "x", color="0.25", markeredgewidth=1.4, label=reasons)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), handlelength=3.6)
    explain_events(figure, scenario)
    return figure


def _by_instant(scenario: Scenario) -> list[list[Event]]:
    events = sorted((e for e in scenario.events if e.time_s <= scenario.duration_s), key=lambda e: e.time_s)
    return [list(group) for _, group in itertools.groupby(events, key=lambda e: e.time_s)]


def mark_instants(axes: "Axes", scenario: Scenario, *, numbered: bool) -> None:
    """Draw a dotted line at every event, with its number above if `numbered`, and where a line closes again."""
    instants = [events[0].time_s for events in _by_instant(scenario)]
    for instant in (*instants, *(event.end_s for event in undone(scenario.events, scenario.duration_s))):
        axes.axvline(instant, color=style.REFERENCE_GREY, linewidth=0.7, linestyle=(0.0, (1.0, 1.5)), zorder=1)
    apart = 1 + np.flatnonzero(np.diff(instants) >= _LABEL_WIDTH * scenario.duration_s)
    for group in np.split(np.arange(len(instants)), apart) if numbered and instants else ():
        place, numbers = sum(instants[i] for i in group) / len(group), ", ".join(str(1 + i) for i in group)
        above = axes.get_xaxis_transform()
        axes.text(place, 1.01, f"({numbers})", transform=above, fontsize=style.SMALL_PT, ha="center")


def explain_events(figure: "Figure", scenario: Scenario) -> None:
    """Write the scenario's name at the top left of a figure and its numbered events at the top right."""
    lines: list[str] = []
    for number, events in enumerate(_by_instant(scenario), start=1):
        text = f"({number}) {events[0].time_s:g} s: " + " and ".join(event.words for event in events)
        if lines and len(lines[-1]) + len(text) < _LINE_LENGTH:
            # SVG shows several blanks in a row as one.
            text = f"{lines.pop()};  {text}"
        lines.append(text)
    # The layout makes room for the title only: it gets as many lines as the events beside it.
    figure.suptitle("\n".join([scenario.name, *[""] * (len(lines) - 1)]), x=0.01, ha="left")
    figure.text(0.99, 0.993, "\n".join(lines), ha="right", va="top", fontsize=style.SMALL_PT)


def draw_run(axes: "Axes", time_s: Floats, values: Floats, look: style.Look, *, failed: bool, **line: Any) -> None:
    """Draw a run's values (n,) up to the last that is a number, and a cross there if it ended before its time."""
    n = np.count_nonzero(np.isfinite(values))
    axes.plot(time_s[:n], values[:n], color=look.colour, linestyle=look.dashes, **line)
    if failed:
        axes.plot(time_s[n - 1], values[n - 1], "x", color=look.colour, markersize=5.5, markeredgewidth=1.4, zorder=4)
