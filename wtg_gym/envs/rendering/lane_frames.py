"""Samples of running episodes, their frames, and a window that shows them, in environments that render."""

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from wtg_gym.envs.lanes import TERMINATION_REASONS, TaskLanes
from wtg_gym.envs.rendering import diagram, frame
from wtg_gym.extras import install_advice
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status


class Window:
    """A window for pictures of one size, `fps` per second at most; a DependencyNotInstalled if pygame is missing.

    It opens at the first picture. Once its user has closed it, pictures are dropped without waiting.
    """

    def __init__(self, title: str, fps: int) -> None:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled(f'render_mode="human" needs pygame; {install_advice("render")}') from error
        self._pygame, self._title, self._fps = pygame, title, fps
        self._clock = pygame.time.Clock()
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


class LaneFrames:
    """Frames of the episodes in lanes, and a window for the first one where `opens_window`.

    Every lane's samples lie at their control steps, so that after a return to an earlier step only the steps before it
    are drawn. Without matplotlib, or for a window without pygame, there is a DependencyNotInstalled.
    """

    def __init__(self, lanes: TaskLanes, *, opens_window: bool = False, fps: int = 10) -> None:
        self._lanes, self._plant = lanes, lanes.settings.resolved_plant
        self._tip_speeds = np.array([turbine.tip_speed_ratio_per_speed_m_s for turbine in self._plant.turbines])
        self._panels = frame.panels_of(self._plant, limited=lanes.suite.task.version != "v0")
        #: By quantity, (n_lanes, n_steps, 1 or n_wtg); not a number where there is none.
        self._samples: dict[str, npt.NDArray[np.float32]] = {}
        self._painters = [frame.FramePainter() for _ in range(lanes.n_lanes)]
        self._window = Window(lanes.suite.env_id, fps) if opens_window else None

    def sample(self) -> None:
        """Write down where every lane stands: after a reset and after every step."""
        lanes, simulator = self._lanes, self._lanes.simulator
        step, coi = simulator.lane_values("step"), simulator.lane_values("coi")
        rotor, wind, rate = (simulator.wtg_values(name) for name in ("rotor_speed", "wind", "inv_tau"))
        now = {
            "time": simulator.plant.simulation_dt * step[:, None],
            "frequency": lanes.nominal_hz * coi[:, None],
            "rocof": lanes.task_values("rocof")[:, None],
            "rotor": rotor,
            "ratio": self._tip_speeds * _quotients(rotor, wind),
            "power": simulator.wtg_values("power"),
            "k": simulator.wtg_values("coefficient"),
            "tau": _quotients(np.ones_like(rate), rate),
            "wind": wind,
        }
        for name, values in now.items():
            if name not in self._samples:
                shape = lanes.n_lanes, simulator.n_intervals + 1, values.shape[1]
                self._samples[name] = np.full(shape, np.nan, dtype=np.float32)
            self._samples[name][np.arange(lanes.n_lanes), lanes.n_steps()] = values

    def paint(self) -> tuple[frame.Frame, ...]:
        """Return the frame of every lane; a RuntimeError if an episode was never started."""
        if not (self._lanes.task_values("end_step") > 0.0).all():
            raise RuntimeError("there is no episode to render; call reset() before render()")
        return tuple(self._paint(lane, painter) for lane, painter in enumerate(self._painters))

    def _paint(self, lane: int, painter: frame.FramePainter) -> frame.Frame:
        lanes, simulator = self._lanes, self._lanes.simulator
        now_s = float(simulator.lane_values("step")[lane]) * simulator.plant.simulation_dt
        # A hair, for the instants of events and of steps are rounded differently.
        struck = tuple(event for event in lanes.events[lane] if event.time_s <= now_s + 1e-6)
        seed, outputs = int(lanes.scenario_seeds[lane]), lanes.outputs
        scene = frame.Scene(
            env_id=lanes.suite.env_id,
            heading="scenario of one's own" if seed < 0 else f"scenario {seed}",
            duration_s=float(lanes.task_values("end_step")[lane]) * simulator.plant.simulation_dt,
            plant=self._plant,
            panels=self._panels,
            events=struck,
            undone=diagram.undone(struck, now_s + 1e-6),
        )
        # Without -0.00.
        total = round(-float(sum(lanes.cost_sums()[lane].tolist())), 2) + 0.0
        texts = (
            f"{now_s:.1f} s",
            TERMINATION_REASONS[Status(int(lanes.statuses()[lane]))] if outputs.terminated[lane] else "",
            "time over" if outputs.truncated[lane] else "",
            f"return {total:.2f}".replace("-", "−"),
            f"constraints violated in {lanes.task_values('constraint_sum')[lane]:.0f} steps",
        )
        n_samples = int(lanes.n_steps()[lane]) + 1
        return painter.paint(scene, {name: values[lane, :n_samples] for name, values in self._samples.items()}, texts)

    def show(self) -> None:
        """Show the first lane's frame in the window."""
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
    """Return quotients, not a number where there is none: without damping, and in lanes that were never started."""
    return np.divide(values, divisors, out=np.full_like(values, np.nan), where=divisors > 0.0)
