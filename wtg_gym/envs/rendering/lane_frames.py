"""Samples of running episodes and their frames, in environments that render."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TERMINATION_REASONS, TaskLanes
from wtg_gym.envs.observation import FREQUENCY_UNIT_HZ, MeasuredObservation
from wtg_gym.envs.rendering.frame import FramePainter
from wtg_gym.envs.rendering.panels import MEASURED, PANELS, Episode, limited_panels, n_traces
from wtg_gym.envs.rendering.window import Window
from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.envs.task_records import N_GROUP_ROWS, N_TASK_ROWS
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.sensors import SensorInput

#: A frame, (height, width, 3).
Frame = npt.NDArray[np.uint8]


class LaneFrames:
    """Frames of the episodes in lanes.

    Every lane's samples lie at their control steps, so that after a return to an earlier step only the steps before it
    are drawn. Painter and window are not copied along.

    Args:
        lanes: the episodes.
        opens_window: whether :meth:`show` will be called.
        fps: frames per second in a window.

    Raises:
        DependencyNotInstalled: matplotlib, or for a window pygame, is missing.
    """

    def __init__(self, lanes: TaskLanes, *, opens_window: bool = False, fps: int = 10) -> None:
        self._lanes = lanes
        self._opens_window, self._fps = opens_window, fps
        n = lanes.simulator.n_intervals + 1
        self._sensed = lanes.suite.benchmark.sensed
        n_columns = 1 + n_traces(lanes.n_wtg) + self._sensed * len(MEASURED) * lanes.n_wtg
        self._samples = np.full((lanes.n_lanes, n, n_columns), np.nan, dtype=np.float32)
        plant = lanes.settings.plant()
        self._panels = [limited_panels(plant, wind_sensor=has_wind) for has_wind in (False, True)]
        self._make_tools()

    def _make_tools(self) -> None:
        self._painter = FramePainter(self._lanes.n_lanes)
        self._window = Window(self._lanes.suite.benchmark.env_id, self._fps) if self._opens_window else None

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key not in ("_painter", "_window")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._make_tools()

    def sample(self) -> None:
        """Write down where every lane stands: after a reset and after every step."""
        lanes, simulator = self._lanes, self._lanes.simulator
        rotor, wind = simulator.wtg_values("rotor_speed"), simulator.wtg_values("wind")
        rate = simulator.wtg_values("inv_tau")
        columns = [
            simulator.lane_values("step")[:, None] * simulator.plant.simulation_dt,
            lanes.nominal_hz * simulator.lane_values("coi")[:, None],
            lanes.task_values("rocof")[:, None],
            rotor,
            _tip_speed_ratios(rotor, wind),
            simulator.wtg_values("power"),
            simulator.wtg_values("coefficient"),
            _quotients(np.ones_like(rate), rate),
            wind,
            *(self._measurements() if self._sensed else ()),
        ]
        self._samples[np.arange(lanes.n_lanes), self._places()] = np.concatenate(columns, axis=1)

    def _measurements(self) -> tuple[npt.NDArray[np.float64], ...]:
        """Return what the sensors of every lane say, in the order of :data:`MEASURED`, each (n_lanes, n_wtg)."""
        lanes = self._lanes
        n_own = lanes.n_local + sum(ACTION_MODES[lanes.settings.action_mode])
        own = lanes.observations[:, : lanes.n_wtg * n_own].reshape(lanes.n_lanes, lanes.n_wtg, n_own)
        values = np.moveaxis(own[..., : lanes.n_local].astype(np.float64), -1, 0)
        seen = dict(zip(MeasuredObservation._fields, values, strict=True))
        # Without a wind sensor the tip-speed ratio is unknown too.
        has_wind = self._sensor_values("wind_sensor")[:, None] > 0.5
        rotor, wind = 1.0 + 0.25 * seen["rotor_speed"], np.where(has_wind, 10.0 + 5.0 * seen["wind"], np.nan)
        frequency = lanes.nominal_hz + FREQUENCY_UNIT_HZ * seen["frequency_deviation"]
        return frequency, seen["rocof"], _tip_speed_ratios(rotor, wind), rotor, seen["power"], wind

    def _sensor_values(self, name: str) -> npt.NDArray[np.float64]:
        """Return a number of :class:`~wtg_gym.physics.sensors.SensorInput` of every lane (n_lanes,)."""
        lanes = self._lanes
        # They follow the task's own rows, the frequency's history and the groups' rows.
        first = N_TASK_ROWS + int(lanes.task["n_window"][0]) + 1 + lanes.n_wtg * N_GROUP_ROWS
        row = lanes.simulator.layout.rows.extra + first + SensorInput._fields.index(name)
        return lanes.simulator.values(row)

    def _places(self) -> npt.NDArray[np.int64]:
        """Return the control step at which each lane stands (n_lanes,); an end within one counts as its end."""
        steps = self._lanes.simulator.lane_values("step") / self._lanes.simulator.plant.n_substeps
        return np.ceil(steps).astype(np.int64)

    def paint(self) -> tuple[Frame, ...]:
        """Return the frame of every lane.

        Raises:
            RuntimeError: an episode was never started.
        """
        if not (self._lanes.task_values("end_step") > 0.0).all():
            raise RuntimeError("there is no episode to render; call reset() before render()")
        return tuple(self._painter.paint(self._episode(lane)) for lane in range(self._lanes.n_lanes))

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
        return self._samples.copy()

    def restore(self, samples: Any) -> None:
        """Go back to a :meth:`snapshot`; with None, from an environment that does not render, the past is unknown."""
        self._samples[:] = np.nan if samples is None else samples
        self.sample()

    def _episode(self, lane: int) -> Episode:
        lanes = self._lanes
        samples = self._samples[lane, : int(self._places()[lane]) + 1].astype(np.float64)
        terms = lanes.cost_sums()[lane].tolist()
        failed, over = bool(lanes.outputs.terminated[lane]), bool(lanes.outputs.truncated[lane])
        reason = TERMINATION_REASONS[Status(int(lanes.statuses()[lane]))]
        seed = int(lanes.scenario_seeds[lane])
        panels, note = PANELS, ""
        if self._sensed:
            has_wind = bool(self._sensor_values("wind_sensor")[lane] > 0.5)
            panels = self._panels[has_wind]
            delay_s = self._sensor_values("delay")[lane] * lanes.settings.control_dt
            note = "pale lines: measured" + (f", {delay_s:g} s late" if delay_s > 0.0 else "")
            note += "" if has_wind else ", no wind sensor"
        return Episode(
            env_id=lanes.suite.benchmark.env_id,
            heading="scenario of one's own" if seed < 0 else f"scenario {seed}",
            duration_s=float(lanes.task_values("end_step")[lane]) * lanes.simulator.plant.simulation_dt,
            time_s=samples[:, 0],
            panels=panels,
            traces=samples[:, 1:],
            events=lanes.events[lane],
            group_buses=tuple(group.bus for group in lanes.simulator.settings.groups),
            total_reward=-float(sum(terms)),
            n_violated=round(float(lanes.task_values("constraint_sum")[lane])),
            outcome=reason if failed else "time over" if over else "",
            failed=failed,
            note=note,
        )


def _tip_speed_ratios(rotor: npt.NDArray[np.float64], wind: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return TurbineParameters().tip_speed_ratio_per_speed_m_s * _quotients(rotor, wind)


def _quotients(values: npt.NDArray[np.float64], divisors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return quotients, not a number where there is none: without damping, and in lanes that were never started."""
    return np.divide(values, divisors, out=np.full_like(values, np.nan), where=divisors > 0.0)
