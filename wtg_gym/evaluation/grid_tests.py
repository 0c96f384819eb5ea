"""Tests that operators ask of grid-forming plants, as named cases: each has a grid, events, a criterion and a figure.

They follow the frameworks in :data:`SOURCES`, which are written for batteries and inverters. Here the wind limits the
power, a phasor model shows nothing faster than 25 ms, and faults are three-phase. The bench is the grid of v1 without
machines: an imposed source at bus 1, behind the reactance of a short-circuit ratio on the rating of all groups.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.converter import OVER_VOLTAGES
from wtg_gym.physics.grid import Branch, Bus, NetworkCase, Source
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import (
    Event,
    Fault,
    FrequencyRamp,
    LineTrip,
    MachineOutage,
    PhaseJump,
    ReactanceStep,
    Scenario,
)
from wtg_gym.physics.units import BUSES
from wtg_gym.policies.entry import Entry, check_version
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.scenarios.suites import DEFAULT_SUITE, get_suite
from wtg_gym.tasks import V1

#: What the short keys in each test's `source` stand for.
SOURCES = {
    "AEMO": "Voluntary Specification for Grid-forming Inverters: Core Requirements Test Framework (January 2024)",
    "MISO": "Business Practices Manual 015 r32, appendix H (2025), with pass criteria",
    "GC0137": "National Grid ESO: Grid Code modification GC0137 (2022)",
    "FNN": "VDE FNN: Guideline on grid-forming behaviour of HVDC systems and DC-connected power park modules (2020)",
    "SJV2024": "Fingrid: Specific study requirements for grid energy storage systems SJV2024",
    "NER": "Australian National Electricity Rules, S5.2.5.4, automatic access standard",
    "EU 2016/631": "Commission Regulation (EU) 2016/631",
}
#: The bus of the imposed source, behind bus 1.
_SOURCE_BUS = 15
#: X/R of the source's impedance. Source: MISO, tests H-2 … H-4.
_X_TO_R = 6.0


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A test's run, one sample per simulation step and one at the start; shapes (n,) and (n, n_group)."""

    time_s: Floats
    frequency_hz: Floats  # of the centre of inertia
    voltage_pu: Floats  # at every bus (n, n_bus)
    power_pu: Floats
    current_pu: Floats
    limited: npt.NDArray[np.bool_]  # whether the current limiter takes voltage away
    connected: npt.NDArray[np.bool_]
    status: Status
    shed_mws: float  # load not served [MW s]

    def at(self, time_s: float) -> int:
        """Return the sample at an instant, or the last one before it."""
        return int(np.searchsorted(self.time_s, time_s + 1e-9) - 1)

    def total(self) -> Floats:
        """Return the mean power of the groups, on their base, (n,)."""
        mean: Floats = self.power_pu.mean(axis=1)
        return mean

    @property
    def lives(self) -> bool:
        """Whether the run went to its end with all groups connected."""
        return self.status is Status.RUNNING and bool(self.connected[-1].all())


#: Passed or failed, and the figure.
Verdict = tuple[bool, str]


@dataclass(frozen=True, kw_only=True)
class GridTest:
    """A named case; `judge` says of a run that went on with all groups whether it has passed."""

    name: str
    source: str  # keys of SOURCES
    criterion: str
    plant: Callable[[], Plant]
    wind_m_s: float = 9.2  # gives half the rating
    load_level: float = 1.0
    duration_s: float = 30.0
    events: tuple[Event, ...]
    judge: Callable[[Recording], Verdict]

    def scenario(self, plant: Plant) -> Scenario:
        """Return what happens."""
        return Scenario(
            name=self.name,
            wind_speed=np.full((len(plant.groups), 1), self.wind_m_s),
            duration_s=self.duration_s,
            events=self.events,
            load_level=self.load_level,
            load_noise_bus=1,
        )

    def verdict(self, run: Recording) -> Verdict:
        """Return whether a run has passed, and the figure or what went wrong."""
        lost = _lost(run)
        return (False, lost) if lost else self.judge(run)


def _grid() -> Plant:
    """Return the plant of version v1."""
    return get_suite(DEFAULT_SUITE).plant


def _one_machine() -> Plant:
    """Return v1's grid with its generator only."""
    plant = _grid()
    machines = tuple(machine for machine in plant.case.machines if machine.bus == plant.case.slack_bus)
    return dataclasses.replace(plant, case=dataclasses.replace(plant.case, machines=machines))


def _bench(ratio: float, **changes: Any) -> Plant:
    """Return the bench at a short-circuit ratio; without relays of load shedding (`shedding=()`) or with them."""
    plant = _grid()
    case, mva = plant.case, sum(g.n_turbines for g in plant.groups) * plant.turbine.rated_power_mw
    reactance = case.base_mva / (ratio * mva)
    line = Branch(from_bus=_SOURCE_BUS, to_bus=1, resistance=reactance / _X_TO_R, reactance=reactance)
    bench = NetworkCase(
        name="bench",
        base_mva=case.base_mva,
        frequency_hz=case.frequency_hz,
        slack_bus=_SOURCE_BUS,
        buses=(*case.buses, Bus(number=_SOURCE_BUS, voltage_pu=1.06)),
        branches=(*case.branches, line),
        machines=(),
        sources=(Source(bus=_SOURCE_BUS),),
    )
    return dataclasses.replace(plant, case=bench, **changes)


def _strong() -> Plant:
    # Relays would see the source's frequency.
    return _bench(10.0, shedding=())


def _weak() -> Plant:
    return _bench(3.0, shedding=())


# --- criteria ---------------------------------------------------------------------------------------------------------


def _longest_beyond(time_s: Floats, beyond: npt.NDArray[np.bool_]) -> float:
    """Return the longest time that a quantity may lie beyond a limit, by its samples (n, any) [s]."""
    longest = 0.0
    for column in beyond.T:
        changes = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(int), [0]])))
        for first, last in zip(changes[::2], changes[1::2], strict=True):
            # From the last sample before to the last one beyond.
            longest = max(longest, float(time_s[last - 1] - time_s[max(first - 1, 0)]))
    return longest


def _lost(run: Recording) -> str:
    """Return why a run did not go on with all groups, or nothing."""
    if run.status is not Status.RUNNING:
        return f"grid lost after {run.time_s[-1]:.1f} s: {run.status.name.lower().replace('_', ' ')}"
    if not run.connected[-1].all():
        return f"group {', '.join(str(1 + group) for group in np.flatnonzero(~run.connected[-1]))} tripped"
    for level, longest_s in OVER_VOLTAGES:
        if (beyond := _longest_beyond(run.time_s, run.voltage_pu > level)) > longest_s + 0.1:
            return f"above {level:g} p.u. for {beyond:.1f} s"
    return ""


def _takes_over(run: Recording) -> Verdict:
    beyond = _longest_beyond(run.time_s, (run.voltage_pu < 0.8) | (run.voltage_pu > 1.1))
    moves = float(np.ptp(run.frequency_hz[run.at(run.time_s[-1] - 5.0) :]))
    extreme = run.frequency_hz[np.abs(run.frequency_hz - 50.0).argmax()]
    figure = f"{extreme:.2f} Hz, then {run.frequency_hz[-1]:.2f} Hz, {run.shed_mws:.0f} MW s shed"
    if beyond > 0.1 + 1e-9:
        return False, f"{figure}; voltage beyond its range for {beyond:.1f} s"
    if moves > 0.1:
        return False, f"{figure}; still moves, {moves:.2f} Hz in the last 5 s"
    return True, figure


def _follows(run: Recording) -> Verdict:
    power, before = run.total(), run.at(2.0)
    moved = power[before : run.at(3.0) + 1] - power[before]
    peak, rest = moved[np.abs(moved).argmax()], abs(power[-1] - power[before])
    against = peak * (run.frequency_hz[run.at(6.0)] - 50.0) < 0.0
    return bool(against and rest <= 0.05), f"ΔP {peak:+.2f} p.u., back within {rest:.3f} p.u."


def _opposes(run: Recording, forward: bool) -> Verdict:
    power, before = run.total(), run.at(2.0)
    # At the end of the first simulation step with the new angle.
    first = float(power[before + 1] - power[before])
    rest = abs(power[run.at(7.0)] - power[before])
    opposes = (-first if forward else first) >= 0.2
    return bool(opposes and rest <= 0.05), f"ΔP {first:+.2f} p.u., back within {rest:.3f} p.u."


def _recovers(run: Recording, cleared_s: Sequence[float]) -> Verdict:
    power, slowest, farthest = run.total(), 0.0, 0.0
    for at in cleared_s:
        after = slice(run.at(at) + 1, run.at(at + 3.0) + 1)
        times, low = run.time_s[after], (run.voltage_pu[after] < 0.9).any(axis=1)
        slowest = max(slowest, float(times[min(int(np.flatnonzero(low).max(initial=-1)) + 1, low.size - 1)] - at))
        farthest = max(farthest, abs(power[run.at(at + 3.0)] - power[0]))
    figure = f"0.9 p.u. within {slowest:.1f} s, power within {farthest:.3f} p.u."
    return bool(slowest <= 1.5 and farthest <= 0.05), figure


def _leaves_limit(run: Recording) -> Verdict:
    largest, limited = float(run.current_pu.max()), run.limited.max(axis=1)
    reached = limited[run.at(2.0) : run.at(2.5) + 1].any()
    after = max(float(run.time_s[limited].max()) - 2.5, 0.0) if limited.any() else 0.0
    figure = f"{largest:.3f} p.u., {'left' if reached else 'never reached, left'} after {after:.1f} s"
    figure += f", then {run.voltage_pu.max():.2f} p.u. of voltage"
    return bool(reached and largest <= 1.2 + 1e-6 and after <= 0.5), figure


# --- the tests --------------------------------------------------------------------------------------------------------


_RATIOS = (10.0, 3.0, 2.0, 1.5, 1.25)
#: A fault of 125 ms, some six cycles, before each step of the ratio, which happens at its clearing.
_STEPS = tuple(
    event
    for k, ratio in enumerate(_RATIOS)
    for event in (
        Fault(time_s=2.0 + 8.0 * k, bus=1, clears_after_s=0.125, reactance_pu=0.05),
        ReactanceStep(time_s=2.125 + 8.0 * k, from_bus=_SOURCE_BUS, to_bus=1, factor=20.0 / ratio),
    )
)

_TAKES_OVER = (
    "0.8 … 1.1 p.u. at every bus except for 0.1 s, 47.5 … 51.5 Hz, in the last 5 s within 0.1 Hz; all groups stay"
)
_FOLLOWS = "power moves against the frequency at once, and is within 0.05 p.u. at the end; all groups stay"
_RESISTS = (
    "the grid's angle steps back by 10°, forward by 30°, or as named: at least 0.2 p.u. more power at once (forward: "
    "less), within 0.05 p.u. after 5 s; all groups stay"
)


def _ramp(name: str, source: str, rocof_hz_s: float) -> GridTest:
    """Return a test in which the source's frequency moves by 1 Hz, stays for 5 s, and comes back."""
    length = 1.0 / abs(rocof_hz_s)
    events = tuple(
        FrequencyRamp(time_s=at, bus=_SOURCE_BUS, rocof_hz_s=rate, duration_s=length)
        for at, rate in ((2.0, rocof_hz_s), (7.0 + length, -rocof_hz_s))
    )
    return GridTest(name=name, source=source, criterion=_FOLLOWS, plant=_strong, events=events, judge=_follows)


def _jump(name: str, source: str, angle_deg: float) -> GridTest:
    """Return a test in which the source's angle steps forward, or back by a negative one."""
    return GridTest(
        name=name,
        source=source,
        criterion=_RESISTS,
        plant=_weak,
        duration_s=15.0,
        events=(PhaseJump(time_s=2.0, bus=_SOURCE_BUS, angle_deg=angle_deg),),
        judge=lambda run: _opposes(run, angle_deg > 0.0),
    )


def _last_machine(name: str, wind_m_s: float, load_level: float) -> GridTest:
    """Return a test in which the last machine is lost."""
    return GridTest(
        name=name,
        source="AEMO, MISO, EU 2016/631",
        criterion=_TAKES_OVER,
        plant=_one_machine,
        wind_m_s=wind_m_s,
        load_level=load_level,
        duration_s=60.0,
        events=(MachineOutage(time_s=2.0, bus=1),),
        judge=_takes_over,
    )


def _island(name: str, **more: Any) -> GridTest:
    """Return a test in which all groups and loads lose the source."""
    return GridTest(
        name=name,
        source="AEMO, FNN, EU 2016/631",
        criterion=_TAKES_OVER,
        plant=lambda: _bench(10.0),
        duration_s=60.0,
        events=(LineTrip(time_s=2.0, from_bus=_SOURCE_BUS, to_bus=1),),
        judge=_takes_over,
        **more,
    )


GRID_TESTS: dict[str, GridTest] = {
    test.name: test
    for test in (
        _last_machine("last-machine", 11.0, 0.92),
        # Near their limit the groups get more load than they can carry.
        _last_machine("last-machine-limit", 14.0, 1.1),
        # The wind gives what is needed, whatever the law, and the machine next to nothing.
        _last_machine("last-machine-balance", 14.0, 1.0),
        _ramp("rocof-up", "AEMO, MISO", 4.0),
        _ramp("rocof-down", "AEMO, MISO", -4.0),
        _ramp("rocof-up-2", "FNN, SJV2024", 2.0),
        _ramp("rocof-down-2", "FNN, SJV2024", -2.0),
        _jump("angle-step", "AEMO, MISO, GC0137", -10.0),
        _jump("angle-step-30", "AEMO, FNN", -30.0),
        _jump("angle-step-60", "AEMO", -60.0),
        _jump("angle-step-forward", "AEMO, FNN", 30.0),
        _jump("angle-step-forward-60", "AEMO", 60.0),
        GridTest(
            name="dip",
            source="FNN, SJV2024",
            criterion="150 ms near bus 1; 0.9 p.u. within 1.5 s, power within 0.05 p.u. in 3 s; all groups stay",
            plant=_weak,
            duration_s=15.0,
            events=(Fault(time_s=2.0, bus=1, clears_after_s=0.15, reactance_pu=0.02),),
            judge=lambda run: _recovers(run, (2.15,)),
        ),
        GridTest(
            name="ratio-steps",
            source="AEMO, MISO",
            criterion="ratio 20 → 10, 3, 2, 1.5, 1.25 at the clearing of faults; each time as for the dip",
            plant=lambda: _bench(20.0, shedding=()),
            wind_m_s=11.4,
            duration_s=45.0,
            events=_STEPS,
            judge=lambda run: _recovers(run, [2.125 + 8.0 * k for k in range(len(_RATIOS))]),
        ),
        _island("island-surplus", wind_m_s=11.4, load_level=0.9),
        _island("island-deficit", wind_m_s=11.0),
        GridTest(
            name="current-limit",
            source="AEMO, GC0137, NER",
            criterion="500 ms near bus 2: 1.2 p.u. held, left within 0.5 s; over-voltages as in NER; all groups stay",
            plant=_grid,
            wind_m_s=11.0,
            events=(Fault(time_s=2.0, bus=2, clears_after_s=0.5, reactance_pu=0.05),),
            judge=_leaves_limit,
        ),
    )
}


def run_grid_test(test: GridTest, entry: Entry) -> tuple[Recording, Verdict]:
    """Play an entry of version v1 through a test; its sensors are exact.

    Returns:
        what was recorded, whether it has passed, and the figure.

    Raises:
        PolicyError: the entry's law has no equilibrium there, or its policy fails.
        ValueError: the entry is of another version.
    """
    check_version([entry], get_suite(DEFAULT_SUITE))
    plant = test.plant()
    settings = EnvSettings(version=V1.version, sensors="exact", duration_s=test.duration_s, plant=plant)
    actions: list[Floats] = []
    if entry.policy is not None:
        with started_lanes(entry, settings, [test.scenario(plant)], 1) as (lanes, _):
            collections.deque(play(entry, lanes, actions), maxlen=0)
    # Once more with the same actions, so short an interval that every simulation step is seen.
    n_held = round(settings.step_s / plant.simulation_dt)
    finest = dataclasses.replace(settings, control_dt=plant.simulation_dt)
    samples: list[tuple[Any, ...]] = []
    with started_lanes(entry, finest, [test.scenario(plant)], 1) as (lanes, _):
        simulator = lanes.simulator
        magnitudes = simulator.layout.rows_of(BUSES, "magnitude")
        names = ("power", "current", "cut", "connected")

        def sample() -> None:
            time_s = simulator.lane_values("step")[0] * plant.simulation_dt
            groups = [simulator.wtg_values(name)[0] for name in names]
            voltages = np.array([simulator.values(row)[0] for row in magnitudes])
            samples.append((time_s, simulator.lane_values("coi")[0], voltages, *groups))

        sample()
        for step in range(round(test.duration_s / plant.simulation_dt)):
            lanes.step(actions[min(step // n_held, len(actions) - 1)] if actions else np.zeros((1, lanes.n_action)))
            sample()
            if lanes.ended()[0].any():
                break
        status = Status(int(simulator.lane_values("status")[0]))
        shed = simulator.lane_values("shed_energy")[0] * plant.case.base_mva
    time_s, coi, voltages, power, current, cut, connected = (np.array(column) for column in zip(*samples, strict=True))
    run = Recording(
        time_s=time_s,
        frequency_hz=plant.case.frequency_hz * coi,
        voltage_pu=voltages,
        power_pu=power,
        current_pu=current,
        limited=cut > 1e-9,
        connected=connected > 0.5,
        status=status,
        shed_mws=float(shed),
    )
    return run, test.verdict(run)
