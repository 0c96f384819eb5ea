"""Recorded runs side by side as a moving picture: the grid with its events, frequency, rotor speeds and powers."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym.envs.rendering.colours import INK
from wtg_gym.envs.rendering.diagram import describe_event, draw_diagram, reclosed
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import LineTrip, Scenario
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting.event_marks import endings, numbered_events
from wtg_gym.plotting.style import GROUP_STYLES, OVERLOAD_PU, REFERENCE_GREY, new_figure, print_style, strategy_looks
from wtg_gym.plotting.trajectories import line_of_group

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


#: Width and height [pixels].
SIZE = (880, 500)
#: Pictures of a run, each shown for so long, the last one for longer [ms].
N_PICTURES, PICTURE_MS, LAST_PICTURE_MS = 120, 80, 3000
#: Of the whole GIF; one more stands for "as before".
_N_COLOURS = 127
#: A point is a pixel.
_MM_PER_INCH, _DPI = 25.4, 72
_FONT_SIZES: dict[Any, Any] = {
    "font.size": 12,
    "axes.labelsize": 12,
    "xtick.labelsize": 11,
    "ytick.labelsize": 11,
    "legend.fontsize": 12,
}
_N_EVENTS = 4


def animate_trajectories(
    runs: Mapping[str, Trajectory], scenario: Scenario, group_buses: Sequence[int], overload_pu: float = OVERLOAD_PU
) -> bytes:
    """Return a GIF of runs over time, which repeats: the same bytes each time.

    Frequency, rotor speeds and powers grow from left to right; one colour per run, one dash pattern per WTG group; a
    cross marks where a run ended before its time. Beside them the grid shows where events have struck.

    Args:
        runs: recorded runs of the scenario by label, at least one, all with the same number of WTG groups.
        scenario: what happened in them.
        group_buses: bus of each WTG group.
        overload_pu: power above which a converter counts as overloaded [p.u.].
    """
    import matplotlib

    with print_style():
        matplotlib.rcParams.update(_FONT_SIZES)
        picture = _MovingPicture(runs, scenario, group_buses, overload_pu)
        frames = [picture.at(instant) for instant in np.linspace(0.0, scenario.duration_s, N_PICTURES + 1)]
    return _gif(frames)


class _MovingPicture:
    """A figure whose curves are cut off at an instant."""

    def __init__(
        self, runs: Mapping[str, Trajectory], scenario: Scenario, group_buses: Sequence[int], overload_pu: float
    ) -> None:
        self._runs, self._scenario, self._buses = runs, scenario, group_buses
        self._looks = strategy_looks(runs)
        width, height = (side / _DPI * _MM_PER_INCH for side in SIZE)
        self._figure: Figure = new_figure(width, height)
        self._figure.set_layout_engine("none")
        self._figure.set_dpi(_DPI)
        self._figure.text(0.02, 0.965, scenario.name, fontsize=15, fontweight="bold", va="top")
        self._now = self._figure.text(0.02, 0.905, "", fontsize=22, fontweight="bold", va="top", animated=True)
        self._diagram = self._figure.add_axes((0.0, 0.36, 0.37, 0.46))
        self._events = self._figure.text(0.02, 0.345, "", va="top", linespacing=1.45)
        #: Lines with the whole of their data; a cross is a line of one point.
        self._lines: list[tuple[Line2D, Floats, Floats]] = []
        self._drawn: tuple[int, tuple[LineTrip, ...]] = (-1, ())
        #: The picture without lines and time, which is drawn anew at events only.
        self._background: Any = None
        self._draw_panels(overload_pu)
        self._draw_legend()

    def _draw_panels(self, overload_pu: float) -> None:
        panels: dict[str, Any] = {
            "frequency [Hz]": lambda run: run.frequency_hz[:, None],
            "rotor speed [p.u.]": lambda run: run.rotor_speed_pu,
            "power [p.u.]": lambda run: run.power_pu,
        }
        for row, (label, quantity) in enumerate(panels.items()):
            axes = self._figure.add_axes((0.455, 0.715 - 0.305 * row, 0.525, 0.255))
            for name, run in self._runs.items():
                for group, values in enumerate(quantity(run).T):
                    self._draw_run(axes, name, run, values, group)
            axes.set_ylabel(label)
            axes.margins(y=0.08)
            axes.set_xlim(0.0, self._scenario.duration_s)
            axes.yaxis.set_label_coords(-0.115, 0.5)
            axes.locator_params(axis="y", nbins=5)
            low, high = axes.get_ylim()
            if label.startswith("power") and low < overload_pu < high:
                axes.axhline(overload_pu, color=REFERENCE_GREY, linewidth=0.8, linestyle=":")
                above: dict[str, Any] = {
                    "xytext": (-2.0, 2.0),
                    "textcoords": "offset points",
                    "ha": "right",
                    "color": REFERENCE_GREY,
                }
                axes.annotate("overload", (self._scenario.duration_s, overload_pu), **above)
            # The limits are those of the whole runs, from the first picture on.
            axes.set_ylim(axes.get_ylim())
            if row < len(panels) - 1:
                axes.tick_params(axis="x", labelbottom=False)
            else:
                axes.set_xlabel("time [s]")

    def _draw_run(self, axes: Axes, name: str, run: Trajectory, values: Floats, group: int) -> None:
        colour = self._looks[name].colour
        style, width = line_of_group(group, len(self._buses))
        (line,) = axes.plot(run.time_s, values, style, color=colour, linewidth=1.2 * width, animated=True)
        self._lines.append((line, run.time_s, values))
        if run.status != Status.RUNNING:
            time, last = run.time_s[-1:], values[-1:]
            (cross,) = axes.plot(time, last, "x", color=colour, markersize=9, markeredgewidth=2.5, animated=True)
            self._lines.append((cross, time, last))

    def _draw_legend(self) -> None:
        from matplotlib.lines import Line2D

        longest = max(self._runs.values(), key=lambda run: run.time_s.size)
        handles = [Line2D([], [], color=self._looks[name].colour, linewidth=3.5, label=name) for name in self._runs]
        if len(self._buses) <= len(GROUP_STYLES):
            handles += [
                Line2D([], [], color=INK, linestyle=style, linewidth=1.8, label=f"W{group}, mean wind {wind:.3g} m/s")
                for group, (style, wind) in enumerate(zip(GROUP_STYLES, longest.wind_m_s.mean(axis=0), strict=False), 1)
            ]
        reasons = endings(self._runs.values())
        if reasons:
            label = f"run ended: {reasons}"
            cross: dict[str, Any] = {"marker": "x", "markersize": 9, "markeredgewidth": 2.5, "linestyle": "none"}
            handles.append(Line2D([], [], color=INK, label=label, **cross))
        self._figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.008, 0.005), handlelength=2.6)

    def at(self, instant: float) -> Any:
        """Return the picture at an instant [s]."""
        from PIL import Image

        canvas: Any = self._figure.canvas
        # Instants of samples are rounded differently.
        end = instant + 1e-6
        struck = [(number, events) for number, events in numbered_events(self._scenario) if events[0].time_s <= end]
        so_far = [event for _, events in struck for event in events]
        closed = reclosed(so_far, end)
        if (len(struck), closed) != self._drawn:
            self._drawn = (len(struck), closed)
            self._diagram.clear()
            draw_diagram(self._diagram, self._buses, so_far, closed, lambda _: INK)
            texts = [
                f"{number}  {events[0].time_s:g} s: " + " and ".join(map(describe_event, events))
                for number, events in struck[-_N_EVENTS:]
            ]
            self._events.set_text("\n".join(texts))
            canvas.draw()
            self._background = canvas.copy_from_bbox(self._figure.bbox)
        canvas.restore_region(self._background)
        self._now.set_text(f"{instant:.0f} s")
        self._figure.draw_artist(self._now)
        for line, time, values in self._lines:
            seen = time <= end
            line.set_data(time[seen], values[seen])
            self._figure.draw_artist(line)
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _gif(frames: Sequence[Any]) -> bytes:
    """Return pictures as a GIF that repeats, all in the colours of the last one, which has everything in it."""
    from PIL import Image

    colours = frames[-1].quantize(_N_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    # A picture of few colours has fewer in its palette.
    palette = [*colours.getpalette(), *[0] * (3 * _N_COLOURS)][: 3 * _N_COLOURS]
    pictures, before = [], None
    for frame in frames:
        pixels = np.asarray(frame.quantize(palette=colours, dither=Image.Dither.NONE))
        # Most of a picture is as before: left transparent, it takes next to no space.
        changed = pixels if before is None else np.where(pixels == before, np.uint8(_N_COLOURS), pixels)
        picture = Image.fromarray(changed)
        picture.putpalette([*palette, 0, 0, 0])
        pictures.append(picture)
        before = pixels
    content = io.BytesIO()
    shown = {"duration": [*([PICTURE_MS] * (len(frames) - 1)), LAST_PICTURE_MS], "loop": 0}
    kept = {"transparency": _N_COLOURS, "disposal": 1, "optimize": False}
    pictures[0].save(content, "GIF", save_all=True, append_images=pictures[1:], **shown, **kept)
    return content.getvalue()
