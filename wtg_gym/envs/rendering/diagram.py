"""The single-line diagram of the grid with its WTG groups and events, and events in words."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from wtg_gym.envs.rendering.colours import EVENT, INK, PAGE, SOFT, group_colour
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.scenario import Event, GovernorLoss, GroupTrip, LineTrip, LoadRamp, LoadTrip, MachineOutage

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Where the buses are drawn.
BUS_PLACES: Mapping[int, tuple[float, float]] = {
    1: (0.3, 1.6),
    2: (2.2, 0.5),
    3: (7.6, 0.3),
    4: (6.0, 1.8),
    5: (3.2, 1.8),
    6: (3.0, 3.6),
    7: (7.4, 2.6),
    8: (9.0, 2.6),
    9: (6.6, 3.6),
    10: (5.6, 4.5),
    11: (4.2, 4.5),
    12: (0.9, 4.5),
    13: (2.6, 5.4),
    14: (6.6, 5.4),
}
#: What the diagram covers, in the same units.
EXTENT = ((-0.6, 9.8), (-0.9, 6.1))
#: The groups of one bus stand within this; many of them overlap.
_GROUPS_WIDTH = 4.4
_OPENED: Mapping[str, Any] = {"linewidth": 2.5, "linestyle": (0, (1.6, 1.2))}
#: Behind numbers, for a line may run there.
_PLATE: Mapping[str, Any] = {"facecolor": PAGE, "edgecolor": "none", "pad": 0.8}


def draw_diagram(
    axes: Axes,
    group_buses: Sequence[int],
    events: Sequence[Event],
    closed: Collection[LineTrip] = (),
    colour_of: Callable[[int], str] = group_colour,
) -> None:
    """Draw the diagram.

    Args:
        axes: empty; its limits become :data:`EXTENT`.
        group_buses: bus of each WTG group.
        events: those that have struck; they are numbered in this order.
        closed: those whose line is closed again, see :func:`reclosed`.
        colour_of: colour of each WTG group.
    """
    axes.set_axis_off()
    axes.set_xlim(*EXTENT[0])
    axes.set_ylim(*EXTENT[1])
    case = modified_ieee14()
    opened = {
        frozenset((event.from_bus, event.to_bus))
        for event in events
        if isinstance(event, LineTrip) and event not in closed
    }
    for branch in case.branches:
        (x0, y0), (x1, y1) = BUS_PLACES[branch.from_bus], BUS_PLACES[branch.to_bus]
        if frozenset((branch.from_bus, branch.to_bus)) in opened:
            axes.plot([x0, x1], [y0, y1], color=EVENT, **_OPENED)
        else:
            axes.plot([x0, x1], [y0, y1], color=SOFT, linewidth=1.0)
    # The machine with a governor is the generator; the others are condensers.
    machines = {machine.bus: "G" if machine.governor is not None else "C" for machine in case.machines}
    stopped = {event.bus for event in events if isinstance(event, GovernorLoss)}
    out = {event.bus for event in events if isinstance(event, MachineOutage)}
    tripped = {event.group for event in events if isinstance(event, GroupTrip)}
    for number, (x, y) in BUS_PLACES.items():
        groups = [group for group, bus in enumerate(group_buses) if bus == number]
        n_units = len(groups) + (number in machines)
        gap = min(0.8, _GROUPS_WIDTH / max(1, n_units - 1))
        half = max(0.45, 0.5 * gap * (n_units - 1) + 0.15)
        first = -0.5 * gap * (n_units - 1)
        if number in machines:
            colour = EVENT if number in stopped else INK
            _draw_unit(axes, number, first if groups else -0.35, machines[number], colour, is_out=number in out)
            first += gap
        for place, group in enumerate(groups):
            beside, colour = first + gap * place, colour_of(group)
            _draw_unit(axes, number, beside, f"W{group + 1}", colour, is_out=group in tripped)
        axes.plot([x - half, x + half], [y, y], color=INK, linewidth=3.0, solid_capstyle="butt")
        axes.text(x + half - 0.03, y + 0.08, str(number), fontsize=10, color=INK, va="bottom", bbox=_PLATE)
    _draw_strikes(axes, group_buses, events)


def _draw_unit(axes: Axes, bus: int, beside: float, text: str, colour: str, *, is_out: bool) -> None:
    x, y = BUS_PLACES[bus]
    x += beside
    if is_out:
        axes.plot([x, x], [y, y - 0.85], color=EVENT, **_OPENED)
    else:
        axes.plot([x, x], [y, y - 0.85], color=colour, linewidth=1.0)
    axes.plot([x], [y - 0.85], "o", markersize=18, markerfacecolor=PAGE, markeredgecolor=colour, markeredgewidth=1.4)
    axes.text(x, y - 0.87, text, fontsize=9, color=colour, ha="center", va="center")


def _draw_strikes(axes: Axes, group_buses: Sequence[int], events: Sequence[Event]) -> None:
    struck: dict[int, list[str]] = {}
    for number, event in enumerate(events, start=1):
        for bus in struck_buses(event, group_buses):
            struck.setdefault(bus, []).append(str(number))
    for bus, numbers in struck.items():
        x, y = BUS_PLACES[bus]
        axes.plot([x], [y], "o", markersize=20, markerfacecolor="none", markeredgecolor=EVENT, markeredgewidth=2.0)
        style: dict[str, Any] = {
            "fontsize": 10,
            "fontweight": "bold",
            "color": EVENT,
            "ha": "right",
            "va": "bottom",
            "zorder": 5,
        }
        axes.text(x - 0.35, y + 0.25, ", ".join(numbers), bbox=_PLATE, **style)


def reclosed(events: Sequence[Event], now_s: float) -> tuple[LineTrip, ...]:
    """Return the events whose line is closed again at an instant [s]."""
    return tuple(
        event
        for event in events
        if isinstance(event, LineTrip) and event.recloses_after_s is not None and event.end_s <= now_s
    )


def struck_buses(event: Event, group_buses: Sequence[int]) -> list[int]:
    """Return the buses that an event strikes, both ends of a line; given the bus of each WTG group."""
    if isinstance(event, LineTrip):
        return [event.from_bus, event.to_bus]
    return [group_buses[event.group] if isinstance(event, GroupTrip) else event.bus]


def describe_event(event: Event) -> str:
    """Return an event in words, with its units, without its instant; WTG groups count from 1."""
    if isinstance(event, LineTrip):
        again = "" if event.recloses_after_s is None else f" for {event.recloses_after_s:g} s"
        return f"line {event.from_bus}–{event.to_bus} opens{again}"
    if isinstance(event, LoadTrip):
        return f"load of bus {event.bus} lost"
    if isinstance(event, GovernorLoss):
        return f"governor at bus {event.bus} lost"
    if isinstance(event, MachineOutage):
        return f"machine at bus {event.bus} disconnected"
    if isinstance(event, GroupTrip):
        return f"WTG group {event.group + 1} disconnected"
    text = f"{event.power_mw:+g} MW"
    if event.reactive_mvar:
        text += f", {event.reactive_mvar:+g} Mvar"
    text = text.replace("-", "−")
    text += f" at bus {event.bus}"
    if isinstance(event, LoadRamp):
        text += f" over {event.duration_s:g} s"
    return text
