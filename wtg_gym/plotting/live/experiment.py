"""An experiment: wind, events, law and grid as settings, and the run that they make."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from wtg_gym.analysis.power_frequency import Characteristic, characteristic
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.recording import Recording, recorded
from wtg_gym.physics.parameters import default_groups
from wtg_gym.physics.scenario import EVENT_KINDS, Event, GroupTrip, LineTrip, LoadStep, Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, TrackingLaw, get_law
from wtg_gym.plotting.live.episode import LiveEpisode
from wtg_gym.scenarios import TRIPPABLE_LINES, get_suite

#: The suites whose grids can be tried: their names, and what they are.
PLANTS: Mapping[str, str] = {
    "paper-v1": "v1: three fifths wind, four groups",
    "paper": "v0: the paper's grid, groups at bus 2",
}
#: Most WTG groups that can be asked for, where the plant leaves it open.
MOST_GROUPS = 4
#: Kinds of events that can be chosen, in words; "" is none.
KINDS: Mapping[str, str] = {
    "": "none",
    "load_step": "load step",
    "load_trip": "load lost",
    "line_trip": "line opens",
    "governor_loss": "governor lost",
    "machine_outage": "machine lost",
    "group_trip": "WTG group lost",
}
#: At which the steady states are shown [p.u.]: as far as the law's k changes, and a little more.
_FREQUENCIES = np.linspace(0.985, 1.015, 25)


def places(kind: str, n_groups: int) -> list[str]:
    """Return where an event of a kind may strike: buses, lines "2–3" or groups, as texts; nothing for none."""
    case = get_suite("paper").plant.settings(classical=False).case
    if kind in ("load_step", "load_trip"):
        return [str(bus.number) for bus in case.buses if bus.load_mw > 0.0]
    if kind == "line_trip":
        return [f"{a}–{b}" for a, b in TRIPPABLE_LINES]
    if kind == "governor_loss":
        return [str(machine.bus) for machine in case.machines if machine.governor is not None]
    if kind == "machine_outage":
        return [str(machine.bus) for machine in case.machines if machine.bus != case.slack_bus]
    if kind == "group_trip":
        return [str(1 + group) for group in range(n_groups)]
    return []


@dataclass(frozen=True, kw_only=True)
class Strike:
    """An event as it is chosen."""

    kind: str = ""  # of :data:`KINDS`; "" is none
    time_s: float = 5.0  # when [s]
    place: str = ""  # of :func:`places`
    power_mw: float = 30.0  # of a load step; the others have no size [MW]

    def event(self) -> Event | None:
        """Return the event; None for none. A ValueError says what is wrong with it."""
        if not self.kind:
            return None
        try:
            numbers = [int(part) for part in self.place.split("–")]
        except ValueError:
            raise ValueError(f"{KINDS[self.kind]}: choose where, got {self.place!r}") from None
        first = numbers[0]
        if self.kind == "load_step":
            return LoadStep(time_s=self.time_s, bus=first, power_mw=self.power_mw)
        if self.kind == "line_trip":
            return LineTrip(time_s=self.time_s, from_bus=first, to_bus=numbers[-1])
        if self.kind == "group_trip":
            return GroupTrip(time_s=self.time_s, group=first - 1)
        event: Event = EVENT_KINDS[self.kind](time_s=self.time_s, bus=first)
        return event


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Everything that can be chosen."""

    plant: str = "paper-v1"  # of :data:`PLANTS`
    wind_m_s: tuple[float, ...] = (10.5, 10.0, 9.5, 9.0)  # one per WTG group [m/s]
    strikes: tuple[Strike, ...] = (Strike(kind="load_step", place="3"),)  # events
    law: TrackingLaw = field(default_factory=lambda: get_law(REFERENCE_STRATEGY))  # of all groups
    inertia_scale: float = 0.5  # factor on the inertia of the synchronous machines
    governor_droop: float = 0.05  # [p.u.]
    duration_s: float = 60.0  # [s]

    def scenario(self) -> Scenario:
        """Return what happens, as a scenario; a ValueError says what cannot be."""
        n = len(self.wind_m_s)
        for strike in self.strikes:
            # The simulator's errors count from 0, as its indices do.
            if strike.kind == "group_trip" and strike.place not in places("group_trip", n):
                raise ValueError(f"there is no group {strike.place} to lose: the grid has {n}")
        events = [event for strike in self.strikes if (event := strike.event()) is not None]
        return Scenario(
            name="explored",
            wind_speed=np.array(self.wind_m_s)[:, np.newaxis],
            duration_s=self.duration_s,
            events=tuple(sorted(events, key=lambda event: event.time_s)),
            governor_droop=self.governor_droop,
            inertia_scale=self.inertia_scale,
        )

    def settings(self) -> EnvSettings:
        """Return the environment that it runs in; a ValueError says what is not allowed."""
        n, own = len(self.wind_m_s), len(get_suite(self.plant).plant.groups)
        if n != own and self.plant != "paper":
            raise ValueError(f"this grid has {own} WTG groups, got wind for {n}")
        # Nothing acts: with k alone the actions ask no short step of a fast damping.
        return EnvSettings(
            suite=self.plant,
            scenario=self.scenario(),
            strategy=self.law,
            action_mode="k",
            groups=None if n == own else n,
        )

    def run(self) -> Explored:
        """Return what happens; a ValueError says why it cannot."""
        settings, scenario = self.settings(), self.scenario()
        try:
            live = LiveEpisode(settings, scenario)
        except ValueError as error:
            # The simulator counts groups from 0, the page from 1.
            said = re.sub(r"(?<=WTG group )\d+(?= at bus)", lambda found: str(1 + int(found[0])), str(error))
            raise ValueError(said) from None

        def steps() -> Iterator[npt.NDArray[np.bool_]]:
            while not live.over:
                live.step()
                yield np.ones(1, dtype=np.bool_)

        recording = recorded(live.lanes, steps())
        return Explored(
            experiment=self,
            recording=recording,
            episode=live.measured(self.law.name),
            failure=live.failure(),
            nominal_hz=live.lanes.nominal_hz,
        )

    def to_json(self) -> str:
        """Return the scenario as JSON on one line, which `wtg-gym simulate --scenario` takes."""
        return self.scenario().to_json()

    def command(self) -> str:
        """Return the command that runs the same on that JSON, in a file explored.json."""
        built_in = _built_in(self.law)
        law = "law.toml" if built_in is None else built_in
        n, suite = len(self.wind_m_s), get_suite(self.plant)
        grid = "" if self.plant == "paper" else f" --suite {suite.name}"
        groups = "" if n == len(suite.plant.groups) else f" --groups {n}"
        return f"wtg-gym simulate --scenario explored.json{grid}{groups} --strategy {law}"

    def law_toml(self) -> str:
        """Return the law as the file law.toml that the command needs; empty for a built-in strategy."""
        if _built_in(self.law) is not None:
            return ""
        tau = self.law.damping_time_constant_s
        return "\n".join(
            (
                f"name = {json.dumps(self.law.name)}",
                f"k_min = {self.law.k_min!r}",
                f"k_nominal = {self.law.k_nominal!r}",
                f"k_max = {self.law.k_max!r}",
                f"tau_s = {'inf' if math.isinf(tau) else repr(float(tau))}",
                "",
            )
        )


def _built_in(law: TrackingLaw) -> str | None:
    """Return the name of the built-in strategy that a law is; None if it is none."""
    try:
        return law.name if get_law(law.name) == law else None
    except ValueError:
        return None


@dataclass(frozen=True, kw_only=True)
class Explored:
    """What an experiment gave."""

    experiment: Experiment  # itself
    recording: Recording  # its course, of one scenario
    episode: Episode  # its numbers
    failure: str  # in words why it ended before its time; empty where it did not
    nominal_hz: float  # [Hz]

    def numbers(self) -> dict[str, str]:
        """Return its key figures in words and with units."""
        metrics = {name: float(value) for name, value in self.episode.metrics.items() if value is not None}
        return {
            "nadir": f"{metrics['nadir_hz']:.3f} Hz",
            "zenith": f"{metrics['zenith_hz']:.3f} Hz",
            "RoCoF (0.5 s)": f"{metrics['largest_rocof_hz_s']:.3f} Hz/s",
            "slowest rotor": f"{metrics['least_rotor_speed_pu']:.3f} p.u.",
            "peak power": f"{metrics['peak_power_pu']:.3f} p.u.",
            "cost": f"{metrics['cost']:.2f}",
        }

    def group_characteristic(self, group: int) -> Characteristic:
        """Return the steady states of a group's law at its wind over the frequency."""
        return _characteristic(self.experiment.law, float(self.experiment.wind_m_s[group]))


@functools.lru_cache(maxsize=256)
def _characteristic(law: TrackingLaw, wind_m_s: float) -> Characteristic:
    return characteristic(law, wind_m_s, _FREQUENCIES)


def default_experiment(plant: str) -> Experiment:
    """Return the experiment that a page starts with in a grid of :data:`PLANTS`."""
    if plant == "paper":
        wind = get_suite("paper").cases[0].wind_speed_m_s
        strike = Strike(kind="load_step", place="2", power_mw=75.0)
        return Experiment(plant=plant, wind_m_s=wind[: len(default_groups())], strikes=(strike,), inertia_scale=1.0)
    return Experiment(plant=plant)
