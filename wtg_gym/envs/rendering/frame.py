"""Frames of an episode: the background is drawn once and kept, lines and numbers are drawn in every frame."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from wtg_gym.envs.rendering.diagram import BAND, EVENT, GRID, INK, LIMIT, LINE, PAGE, SOFT, draw_diagram, group_colour
from wtg_gym.extras import install_advice
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: A frame, (height, width, 3).
Frame = npt.NDArray[np.uint8]
Range = tuple[float, float]
#: Values by quantity, (n_samples, 1 or one per WTG group); not a number where there is none.
Samples = Mapping[str, npt.NDArray[np.floating[Any]]]

#: Width and height [pixels]; even, as video codecs want them.
FRAME_SIZE = (960, 540)
#: Place, size and style of the texts that are new in every frame: time, failure, other end, return, violations.
_TEXTS: tuple[tuple[float, float, dict[str, Any]], ...] = (
    (0.017, 0.896, {"fontsize": 22, "color": INK, "fontweight": "bold"}),
    (0.121, 0.887, {"fontsize": 16, "color": EVENT, "fontweight": "bold"}),
    (0.121, 0.887, {"fontsize": 16, "color": SOFT, "fontweight": "bold"}),
    (0.017, 0.835, {"fontsize": 13, "color": INK}),
    (0.017, 0.802, {"fontsize": 12, "color": SOFT}),
)


class Panel(NamedTuple):
    """One quantity over time."""

    name: str  # of the quantity
    title: str  # text above it, with the unit
    ranges: tuple[Range, ...]  # of its axis, each within the next; the first that holds all values so far is shown
    rules: tuple[float, ...] = ()  # values with a dashed line
    band: Range | None = None  # a shaded range of values
    limits: tuple[float, ...] = ()  # beyond which a run fails, or that converters keep; with a coloured line


def panels_of(plant: Plant, *, limited: bool) -> tuple[Panel, ...]:
    """Return the panels, from top to bottom, first the left column; with the plant's limits where `limited`."""
    nominal, law, protection = plant.case.frequency_hz, get_law(REFERENCE_STRATEGY), plant.protection
    ratios = tracking_point().tip_speed_ratio, tracking_point(plant.control.deloading_limit).tip_speed_ratio
    free = (0.9 * ratios[0], 1.1 * ratios[1])
    # Beyond ±0.2 Hz the deviation costs four times as much.
    dear, overload = (nominal - 0.2, nominal + 0.2), (plant.control.overload_limit_pu,)
    low, high = nominal * protection.frequency_min_pu, nominal * protection.frequency_max_pu
    around = *((nominal - d, nominal + d) for d in (0.25, 0.5, 1.0)), (low - 0.25, high + 0.25)
    speeds, stall = (protection.rotor_speed_min_pu, protection.over_speed_pu), (protection.stall_tip_speed_ratio,)
    most = () if plant.limits is None else (plant.limits.power_max_pu,)
    panels = (
        Panel("frequency", "frequency [Hz]", around, rules=dear, limits=(low, high)),
        Panel("rocof", "RoCoF [Hz/s]", ((-0.3, 0.3), (-0.6, 0.6), (-2.0, 2.0), (-10.0, 10.0))),
        Panel("rotor", "rotor speed [p.u.]", ((0.4, 1.3), (0.2, 1.4), (0.0, 2.0)), limits=speeds),
        Panel("ratio", "tip-speed ratio [–]", ((5.0, 13.0), (2.0, 14.0), (0.0, 20.0)), band=free, limits=stall),
        Panel("power", "power [p.u.]", ((0.0, 1.3), (-0.2, 1.4), (-1.0, 2.0)), rules=overload, limits=most),
        Panel("k", "k [p.u.]", ((0.2, 1.3), (0.0, 3.0)), rules=(law.k_min, law.k_nominal, law.k_max)),
        Panel("tau", "τ [s]", ((0.0, 3.4), (0.0, 14.0), (0.0, 60.0))),
        Panel("wind", "wind speed [m/s]", ((4.0, 16.0), (2.0, 26.0))),
    )
    return panels if limited else tuple(panel._replace(limits=()) for panel in panels)


class Scene(NamedTuple):
    """What changes seldom from frame to frame."""

    env_id: str
    heading: str  # which episode it is
    duration_s: float  # of the episode if nothing ends it before [s]
    plant: Plant
    panels: tuple[Panel, ...]
    events: tuple[Event, ...]  # those that have struck
    undone: tuple[Event, ...]  # those of them whose line is closed again, or whose unit is back


class FramePainter:
    """Draws the frames of one episode after the other; a DependencyNotInstalled if matplotlib is missing."""

    def __init__(self) -> None:
        try:
            import matplotlib.style
        except ImportError as error:
            raise DependencyNotInstalled(f"rendering needs matplotlib; {install_advice('render')}") from error
        self._style: Any = matplotlib.style.context
        self._kept: tuple[Scene, list[Range]] | None = None

    def __reduce__(self) -> Any:
        # A copy draws anew.
        return FramePainter, ()

    def paint(self, scene: Scene, samples: Samples, texts: Sequence[str]) -> Frame:
        """Return a frame of an episode; samples have their instants under "time" [s]."""
        ranges = [_fitting_range(panel, samples) for panel in scene.panels]
        # A user's settings do not change the picture.
        with self._style("default"):
            if (scene, ranges) != self._kept:
                self._draw_background(scene, ranges, samples)
                self._canvas.draw()
                self._background = self._canvas.copy_from_bbox(self._figure.bbox)
                self._kept = scene, ranges
            self._canvas.restore_region(self._background)
            for (name, column), line in self._lines.items():
                line.set_data(samples["time"][:, 0], np.clip(samples[name][:, column], *line.axes.get_ylim()))
            for artist, words in zip(self._texts, texts, strict=True):
                artist.set_text(words)
            for artist in (*self._lines.values(), *self._texts):
                self._figure.draw_artist(artist)
            return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _draw_background(self, scene: Scene, ranges: Sequence[Range], samples: Samples) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        # A point is a pixel.
        self._figure = Figure(figsize=(FRAME_SIZE[0] / 72, FRAME_SIZE[1] / 72), dpi=72, facecolor=PAGE)
        self._canvas: Any = FigureCanvasAgg(self._figure)
        self._lines: dict[tuple[str, int], Any] = {}
        places = {"left": 0.3875, "right": 0.9875, "top": 0.952, "bottom": 0.074, "hspace": 0.3125, "wspace": 0.15}
        grid = self._figure.subplots(4, 2, sharex=True, gridspec_kw=places)
        for axes, panel, limits in zip(grid.T.flat, scene.panels, ranges, strict=True):
            _draw_axes(axes, panel, limits, scene)
            for column in range(samples[panel.name].shape[1]):
                colour = INK if panel.name in ("frequency", "rocof") else group_colour(column)
                (line,) = axes.plot([], [], color=colour, linewidth=1.7, animated=True, clip_on=False)
                line.set(marker="o", markersize=5.2, markevery=[-1])  # a dot at its end
                self._lines[panel.name, column] = line
        for axes in grid[-1]:
            axes.set_xlabel("time [s]", fontsize=11, color=SOFT, labelpad=2)
        # The left part: the environment, heading, diagram, and the latest six events in words.
        self._figure.text(0.017, 0.974, scene.env_id, fontsize=16, fontweight="bold", color=INK, va="top")
        self._figure.text(0.017, 0.933, scene.heading, fontsize=12, color=SOFT, va="top")
        draw_diagram(self._figure.add_axes((0.008, 0.307, 0.333, 0.444)), scene.plant, scene.events, scene.undone)
        for line, (number, event) in enumerate(list(enumerate(scene.events, start=1))[-6:]):
            y, words = 0.27 - 0.0315 * line, f"{event.time_s:g} s: {event.words}"
            self._figure.text(0.017, y, str(number), fontsize=12, fontweight="bold", color=EVENT, va="top")
            self._figure.text(0.035, y, words, fontsize=12, color=INK, va="top")
        self._texts = [self._figure.text(x, y, "", va="top", animated=True, **style) for x, y, style in _TEXTS]


def _fitting_range(panel: Panel, samples: Samples) -> Range:
    """Return the first range of a panel that holds all values so far, else the last."""
    # These pass over what is not a number, and a comparison with it is false.
    lowest, highest = np.fmin.reduce(samples[panel.name], axis=None), np.fmax.reduce(samples[panel.name], axis=None)
    fitting = [(low, high) for low, high in panel.ranges if not (lowest < low or highest > high)]
    return fitting[0] if fitting else panel.ranges[-1]


def _draw_axes(axes: "Axes", panel: Panel, limits: Range, scene: Scene) -> None:
    axes.set(xlim=(0.0, scene.duration_s), ylim=limits, axisbelow=True)
    axes.set_title(panel.title, fontsize=12, color=INK, loc="left", pad=5)
    axes.locator_params(axis="x", nbins=6, steps=[1, 2, 5, 10])
    axes.locator_params(axis="y", nbins=4, steps=[1, 2, 4, 5, 10])
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(labelsize=10, labelcolor=SOFT, color=LINE, length=3, width=1)
    axes.grid(True, color=GRID, linewidth=1)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(LINE)
    if panel.band is not None:
        axes.axhspan(*panel.band, color=BAND, linewidth=0, zorder=0)
    for value in panel.rules:
        axes.axhline(value, color=SOFT, linewidth=0.8, linestyle=(0, (2, 3)), zorder=1)
    for value in panel.limits:
        axes.axhline(value, color=LIMIT, linewidth=0.8, zorder=1)
    for event in scene.events:
        axes.axvline(event.time_s, color=EVENT, linewidth=1, linestyle=(0, (3, 3)), zorder=1)
    for event in scene.undone:
        axes.axvline(event.end_s, color=EVENT, linewidth=1, linestyle=(0, (1, 2)), zorder=1)
