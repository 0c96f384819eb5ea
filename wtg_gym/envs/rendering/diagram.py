"""The single-line diagram of the grid with its WTG groups and events, and events in words."""

import functools
import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from wtg_gym.extras import install_advice
from wtg_gym.physics.grid import NetworkCase
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Event, Fault, GovernorLoss, GroupTrip, LineTrip, MachineOutage, ReactanceStep

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAGE, INK, SOFT, LINE, GRID = "#ffffff", "#1b2128", "#55606c", "#d5dbe1", "#e7ebef"
EVENT = "#a8276b"  # and the end of an episode that failed
#: One per WTG group; further groups begin again.
GROUPS = ("#0063a6", "#c14a00", "#00724f", "#7a5ab8")
LIMIT = "#c98aa9"  # beyond which a run fails, or that converters keep
BAND = "#eef6f2"  # shaded ranges of values
#: Width and height that the places of buses are scaled to, and buses that symbols and numbers of full size suit.
_WIDTH, _HEIGHT, _N_BUSES = 8.7, 5.1, 14
#: The units of one bus stand within this.
_UNITS_WIDTH = 4.4
_OPENED: Mapping[str, Any] = {"color": EVENT, "linewidth": 2.5, "linestyle": (0, (1.6, 1.2))}
#: Behind numbers, for a line may run there.
_PLATE: Mapping[str, Any] = {"facecolor": PAGE, "edgecolor": "none", "pad": 0.8}


def group_colour(group: int) -> str:
    """Return the colour of a WTG group."""
    return GROUPS[group % len(GROUPS)]


@functools.lru_cache(maxsize=16)
def bus_places(case: NetworkCase) -> Mapping[int, tuple[float, float]]:
    """Return where the buses are drawn, by their numbers: as the case says, or laid out so that no lines are long."""
    placed = {bus.number: (bus.x, bus.y) for bus in case.buses if bus.x is not None and bus.y is not None}
    if len(placed) < len(case.buses):
        try:
            import networkx
        except ImportError as error:
            raise DependencyNotInstalled(f"this grid's places need networkx; {install_advice('render')}") from error
        placed = networkx.kamada_kawai_layout(networkx.Graph((b.from_bus, b.to_bus) for b in case.branches))
    points = np.array([placed[bus.number] for bus in case.buses], dtype=np.float64)
    low, span = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
    scaled = ((points - low) / span * (_WIDTH, _HEIGHT) + (0.3, 0.3)).tolist()
    return {bus.number: (x, y) for bus, (x, y) in zip(case.buses, scaled, strict=True)}


def draw_diagram(axes: "Axes", plant: Plant, events: Sequence[Event], over: Collection[Event] = ()) -> None:
    """Draw the diagram into empty axes, with the events that have struck, numbered, of which some are undone."""
    group_buses, places = [group.bus for group in plant.groups], bus_places(plant.case)
    size = min(1.0, math.sqrt(_N_BUSES / len(places)))
    axes.set_axis_off()
    axes.set(xlim=(-0.6, 9.8), ylim=(-0.9, 6.1))
    lasting = [e for e in events if e not in over]
    opened = [{e.from_bus, e.to_bus} for e in lasting if isinstance(e, LineTrip)]
    opened += [set(e.opens) for e in lasting if isinstance(e, Fault) and e.opens is not None]
    for branch in plant.case.branches:
        ends = np.array([places[branch.from_bus], places[branch.to_bus]])
        is_open = {branch.from_bus, branch.to_bus} in opened
        axes.plot(*ends.T, **(_OPENED if is_open else {"color": SOFT, "linewidth": 1.0}))
    for bus, (x, y) in places.items():
        units = _units(bus, plant, lasting)
        gap = size * min(0.8, _UNITS_WIDTH / max(1, len(units) - 1))
        first = -0.5 * gap * (len(units) - 1) - (0.35 * size if [name for name, *_ in units] in (["G"], ["C"]) else 0.0)
        for place, (name, colour, is_out) in enumerate(units):
            at, centre = x + first + gap * place, y - 0.85 * size
            axes.plot([at, at], [y, centre], **(_OPENED if is_out else {"color": colour, "linewidth": 1.0}))
            ring: Any = {"markerfacecolor": PAGE, "markeredgecolor": colour, "markeredgewidth": 1.4}
            axes.plot(at, centre, "o", markersize=18 * size, **ring)
            axes.text(at, centre - 0.02 * size, name, fontsize=9 * size, color=colour, ha="center", va="center")
        half = max(0.45 * size, 0.5 * gap * (len(units) - 1) + 0.15 * size)
        axes.plot([x - half, x + half], [y, y], color=INK, linewidth=3.0 * size, solid_capstyle="butt")
        axes.text(x + half - 0.03, y + 0.08 * size, str(bus), fontsize=10 * size, color=INK, va="bottom", bbox=_PLATE)
    for bus, (x, y) in places.items():
        numbers = [str(n) for n, event in enumerate(events, start=1) if bus in _struck_buses(event, group_buses)]
        if numbers:
            axes.plot(
                x, y, "o", markersize=20 * size, markerfacecolor="none", markeredgecolor=EVENT, markeredgewidth=2.0
            )
            words = axes.text(x - 0.35, y + 0.25, ", ".join(numbers), color=EVENT, ha="right", bbox=_PLATE, zorder=5)
            words.set(fontsize=10, fontweight="bold")


def _units(bus: int, plant: Plant, events: Sequence[Event]) -> list[tuple[str, str, bool]]:
    """Return name, colour and whether it is disconnected of every unit of a bus."""
    units = []
    for machine in plant.case.machines:
        if machine.bus == bus:
            # The machine with a governor is the generator; the others are condensers.
            colour = EVENT if any(isinstance(e, GovernorLoss) and e.bus == bus for e in events) else INK
            is_out = any(isinstance(e, MachineOutage) and e.bus == bus for e in events)
            units.append(("C" if machine.governor is None else "G", colour, is_out))
    for j, group in enumerate(plant.groups):
        if group.bus == bus:
            is_out = any(isinstance(e, GroupTrip) and e.group == j for e in events)
            units.append((f"W{j + 1}", group_colour(j), is_out))
    return units


def undone(events: Sequence[Event], now_s: float) -> tuple[Event, ...]:
    """Return the events whose line is closed again at an instant [s]."""
    return tuple(e for e in events if isinstance(e, LineTrip) and e.time_s < e.end_s <= now_s)


def _struck_buses(event: Event, group_buses: Sequence[int]) -> list[int]:
    """Return the buses that an event strikes, both ends of a line; given the bus of each WTG group."""
    if isinstance(event, (LineTrip, ReactanceStep)):
        return [event.from_bus, event.to_bus]
    return [group_buses[event.group] if isinstance(event, GroupTrip) else event.bus]
