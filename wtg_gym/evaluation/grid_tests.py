"""Tests that operators ask of grid-forming plants, as named cases: each has a grid, events, a criterion and a figure.

They follow the frameworks in :data:`SOURCES`, which are written for batteries and inverters. Here the wind limits the
power, a phasor model shows nothing faster than 25 ms, and faults are three-phase. The bench is the grid of v1 without
machines: an imposed source at bus 1, behind the reactance of a short-circuit ratio on the rating of all groups.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics import converter, grid, layout, protection
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.trajectory import Trajectory, record
from wtg_gym.policies.entry import Entry, check_version
from wtg_gym.policies.play import play, started_batch
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
class Recording(Trajectory):
    """A test's run, one sample per simulation step and one at the start."""

    def at(self, time_s: float) -> int:
        """Return the sample at an instant, or the last one before it."""
        return int(np.searchsorted(self.time_s, time_s + 1e-9) - 1)

    def total(self) -> layout.Floats:
        """Return the mean power of the groups, on their base, (n,)."""
        return np.asarray(self.power_pu.mean(axis=1))


#: Passed or failed, and the figure.
Verdict = tuple[bool, str]


@dataclass(frozen=True)
class GridTest:
    """A named case; `judge` says of a run that went on with all groups whether it has passed."""

    name: str
    source: str  # keys of SOURCES
    criterion: str
    plant: Callable[[], Plant]
    judge: Callable[[Recording], Verdict]
    events: tuple[sc.Event, ...]
    duration_s: float = 30.0
    wind_m_s: float = 9.2  # gives half the rating
    load_level: float = 1.0

    def scenario(self, plant: Plant) -> sc.Scenario:
        """Return what happens."""
        wind = np.full((len(plant.groups), 1), self.wind_m_s)
        values = {key: getattr(self, key) for key in ("name", "duration_s", "events", "load_level")}
        return sc.Scenario(wind_speed=wind, load_noise_bus=1, **values)

    def verdict(self, run: Recording) -> Verdict:
        """Return whether a run has passed, and the figure or what went wrong."""
        lost = _lost(run)
        return (False, lost) if lost else self.judge(run)


def _grid() -> Plant:
    return get_suite(DEFAULT_SUITE).plant


def _one_machine() -> Plant:
    plant = _grid()
    machines = tuple(machine for machine in plant.case.machines if machine.bus == plant.case.slack_bus)
    return dataclasses.replace(plant, case=dataclasses.replace(plant.case, machines=machines))


def _bench(ratio: float, *, sheds: bool = False) -> Plant:
    """Return the bench at a short-circuit ratio; its relays of load shedding would see the source's frequency."""
    plant = _grid()
    case, mva = plant.case, sum(g.n_turbines for g in plant.groups) * plant.turbine.rated_power_mw
    reactance = case.base_mva / (ratio * mva)
    line = grid.Branch(from_bus=_SOURCE_BUS, to_bus=1, resistance=reactance / _X_TO_R, reactance=reactance)
    bench = dataclasses.replace(
        case,
        name="bench",
        slack_bus=_SOURCE_BUS,
        buses=(*case.buses, grid.Bus(number=_SOURCE_BUS, voltage_pu=1.06)),
        branches=(*case.branches, line),
        machines=(),
        sources=(grid.Source(bus=_SOURCE_BUS),),
    )
    return dataclasses.replace(plant, case=bench, shedding=plant.shedding if sheds else ())


def _longest_beyond(time_s: layout.Floats, beyond: npt.NDArray[np.bool_]) -> float:
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
    if run.status is not protection.Status.RUNNING:
        return f"grid lost after {run.time_s[-1]:.1f} s: {run.status.name.lower().replace('_', ' ')}"
    if not run.connected[-1].all():
        return f"group {', '.join(str(1 + group) for group in np.flatnonzero(~run.connected[-1]))} tripped"
    for level, longest_s in converter.OVER_VOLTAGES:
        if (beyond := _longest_beyond(run.time_s, run.bus_voltage_pu > level)) > longest_s + 0.1:
            return f"above {level:g} p.u. for {beyond:.1f} s"
    return ""


def _takes_over(run: Recording) -> Verdict:
    beyond = _longest_beyond(run.time_s, (run.bus_voltage_pu < 0.8) | (run.bus_voltage_pu > 1.1))
    moves = float(np.ptp(run.frequency_hz[run.at(run.time_s[-1] - 5.0) :]))
    extreme = run.frequency_hz[np.abs(run.frequency_hz - 50.0).argmax()]
    figure = f"{extreme:.2f} Hz, then {run.frequency_hz[-1]:.2f} Hz, {run.shed_energy_mws[-1]:.0f} MW s shed"
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


def _recovers(run: Recording, at_s: Sequence[float]) -> Verdict:
    power, slowest, farthest = run.total(), 0.0, 0.0
    for at in at_s:
        after = slice(run.at(at) + 1, run.at(at + 3.0) + 1)
        times, low = run.time_s[after], (run.bus_voltage_pu[after] < 0.9).any(axis=1)
        slowest = max(slowest, float(times[min(int(np.flatnonzero(low).max(initial=-1)) + 1, low.size - 1)] - at))
        farthest = max(farthest, abs(power[run.at(at + 3.0)] - power[0]))
    figure = f"0.9 p.u. within {slowest:.1f} s, power within {farthest:.3f} p.u."
    return bool(slowest <= 1.5 and farthest <= 0.05), figure


def _leaves_limit(run: Recording) -> Verdict:
    largest, limited = float(run.current_pu.max()), run.limited.max(axis=1)
    reached = limited[run.at(2.0) : run.at(2.5) + 1].any()
    after = max(float(run.time_s[limited].max()) - 2.5, 0.0) if limited.any() else 0.0
    figure = f"{largest:.3f} p.u., {'left' if reached else 'never reached, left'} after {after:.1f} s"
    figure += f", then {run.bus_voltage_pu.max():.2f} p.u. of voltage"
    return bool(reached and largest <= 1.2 + 1e-6 and after <= 0.5), figure


def _fault(bus: int, length_s: float, reactance_pu: float, time_s: float = 2.0) -> tuple[sc.Event, ...]:
    return (sc.Fault(time_s=time_s, bus=bus, clears_after_s=length_s, reactance_pu=reactance_pu),)


def _to_and_fro(rocof_hz_s: float) -> tuple[sc.Event, ...]:
    """Return a move of the source's frequency by 1 Hz, and, 5 s later, back."""
    length = 1.0 / abs(rocof_hz_s)
    return tuple(
        sc.FrequencyRamp(time_s=at, bus=_SOURCE_BUS, rocof_hz_s=rate, duration_s=length)
        for at, rate in ((2.0, rocof_hz_s), (7.0 + length, -rocof_hz_s))
    )


def _tests() -> Iterator[GridTest]:
    takes_over = (
        "0.8 … 1.1 p.u. at all buses but for 0.1 s, 47.5 … 51.5 Hz, steady to 0.1 Hz in the last 5 s; all groups stay"
    )
    # The last machine is lost: also near the groups' limit, and in balance, where the machine gives next to nothing.
    sources, outage = "AEMO, MISO, EU 2016/631", (sc.MachineOutage(time_s=2.0, bus=1),)
    for name, wind, load in (
        ("last-machine", 11.0, 0.92),
        ("last-machine-limit", 14.0, 1.1),
        ("last-machine-balance", 14.0, 1.0),
    ):
        yield GridTest(name, sources, takes_over, _one_machine, _takes_over, outage, 60.0, wind, load)

    follows = "power moves against the frequency within 1 s, and is within 0.05 p.u. at the end; all groups stay"
    for name, sources, rocof_hz_s in (
        ("rocof-up", "AEMO, MISO", 4.0),
        ("rocof-down", "AEMO, MISO", -4.0),
        ("rocof-up-2", "FNN, SJV2024", 2.0),
        ("rocof-down-2", "FNN, SJV2024", -2.0),
    ):
        yield GridTest(name, sources, follows, partial(_bench, 10.0), _follows, _to_and_fro(rocof_hz_s))

    resists = (
        "the grid's angle steps back by 10°, forward by 30°, or as named: at least 0.2 p.u. more power at once "
        "(forward: less), within 0.05 p.u. after 5 s; all groups stay"
    )
    weak = partial(_bench, 3.0)
    for name, sources, angle_deg in (
        ("angle-step", "AEMO, MISO, GC0137", -10.0),
        ("angle-step-30", "AEMO, FNN", -30.0),
        ("angle-step-60", "AEMO", -60.0),
        ("angle-step-forward", "AEMO, FNN", 30.0),
        ("angle-step-forward-60", "AEMO", 60.0),
    ):
        jump = (sc.PhaseJump(time_s=2.0, bus=_SOURCE_BUS, angle_deg=angle_deg),)
        yield GridTest(name, sources, resists, weak, partial(_opposes, forward=angle_deg > 0), jump, 15.0)

    recovers = "150 ms near bus 1; 0.9 p.u. within 1.5 s, power within 0.05 p.u. in 3 s; all groups stay"
    dip = _fault(1, 0.15, 0.02)
    yield GridTest("dip", "FNN, SJV2024", recovers, weak, partial(_recovers, at_s=(2.15,)), dip, 15.0)

    # Faults of 125 ms, some six cycles, at whose clearing the ratio steps.
    steps = "ratio 20 → 10, 3, 2, 1.5, 1.25 at the clearing of faults; each time as for the dip"
    cleared_s, events = [], list[sc.Event]()
    for k, ratio in enumerate((10.0, 3.0, 2.0, 1.5, 1.25)):
        cleared_s.append(2.125 + 8.0 * k)
        step = sc.ReactanceStep(time_s=cleared_s[-1], from_bus=_SOURCE_BUS, to_bus=1, factor=20.0 / ratio)
        events += [*_fault(1, 0.125, 0.05, cleared_s[-1] - 0.125), step]
    judge = partial(_recovers, at_s=cleared_s)
    yield GridTest("ratio-steps", "AEMO, MISO", steps, partial(_bench, 20.0), judge, tuple(events), 45.0, 11.4)

    # All groups and loads lose the source.
    sources, loses = "AEMO, FNN, EU 2016/631", (sc.LineTrip(time_s=2.0, from_bus=_SOURCE_BUS, to_bus=1),)
    sheds = partial(_bench, 10.0, sheds=True)
    for name, wind, load in (("island-surplus", 11.4, 0.9), ("island-deficit", 11.0, 1.0)):
        yield GridTest(name, sources, takes_over, sheds, _takes_over, loses, 60.0, wind, load)

    limit = "500 ms near bus 2: 1.2 p.u. held, left within 0.5 s; over-voltages as in NER; all groups stay"
    fault = _fault(2, 0.5, 0.05)
    yield GridTest("current-limit", "AEMO, GC0137, NER", limit, _grid, _leaves_limit, fault, 30.0, 11.0)


GRID_TESTS = {test.name: test for test in _tests()}


def run_grid_test(test: GridTest, entry: Entry) -> tuple[Recording, Verdict]:
    """Play an entry of version v1 through a test with exact sensors; return what was recorded, and the verdict.

    A PolicyError says that the entry's law has no equilibrium there, or that its policy fails.
    """
    check_version([entry], get_suite(DEFAULT_SUITE))
    plant = test.plant()
    settings = EnvSettings(version=V1.version, sensors="exact", duration_s=test.duration_s, plant=plant)
    actions: list[layout.Floats] = []
    if entry.policy is not None:
        with started_batch(entry, settings, [test.scenario(plant)], 1) as (batch, _):
            actions = [taken for _, taken in play(entry, batch)]
    # Once more with the same actions, so short an interval that every simulation step is seen.
    n_held = round(settings.step_s / plant.simulation_dt)
    finest = dataclasses.replace(settings, control_dt=plant.simulation_dt)
    with started_batch(entry, finest, [test.scenario(plant)], 1) as (batch, _):
        held = actions or [np.zeros((1, batch.n_action))]
        run = Recording(**record(batch.simulator, lambda step: batch.step(held[min(step // n_held, len(held) - 1)])))
    return run, test.verdict(run)
