"""Frames of an episode: axes and diagram drawn once and kept, lines and numbers drawn on top of a copy."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.rendering.colours import (
    BAND,
    EVENT,
    GRID,
    INK,
    LIMIT,
    LINE,
    PAGE,
    SOFT,
    WHOLE_GRID,
    group_colour,
    pale,
    plain_matplotlib,
    require_matplotlib,
    rgb,
)
from wtg_gym.envs.rendering.diagram import describe_event, draw_diagram, reclosed
from wtg_gym.envs.rendering.lines import draw_traces
from wtg_gym.envs.rendering.panels import PANELS, Episode, Panel, fitting_levels, n_traces, panels_of_traces
from wtg_gym.physics.scenario import Event, LineTrip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Image = npt.NDArray[np.uint8]
Box = tuple[int, int, int, int]

#: Width and height [pixels]; even, as video codecs want them.
FRAME_SIZE = (960, 540)

#: Left, top, right, bottom, the last two exclusive [pixels].
_LEFT: Box = (0, 0, 328, 540)
_NUMBERS: Box = (16, 56, 328, 126)
_DIAGRAM: Box = (8, 134, 328, 374)
_PANEL_COLUMNS = ((372, 644), (684, 948))
_PANEL_ROWS = ((26, 122), (152, 248), (278, 374), (404, 500))
_EVENTS_TOP, _EVENT_LINE, _N_EVENT_LINES, _NOTE_TOP = 394, 17, 6, 510
_HALF_WIDTH, _DOT_RADIUS = 0.85, 2.6
#: Of what sensors measure: a thinner line that ends without a dot.
_MEASURED_HALF_WIDTH, _NO_DOT = 0.4, -1.0
#: Pictures of the axes (1.5 MB) and of the left part (0.5 MB) that are kept beyond one per episode.
_N_KEPT = 8


class FramePainter:
    """Draws frames, of several episodes in turn where there are several.

    Args:
        n_episodes: episodes side by side.

    Raises:
        DependencyNotInstalled: matplotlib is missing.
    """

    def __init__(self, n_episodes: int = 1) -> None:
        require_matplotlib()
        # Kept with the painter, so that they go with it.
        self._axes = functools.lru_cache(n_episodes + _N_KEPT)(_axes_picture)
        self._left = functools.lru_cache(n_episodes + _N_KEPT)(_left_picture)

    def paint(self, episode: Episode) -> Image:
        """Return the frame of an episode, (height, width, 3)."""
        levels = fitting_levels(episode)
        now = float(episode.time_s[-1])
        # A hair, for the instants of events and of samples are rounded differently.
        struck = tuple(event for event in episode.events if event.time_s <= now + 1e-6)
        frame = self._axes(episode.panels, episode.duration_s, levels).copy()
        left, top, right, bottom = _LEFT
        closed = reclosed(struck, now + 1e-6)
        texts = episode.env_id, episode.heading, episode.note
        frame[top:bottom, left:right] = self._left(*texts, episode.group_buses, struck, closed)
        _draw_instants(frame, episode.duration_s, struck, closed)
        n_groups = len(episode.group_buses)
        n, measured = n_traces(n_groups), episode.traces.shape[1] > n_traces(n_groups)
        owners = panels_of_traces(n_groups, measured=measured)
        ranges = np.array([episode.panels[owner].ranges[levels[owner]] for owner in owners])
        boxes, colours = _boxes_and_colours(n_groups, measured=measured)
        x = np.ascontiguousarray(episode.time_s) / episode.duration_s
        # Measured curves lie beneath the exact ones.
        for own, half_width, radius in (
            (slice(n, None), _MEASURED_HALF_WIDTH, _NO_DOT),
            (slice(n), _HALF_WIDTH, _DOT_RADIUS),
        ):
            traces = np.ascontiguousarray(episode.traces[:, own], dtype=np.float64)
            draw_traces(frame, x, traces, boxes[own], ranges[own], colours[own], half_width, radius)
        _draw_numbers(frame, episode, now)
        return frame


def panel_box(panel: int) -> Box:
    """Return left, top, right and bottom of a panel of :data:`PANELS`, the last two exclusive [pixels]."""
    (left, right), (top, bottom) = _PANEL_COLUMNS[panel // 4], _PANEL_ROWS[panel % 4]
    return left, top, right, bottom


@functools.cache
def _boxes_and_colours(n_groups: int, *, measured: bool) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the box (n_traces, 4) and the colour (n_traces, 3) of every trace."""
    boxes, colours = [], []
    for index, panel in enumerate(PANELS):
        for group in range(n_groups if panel.per_group else 1):
            boxes.append(panel_box(index))
            colours.append(rgb(group_colour(group) if panel.per_group else WHOLE_GRID))
    for index in panels_of_traces(n_groups, measured=measured)[len(boxes) :: n_groups]:
        for group in range(n_groups):
            boxes.append(panel_box(int(index)))
            colours.append(pale(group_colour(group)))
    return np.array(boxes, dtype=np.int64), np.array(colours, dtype=np.float64)


def _draw_instants(frame: Image, duration_s: float, events: tuple[Event, ...], closed: tuple[LineTrip, ...]) -> None:
    """Draw a dashed line through every panel where an event struck, a dotted one where a line closed again."""
    instants = [(event.time_s, 3) for event in events] + [(event.end_s, 1) for event in closed]
    for panel in range(len(PANELS)):
        left, top, right, bottom = panel_box(panel)
        for instant, length in instants:
            column = min(left + int(instant / duration_s * (right - left)), right - 1)
            for row in range(top, bottom, 2 * length):
                frame[row : min(row + length, bottom), column] = rgb(EVENT)


def _draw_numbers(frame: Image, episode: Episode, now: float) -> None:
    from PIL import Image as Images
    from PIL import ImageDraw

    left, top, right, bottom = _NUMBERS
    picture = Images.new("RGB", (right - left, bottom - top), PAGE)
    draw = ImageDraw.Draw(picture)
    draw.text((0, 0), f"{now:.1f} s", INK, _font(22, bold=True))
    if episode.outcome:
        draw.text((100, 5), episode.outcome, EVENT if episode.failed else SOFT, _font(16, bold=True))
    # Without -0.00.
    total = round(episode.total_reward, 2) + 0.0
    draw.text((0, 32), f"return {total:.2f}".replace("-", "−"), INK, _font(13))
    draw.text((0, 51), f"constraints violated in {episode.n_violated} steps", SOFT, _font(12))
    frame[top:bottom, left:right] = np.asarray(picture)


@functools.cache
def _font(size: int, *, bold: bool = False) -> Any:
    import matplotlib
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)


def _axes_picture(panels: tuple[Panel, ...], duration_s: float, levels: tuple[int, ...]) -> Image:
    """Return a frame with the panels' axes and nothing else."""
    with plain_matplotlib():
        figure = _new_figure(*FRAME_SIZE)
        for index, (panel, level) in enumerate(zip(panels, levels, strict=True)):
            axes = _add_axes(figure, panel_box(index), FRAME_SIZE)
            _draw_axes(axes, panel, panel.ranges[level], duration_s)
            if index % 4 == 3:
                axes.set_xlabel("time [s]", fontsize=11, color=SOFT, labelpad=2)
            else:
                axes.tick_params(axis="x", labelbottom=False)
        return _picture(figure)


def _draw_axes(axes: Axes, panel: Panel, limits: tuple[float, float], duration_s: float) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set_xlim(0.0, duration_s)
    axes.set_ylim(*limits)
    axes.set_title(panel.title, fontsize=12, color=INK, loc="left", pad=5)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 4, 5, 10]))
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(labelsize=10, labelcolor=SOFT, color=LINE, length=3, width=1)
    axes.grid(True, color=GRID, linewidth=1)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(LINE)
        spine.set_linewidth(1)
    if panel.band is not None:
        axes.axhspan(*panel.band, color=BAND, linewidth=0, zorder=0)
    for value in panel.rules:
        axes.axhline(value, color=SOFT, linewidth=0.8, linestyle=(0, (2, 3)), zorder=1)
    for value in panel.limits:
        axes.axhline(value, color=LIMIT, linewidth=0.8, zorder=1)


def _left_picture(
    env_id: str,
    heading: str,
    note: str,
    group_buses: tuple[int, ...],
    events: tuple[Event, ...],
    closed: tuple[LineTrip, ...],
) -> Image:
    """Return the left part of a frame: the environment, heading, diagram, the events so far in words, and a note."""
    width, height = size = _LEFT[2] - _LEFT[0], _LEFT[3] - _LEFT[1]
    with plain_matplotlib():
        figure = _new_figure(width, height)

        def write(x: int, y: int, text: str, points: float, **style: Any) -> None:
            figure.text(x / width, 1.0 - y / height, text, fontsize=points, va="top", **style)

        write(16, 14, env_id, 16, fontweight="bold", color=INK)
        write(16, 36, heading, 12, color=SOFT)
        draw_diagram(_add_axes(figure, _DIAGRAM, size), group_buses, events, closed)
        # The latest ones, where there are more than fit.
        for line, (number, event) in enumerate(list(enumerate(events, start=1))[-_N_EVENT_LINES:]):
            y = _EVENTS_TOP + _EVENT_LINE * line
            write(16, y, str(number), 12, fontweight="bold", color=EVENT)
            write(34, y, f"{event.time_s:g} s: {describe_event(event)}", 12, color=INK)
        write(16, _NOTE_TOP, note, 12, color=SOFT)
        return _picture(figure)


def _new_figure(width: int, height: int) -> Figure:
    """Return an empty figure of a size in pixels, in which a point is a pixel."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 72, height / 72), dpi=72, facecolor=PAGE)
    FigureCanvasAgg(figure)
    return figure


def _add_axes(figure: Figure, box: Box, size: tuple[int, int]) -> Axes:
    (left, top, right, bottom), (width, height) = box, size
    return figure.add_axes((left / width, 1.0 - bottom / height, (right - left) / width, (bottom - top) / height))


def _picture(figure: Figure) -> Image:
    canvas: Any = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
