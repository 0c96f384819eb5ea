"""Pictures of running episodes, in environments that render: the grid with its events, and curves so far.

First the single-line diagram, then the frames, whose background is drawn once and kept, then the window and the samples
that frames are made of. Needs matplotlib, and a window pygame too; both are imported only when something is drawn.
"""

import functools
import math
from collections.abc import Collection, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from wtg_gym.envs.batch import TERMINATION_REASONS, EnvBatch
from wtg_gym.extras import install_advice
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.grid import NetworkCase
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Event, Fault, GovernorLoss, GroupTrip, LineTrip, MachineOutage, ReactanceStep
from wtg_gym.physics.tracking_law import REFERENCE_LAW, get_law

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

#: A frame, (height, width, 3).
Frame = npt.NDArray[np.uint8]
Range = tuple[float, float]
#: Values by quantity, (n_samples, 1 or one per WTG group); not a number where there is none.
Samples = Mapping[str, npt.NDArray[np.floating[Any]]]

#: Width and height [pixels]; even, as video codecs want them.
FRAME_SIZE = (960, 540)
#: Place, size and style of the texts that are new in every frame: time, failure, other end, cost, violations.
_TEXTS: tuple[tuple[float, float, dict[str, Any]], ...] = (
    (0.017, 0.896, {"fontsize": 22, "color": INK, "fontweight": "bold"}),
    (0.121, 0.887, {"fontsize": 16, "color": EVENT, "fontweight": "bold"}),
    (0.121, 0.887, {"fontsize": 16, "color": SOFT, "fontweight": "bold"}),
    (0.017, 0.835, {"fontsize": 13, "color": INK}),
    (0.017, 0.802, {"fontsize": 12, "color": SOFT}),
)


def _needed(module: str, what: str) -> Any:
    """Import a module of the `render` extra; a DependencyNotInstalled says what needs it."""
    name = module.partition(".")[0]
    try:
        # The package first: a module of it may be there already.
        import_module(name)
        return import_module(module)
    except ImportError as error:
        raise DependencyNotInstalled(f"{what} needs {name}; {install_advice('render')}") from error


def group_colour(group: int) -> str:
    """Return the colour of a WTG group."""
    return GROUPS[group % len(GROUPS)]


@functools.lru_cache(maxsize=16)
def bus_places(case: NetworkCase) -> Mapping[int, tuple[float, float]]:
    """Return where the buses are drawn, by their numbers: as the case says, or laid out so that no lines are long."""
    placed = {bus.number: (bus.x, bus.y) for bus in case.buses if bus.x is not None and bus.y is not None}
    if len(placed) < len(case.buses):
        networkx = _needed("networkx", "the layout of this grid")
        placed = networkx.kamada_kawai_layout(networkx.Graph((b.from_bus, b.to_bus) for b in case.branches))
    points = np.array([placed[bus.number] for bus in case.buses], dtype=np.float64)
    low, span = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
    scaled = ((points - low) / span * (_WIDTH, _HEIGHT) + (0.3, 0.3)).tolist()
    return {bus.number: (x, y) for bus, (x, y) in zip(case.buses, scaled, strict=True)}


def draw_diagram(axes: "Axes", plant: Plant, events: Sequence[Event], over: Collection[Event]) -> None:
    """Draw the single-line diagram into empty axes, with the events that have struck, numbered; some are undone."""
    group_buses, places = [group.bus for group in plant.groups], bus_places(plant.case)
    size = min(1.0, math.sqrt(_N_BUSES / len(places)))
    number_size = max(8.0, 10.0 * size)
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
            ring: Any = {"markerfacecolor": PAGE, "markeredgecolor": colour, "markeredgewidth": 1.4, "zorder": 4}
            axes.plot(at, centre, "o", markersize=18 * size, **ring)
            style: Any = {"fontsize": 9 * size, "color": colour, "ha": "center", "va": "center", "zorder": 4}
            axes.text(at, centre - 0.02 * size, name, **style)
        half = max(0.45 * size, 0.5 * gap * (len(units) - 1) + 0.15 * size)
        axes.plot([x - half, x + half], [y, y], color=INK, linewidth=3.0 * size, solid_capstyle="butt")
        axes.text(x + half - 0.03, y + 0.08 * size, str(bus), fontsize=number_size, color=INK, va="bottom", bbox=_PLATE)
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
    colour = EVENT if any(isinstance(e, GovernorLoss) and e.bus == bus for e in events) else INK
    is_out = any(isinstance(e, MachineOutage) and e.bus == bus for e in events)
    # A machine with a governor is a generator; the others are condensers.
    names = ("C" if machine.governor is None else "G" for machine in plant.case.machines if machine.bus == bus)
    units = [(name, colour, is_out) for name in names]
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


class Panel(NamedTuple):
    """One quantity over time."""

    name: str  # of the quantity
    title: str  # text above it, with the unit
    ranges: tuple[Range, ...]  # of its axis, each within the next; the first that holds all values so far is shown
    rules: tuple[float, ...] = ()  # values with a dashed line
    band: Range | None = None  # a shaded range of values
    limits: tuple[float, ...] = ()  # beyond which a run fails, or that converters keep; with a coloured line


def panels_of(plant: Plant) -> tuple[Panel, ...]:
    """Return the panels, from top to bottom, first the left column; with limits where converters have some."""
    nominal, law, protection = plant.case.frequency_hz, get_law(REFERENCE_LAW), plant.protection
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
    return panels if plant.limits else tuple(panel._replace(limits=()) for panel in panels)


class Scene(NamedTuple):
    """What changes seldom from frame to frame."""

    heading: str  # which episode it is
    duration_s: float  # of the episode if nothing ends it before [s]
    events: tuple[Event, ...]  # those that have struck
    undone: tuple[Event, ...]  # those of them whose line is closed again, or whose unit is back


class FramePainter:
    """Draws the frames of one episode after the other; a DependencyNotInstalled if matplotlib is missing."""

    def __init__(self, env_id: str, plant: Plant) -> None:
        self._style = _needed("matplotlib.style", "rendering").context
        self._env_id, self._plant, self._panels = env_id, plant, panels_of(plant)
        self._kept: tuple[Scene, list[Range]] | None = None

    def __reduce__(self) -> Any:
        # A copy draws anew.
        return FramePainter, (self._env_id, self._plant)

    def paint(self, scene: Scene, samples: Samples, texts: Sequence[str]) -> Frame:
        """Return a frame of an episode; samples have their instants under "time" [s]."""
        ranges = [_fitting_range(panel, samples) for panel in self._panels]
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
        for axes, panel, limits in zip(grid.T.flat, self._panels, ranges, strict=True):
            _draw_axes(axes, panel, limits, scene)
            for column in range(samples[panel.name].shape[1]):
                colour = INK if panel.name in ("frequency", "rocof") else group_colour(column)
                (line,) = axes.plot([], [], color=colour, linewidth=1.7, animated=True, clip_on=False)
                line.set(marker="o", markersize=5.2, markevery=[-1])  # a dot at its end
                self._lines[panel.name, column] = line
        for axes in grid[-1]:
            axes.set_xlabel("time [s]", fontsize=11, color=SOFT, labelpad=2)
        # The left part: the environment, heading, diagram, and the latest six events in words.
        self._figure.text(0.017, 0.974, self._env_id, fontsize=16, fontweight="bold", color=INK, va="top")
        self._figure.text(0.017, 0.933, scene.heading, fontsize=12, color=SOFT, va="top")
        draw_diagram(self._figure.add_axes((0.008, 0.307, 0.333, 0.444)), self._plant, scene.events, scene.undone)
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


class Window:
    """A window for pictures of one size, `fps` per second at most; a DependencyNotInstalled if pygame is missing.

    It opens at the first picture. Once its user has closed it, pictures are dropped without waiting.
    """

    def __init__(self, title: str, fps: int) -> None:
        self._pygame, self._title, self._fps = _needed("pygame", 'render_mode="human"'), title, fps
        self._clock = self._pygame.time.Clock()
        self._surface: Any = None
        #: Whether the window was closed, by its user or by :meth:`close`.
        self.is_closed = False

    def __reduce__(self) -> Any:
        # A copy opens a window of its own.
        return Window, (self._title, self._fps)

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3), and wait until it is due; a RuntimeError if there is no display."""
        pygame, size = self._pygame, (picture.shape[1], picture.shape[0])
        try:
            pygame.display.init()
            self._surface = self._surface or pygame.display.set_mode(size)
        except pygame.error as error:
            raise RuntimeError(
                f'render_mode="human" found no display to open a window on ({error}); use render_mode="rgb_array"'
            ) from error
        pygame.display.set_caption(self._title)
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        self._surface.blit(pygame.image.frombuffer(picture.tobytes(), size, "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window; no other one opens."""
        self.is_closed = True
        if self._surface is not None:
            self._surface = None
            self._pygame.display.quit()


class BatchFrames:
    """Frames of the episodes of a batch, and a window for the first one where `opens_window`.

    Each one's samples lie at their control steps, so that after a return to an earlier step only the steps before it
    are drawn. Without matplotlib, or for a window without pygame, there is a DependencyNotInstalled.
    """

    def __init__(self, batch: EnvBatch, *, opens_window: bool, fps: int) -> None:
        self._batch, self._plant = batch, batch.settings.resolved_plant
        self._tip_speeds = np.array([turbine.tip_speed_ratio_per_speed_m_s for turbine in self._plant.turbines])
        #: By quantity, (num_envs, n_steps, 1 or n_wtg); not a number where there is none.
        self._samples: dict[str, npt.NDArray[np.float32]] = {}
        self._painters = [FramePainter(batch.suite.env_id, self._plant) for _ in range(batch.num_envs)]
        self._window = Window(batch.suite.env_id, fps) if opens_window else None

    def sample(self) -> None:
        """Write down where every environment stands: after a reset and after every step."""
        batch, simulator = self._batch, self._batch.simulator
        step, coi = simulator.env_values("step"), simulator.env_values("coi")
        rotor, wind, rate = (simulator.wtg_values(name) for name in ("rotor_speed", "wind", "inv_tau"))
        now = {
            "time": simulator.plant.simulation_dt * step[:, None],
            "frequency": batch.nominal_hz * coi[:, None],
            "rocof": batch.task_values("rocof")[:, None],
            "rotor": rotor,
            "ratio": self._tip_speeds * _quotients(rotor, wind),
            "power": simulator.wtg_values("power"),
            "k": simulator.wtg_values("coefficient"),
            "tau": _quotients(np.ones_like(rate), rate),
            "wind": wind,
        }
        for name, values in now.items():
            if name not in self._samples:
                shape = batch.num_envs, simulator.n_intervals + 1, values.shape[1]
                self._samples[name] = np.full(shape, np.nan, dtype=np.float32)
            self._samples[name][np.arange(batch.num_envs), batch.n_steps()] = values

    def paint(self) -> tuple[Frame, ...]:
        """Return the frame of every environment; a RuntimeError if an episode was never started."""
        if not self._batch.started:
            raise RuntimeError("there is no episode to render; call reset() before render()")
        return tuple(self._paint(env, painter) for env, painter in enumerate(self._painters))

    def _paint(self, env: int, painter: FramePainter) -> Frame:
        batch, simulator = self._batch, self._batch.simulator
        now_s = float(simulator.env_values("step")[env]) * simulator.plant.simulation_dt
        # A hair, for the instants of events and of steps are rounded differently.
        struck = tuple(event for event in batch.events[env] if event.time_s <= now_s + 1e-6)
        seed, outputs = int(batch.scenario_seeds[env]), batch.outputs
        scene = Scene(
            heading="scenario of one's own" if seed < 0 else f"scenario {seed}",
            duration_s=float(batch.task_values("end_step")[env]) * simulator.plant.simulation_dt,
            events=struck,
            undone=undone(struck, now_s + 1e-6),
        )
        violated_s = batch.task_values("constraint_sum")[env] * batch.settings.interval_s
        texts = (
            f"{now_s:.1f} s",
            TERMINATION_REASONS[Status(int(batch.statuses()[env]))] if outputs.terminated[env] else "",
            "time over" if outputs.truncated[env] else "",
            f"cost {sum(batch.cost_sums()[env].tolist()):.2f}",
            f"constraints violated for {violated_s:.1f} s",
        )
        n_samples = int(batch.n_steps()[env]) + 1
        return painter.paint(scene, {name: values[env, :n_samples] for name, values in self._samples.items()}, texts)

    def show(self) -> None:
        """Show the first environment's frame in the window."""
        if self._window is not None and not self._window.is_closed:
            self._window.show(self.paint()[0])

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()

    def snapshot(self) -> Any:
        """Return a copy of the samples."""
        return {name: values.copy() for name, values in self._samples.items()}

    def restore(self, samples: Any) -> None:
        """Go back to a :meth:`snapshot`; with None, from an environment that does not render, the past is unknown."""
        self._samples = {name: values.copy() for name, values in (samples or {}).items()}
        self.sample()


def _quotients(values: Floats, divisors: Floats) -> Floats:
    """Return quotients, not a number where there is none: without damping, and where nothing was started."""
    return np.divide(values, divisors, out=np.full_like(values, np.nan), where=divisors > 0.0)
