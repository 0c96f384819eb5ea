"""Events and the ends of runs in figures over time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from wtg_gym.envs.rendering.diagram import undone
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Event, Scenario
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting.style import DOTS, REFERENCE_GREY, SMALL_PT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Instants closer than this, as a share of the time axis, share a label, for theirs would overprint.
_LABEL_WIDTH = 0.05
#: Most characters of a line of events.
_LINE_LENGTH = 100


def numbered_events(scenario: Scenario) -> list[tuple[str, list[Event]]]:
    """Return the events by instant, each instant with its number."""
    instants = sorted({event.time_s for event in scenario.events if event.time_s <= scenario.duration_s})
    return [
        (str(number), [event for event in scenario.events if event.time_s == instant])
        for number, instant in enumerate(instants, start=1)
    ]


def instant_labels(scenario: Scenario) -> list[tuple[float, str]]:
    """Return place [s] and number of each instant with events: "(1)", or "(1, 2)" where instants are close."""
    close: list[list[tuple[float, str]]] = []
    for number, events in numbered_events(scenario):
        instant = events[0].time_s
        if close and instant - close[-1][-1][0] < _LABEL_WIDTH * scenario.duration_s:
            close[-1].append((instant, number))
        else:
            close.append([(instant, number)])
    return [
        (sum(instant for instant, _ in group) / len(group), f"({', '.join(number for _, number in group)})")
        for group in close
    ]


def event_lines(scenario: Scenario) -> list[str]:
    """Return the numbered events in words, as many per line as fit beside the name of a scenario."""
    lines: list[str] = []
    for number, events in numbered_events(scenario):
        text = f"({number}) {events[0].time_s:g} s: " + " and ".join(event.words for event in events)
        if lines and len(lines[-1]) + len(text) < _LINE_LENGTH:
            # SVG shows several blanks in a row as one.
            text = f"{lines.pop()};  {text}"
        lines.append(text)
    return lines


def mark_instants(axes: Axes, scenario: Scenario, *, numbered: bool) -> None:
    """Draw a dotted line at every instant with an event, with its number above where `numbered`.

    One without a number is where a line closes again.
    """
    instants = [events[0].time_s for _, events in numbered_events(scenario)]
    instants += [event.end_s for event in undone(scenario.events, scenario.duration_s)]
    for instant in instants:
        axes.axvline(instant, color=REFERENCE_GREY, linewidth=0.7, linestyle=DOTS, zorder=1)
    if numbered:
        above = axes.get_xaxis_transform()
        for place, text in instant_labels(scenario):
            axes.text(place, 1.01, text, transform=above, fontsize=SMALL_PT, ha="center")


def explain_events(figure: Figure, scenario: Scenario) -> None:
    """Write the scenario's name at the top left of a figure and its numbered events at the top right."""
    lines = event_lines(scenario)
    # The layout makes room for the title only: it gets as many lines as the events beside it.
    figure.suptitle("\n".join([scenario.name, *[""] * (len(lines) - 1)]), x=0.01, ha="left")
    figure.text(0.99, 0.993, "\n".join(lines), ha="right", va="top", fontsize=SMALL_PT)


def draw_run(axes: Axes, run: Trajectory, values: Floats, colour: str, **line: Any) -> None:
    """Draw a quantity (n,) of a run over time, with a cross at its end where that came before its time."""
    axes.plot(run.time_s, values, color=colour, **line)
    if run.status != Status.RUNNING:
        mark_end(axes, float(run.time_s[-1]), float(values[-1]), colour)


def mark_end(axes: Axes, time_s: float, value: float, colour: str) -> None:
    """Draw a cross where a run ended before its time."""
    axes.plot(time_s, value, "x", color=colour, markersize=5.5, markeredgewidth=1.4, zorder=4)


def endings(runs: Iterable[Trajectory]) -> str:
    """Return why runs ended before their time: "stall", "stall or over speed"; empty where none did."""
    reasons = {run.status for run in runs} - {Status.RUNNING}
    return " or ".join(reason.name.lower().replace("_", " ") for reason in sorted(reasons))
