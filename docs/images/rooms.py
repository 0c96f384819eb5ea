"""`python docs/images/rooms.py FILE`: the rooms of the code and their imports; the way of an action and of a scenario.

The arrows between rooms are those of the source: from a room to those that it imports, without those that it also
reaches through another one. `files`, `ranges` and `progress`, which most rooms use, are left out.
"""

import ast
import functools
import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from wtg_gym.plotting.style import PALETTE, figure_bytes, printed

ROOT = Path(__file__).parents[2]
ROOMS = (
    *("agents", "baselines"),
    *(f"wtg_gym/{name}" for name in ("plotting", "cli", "evaluation")),
    *(
        f"wtg_gym/{name}"
        for name in ("sb3.py", "gains.py", "gradients", "pettingzoo.py", "policies", "envs", "scenarios", "tasks")
    ),
    *("wtg_gym/physics", "wtg_gym/systems"),
)
# File, what it does there; docs/architecture.md says more.
ACTION = (
    ("envs/gfm_wtg.py", "step"),
    ("envs/lanes.py", "all lanes, threads"),
    ("envs/stepping.py", "the lists of the task"),
    ("physics/integration.py", "one interval, events"),
    ("physics/step.py", "the list of systems"),
    ("physics/machine_unit.py", "a machine's systems"),
)
SCENARIO = (
    ("envs/lanes.py", "prepare, then start"),
    ("scenarios/suite.py", "scenario of a seed"),
    ("scenarios/distribution.py", "wind, loads, events"),
    ("physics/equilibrium.py", "power flow, states"),
    ("physics/simulator.py", "rows of the lane"),
)
_ROW = {"wtg_gym/envs": 2.6, "wtg_gym/scenarios": 1.9, "wtg_gym/physics": 2.6}


def imported(room: str) -> set[str]:
    """Return the other rooms that a room imports."""
    place = ROOT / room
    names: set[str] = set()
    for file in [place] if place.is_file() else place.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
    dotted = {other: other.removesuffix(".py").replace("/", ".") for other in ROOMS if other != room}
    return {other for other, module in dotted.items() if any(f"{name}.".startswith(f"{module}.") for name in names)}


def levels(imports: dict[str, set[str]]) -> list[list[str]]:
    """Return the rooms by level, the lowest first: a room stands above all that it imports."""

    @functools.cache
    def level(room: str) -> int:
        return max((1 + level(other) for other in imports[room]), default=0)

    return [[room for room in ROOMS if level(room) == n] for n in range(1 + max(map(level, ROOMS)))]


def nearest(imports: dict[str, set[str]]) -> Iterator[tuple[str, str]]:
    """Yield each import, as two rooms, that no chain of other imports replaces."""

    @functools.cache
    def reached(room: str) -> frozenset[str]:
        return frozenset(imports[room]).union(*map(reached, imports[room]))

    for room, others in imports.items():
        # In one order: that of a set changes from run to run, and the drawing with it.
        for other in sorted(others):
            if not any(other in reached(via) for via in others - {other}):
                yield room, other


def box(axes: Axes, x: float, y: float, text: str, colour: str, size: float) -> Annotation:
    """Write a text in a box."""
    frame = {"boxstyle": "round,pad=0.35", "facecolor": "white", "edgecolor": colour, "linewidth": 0.8}
    return axes.annotate(text, (x, y), ha="center", va="center", bbox=frame, fontsize=size)


def arrow(axes: Axes, start: Annotation, end: Annotation, colour: str) -> None:
    """Draw an arrow from box to box."""
    how = {"arrowstyle": "-|>", "color": colour, "linewidth": 0.9, "mutation_scale": 7}
    how |= {"patchA": start.get_bbox_patch(), "patchB": end.get_bbox_patch(), "shrinkA": 1.0, "shrinkB": 1.0}
    axes.annotate("", end.xy, start.xy, arrowprops=how, zorder=4.0)


def walk(
    axes: Axes, x: float, title: str, files: Sequence[tuple[str, str]], bottoms: dict[str, float], colour: str
) -> None:
    """Draw files in the bands of their rooms, from the first to the last."""
    boxes: list[Annotation] = []
    for place, (file, what) in enumerate(files):
        if not (ROOT / "wtg_gym" / file).is_file():
            raise ValueError(f"no file wtg_gym/{file}")
        room = f"wtg_gym/{file.split('/')[0]}"
        own = [index for index, (other, _) in enumerate(files) if other.split("/")[0] == file.split("/")[0]]
        height = bottoms[room] + _ROW[room] * (1.0 - (own.index(place) + 0.5) / len(own))
        boxes.append(box(axes, x, height, f"{file.split('/')[1]}: {what}", colour, 6.5))
    top = bottoms["wtg_gym/envs"] + _ROW["wtg_gym/envs"]
    axes.annotate(title, (x, top + 0.3), ha="center", fontweight="bold", color=colour)
    for start, end in itertools.pairwise(boxes):
        arrow(axes, start, end, colour)


@printed
def plot_rooms() -> Figure:
    """Return the figure."""
    figure = Figure(figsize=(9.0, 5.6))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    imports = {room: imported(room) for room in ROOMS}
    places: dict[str, Annotation] = {}
    bottoms: dict[str, float] = {}
    bottom = 0.0
    for rooms in levels(imports):
        height = max(_ROW.get(room, 1.0) for room in rooms)
        for index, room in enumerate(rooms):
            bottoms[room] = bottom
            if room in _ROW:
                axes.axhspan(bottom + 0.05, bottom + height - 0.05, color="0.95", zorder=0.0)
            x = 2.1 * (index + 0.5) / len(rooms)
            places[room] = box(axes, x, bottom + 0.5 * height, Path(room).stem, "0.3", 7.5)
        bottom += height
    axes.set(xlim=(0.0, 4.4), ylim=(0.0, bottom))
    for room, other in nearest(imports):
        arrow(axes, places[room], places[other], "0.6")
    walk(axes, 2.7, "an action", ACTION, bottoms, PALETTE[0])
    walk(axes, 3.75, "a scenario", SCENARIO, bottoms, PALETTE[1])
    return figure


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(figure_bytes(plot_rooms(), Path(sys.argv[1]).suffix))
