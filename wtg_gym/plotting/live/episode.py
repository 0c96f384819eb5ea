"""One episode that is stepped by hand: what it shows after every step, and how it ended, in words."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.rendering.diagram import describe_event
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.metrics import Recorder, measure
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import LineTrip, Scenario

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Where an episode stands; arrays have one number per WTG group."""

    time_s: float  # since its start [s]
    frequency_hz: float  # of the centre of inertia [Hz]
    rotor_speed_pu: Floats  # [p.u.]
    tip_speed_ratio: Floats  # [-]
    power_pu: Floats  # delivered, on each group's base [p.u.]
    wind_m_s: Floats  # [m/s]


class LiveEpisode:
    """An episode in a lane of its own, started.

    Raises:
        ValueError: a setting is not allowed, or the scenario cannot start; the message says why.
    """

    def __init__(self, settings: EnvSettings, scenario: Scenario) -> None:
        self.scenario = scenario
        self.lanes = TaskLanes(dataclasses.replace(settings, duration_s=scenario.duration_s), 1, 1)
        self._tip_speed = settings.plant().turbine.tip_speed_ratio_per_speed_m_s
        # As `reset` with a scenario of one's own does: a rotor that stands nearly still is refused.
        self.lanes.commit([0], [self.lanes.prepare_given([scenario])])
        self._recorder = Recorder(self.lanes)
        self._stepped = np.ones(1, dtype=np.bool_)

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        outputs = self.lanes.outputs
        return bool(outputs.terminated[0] or outputs.truncated[0])

    @property
    def time_s(self) -> float:
        """Time since its start [s]; of a failure its instant."""
        return float(self.lanes.simulator.lane_values("step")[0]) * self.lanes.settings.simulation_dt

    def step(self, action: npt.ArrayLike = 0.0) -> None:
        """Hold an action (n_action,) for one control interval, of zero by default; after the end nothing happens."""
        if self.over:
            return
        self.lanes.step(np.broadcast_to(np.asarray(action, dtype=np.float64), (1, self.lanes.n_action)).copy())
        self._recorder.record(self._stepped)

    def sample(self) -> Sample:
        """Return where it stands."""
        simulator = self.lanes.simulator
        rotor, wind = (simulator.wtg_values(name)[0] for name in ("rotor_speed", "wind"))
        return Sample(
            time_s=self.time_s,
            frequency_hz=self.lanes.nominal_hz * float(simulator.lane_values("coi")[0]),
            rotor_speed_pu=rotor,
            tip_speed_ratio=self._tip_speed * rotor / wind,
            power_pu=simulator.wtg_values("power")[0],
            wind_m_s=wind,
        )

    def measured(self, name: str) -> Episode:
        """Return it as the evaluator's row of an entry of that name, once it is over."""
        return Episode(
            entry=name,
            training_seed=None,
            seed=-1 if self.scenario.seed is None else self.scenario.seed,
            scenario=self.scenario.name,
            duration_s=self.scenario.duration_s,
            **measure(self.lanes, self._recorder, 0, self.scenario),
        )

    def failure(self) -> str:
        """Return in words why it ended before its time; empty where it did not."""
        status = Status(int(self.lanes.statuses()[0]))
        if status == Status.RUNNING:
            return ""
        now, nominal = self.sample(), self.lanes.simulator.settings.case.frequency_hz
        protection = self.lanes.simulator.settings.protection
        low, high = nominal * protection.frequency_min_pu, nominal * protection.frequency_max_pu
        slowest, fastest = (1 + int(at(now.rotor_speed_pu)) for at in (np.argmin, np.argmax))
        stalled = 1 + int(np.argmin(now.tip_speed_ratio))
        words = {
            Status.STALL: f"group {stalled} stalled: its rotor was too slow for the wind to turn it faster again",
            Status.OVER_SPEED: f"the rotor of group {fastest} was too fast, at {now.rotor_speed_pu.max():.2f} p.u.",
            Status.UNDER_SPEED: f"the rotor of group {slowest} was too slow, below "
            f"{protection.rotor_speed_min_pu:g} p.u.",
            Status.FREQUENCY_LIMIT: f"the frequency left {low:g} … {high:g} Hz, at {now.frequency_hz:.2f} Hz",
            Status.LOSS_OF_SYNCHRONISM: "two units lost synchronism: their angles are more than 180° apart",
            Status.VOLTAGE_COLLAPSE: "the voltage collapsed: a terminal was below 0.85 p.u. for more than 3 s",
            Status.NUMERICAL_FAILURE: "the numbers left every range: a numerical failure",
        }
        return f"after {now.time_s:.1f} s: {words[status]}"


def happened(scenario: Scenario, before_s: float, now_s: float) -> list[tuple[float, str]]:
    """Return (instant [s], words) of what happened after one instant and until another, in order."""
    events = [(event.time_s, describe_event(event)) for event in scenario.events]
    events += [
        (event.end_s, f"line {event.from_bus}–{event.to_bus} closes")
        for event in scenario.events
        if isinstance(event, LineTrip) and event.recloses_after_s is not None
    ]
    return sorted((time_s, words) for time_s, words in events if before_s < time_s <= now_s)
