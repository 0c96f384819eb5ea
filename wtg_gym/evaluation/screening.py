"""Events that some law survives: what a grid's suite draws is found by simulation when the suite is made."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.equilibrium import StartError
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.linearisation import moving_matrix, swing_modes
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import (
    Event,
    Fault,
    GovernorLoss,
    LineTrip,
    LoadTrip,
    MachineOutage,
    Scenario,
)
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import group_laws
from wtg_gym.scenarios.grid_suite import GridSuite, all_places, unscreened
from wtg_gym.scenarios.strata import Places

Place = TypeVar("Place")
Flags = npt.NDArray[np.bool_]
#: Laws of which one has to survive.
LAWS = ("coordinated-tuned", "coordinated-free", "coordinated-piecewise", "deloaded-10", "mppt")
#: Lanes that are simulated at once.
_AT_ONCE = 64


def survived(plant: Plant, scenarios: Sequence[Scenario], laws: Sequence[str] = LAWS) -> Flags:
    """Return which scenarios every law survives, (n_laws, n_scenarios); one that cannot start is not survived."""
    found = np.zeros((len(laws), len(scenarios)), dtype=np.bool_)
    duration_s = max(scenario.duration_s for scenario in scenarios)
    with closing(Simulator(plant, n_lanes=min(_AT_ONCE, len(scenarios)), duration_s=duration_s)) as simulator:
        for row, name in zip(found, laws, strict=True):
            own = group_laws(name, plant.turbines, plant.control)
            for first in range(0, len(scenarios), simulator.n_lanes):
                lanes = []
                for place in range(first, min(first + simulator.n_lanes, len(scenarios))):
                    try:
                        simulator.start(place - first, scenarios[place], own)
                    except StartError:
                        continue
                    lanes.append(place - first)
                for _ in range(simulator.n_intervals):
                    simulator.advance()
                row[first + np.array(lanes, dtype=np.int64)] = simulator.lane_values("status")[lanes] == Status.RUNNING
    return found


#: Scenarios that an event has to be survived in, and when it strikes, and how long after it the run ends [s].
_N_POINTS, _STRIKES_S, _AFTERWARDS_S = 6, 1.0, 30.0
#: How long a short circuit lasts [s].
_CLEARED_S = 0.2
#: Scenarios that sizes are tried on, and the largest share of them that no law survives.
_N_TRIED, _LOST = 300, 0.01
#: Training scenarios whose operating points have to start.
_N_STARTED = 1000
#: Operating points whose modes are looked at, and the least damping of these [-].
_N_DAMPED, _LEAST_DAMPING = 100, 0.02
#: Share of a place's scenarios under which, where no law survives them, the place is left out.
_LOST_AT_PLACE = 0.1
_SMALLER, _LEAST_SIZE = 0.9, 0.1
#: Sizes after which fewer scenarios must be lost.
_PATIENCE = 4
#: Step in which loads are lowered, the lowest ones, and the least difference between the largest and the lowest.
_LESS_LOAD, _LEAST_LOAD, _LEAST_RANGE = 0.05, 0.4, 0.15


def survivable(own: GridSuite, on_progress: Callable[[str, float, int], object]) -> Places:
    """Return the places of a suite's events that some law survives at every operating point tried."""
    suite = own.suite
    plant = suite.plant
    drawn = suite.scenarios([seed for seed in suite.validation if suite.stratum(seed) == "ample"][:_N_POINTS])
    length: dict[str, Any] = {"duration_s": _STRIKES_S + _AFTERWARDS_S}
    points = [dataclasses.replace(scenario, events=(), **length) for scenario in drawn]

    def kept(name: str, buses: Sequence[Place], event: Callable[[Place], Event]) -> tuple[Place, ...]:
        """Return the places at which some law survives the event at every operating point."""
        scenarios = [dataclasses.replace(point, events=(event(place),)) for place in buses for point in points]
        if not scenarios:
            return ()
        alive: Flags = np.all(survived(plant, scenarios).any(axis=0).reshape(len(buses), -1), axis=1)
        found = tuple(place for place, lives in zip(buses, alive, strict=True) if lives)
        on_progress(f"{name}: {len(found)} of {len(buses)} survived", 1, 1)
        return found

    places = own.places
    at: dict[str, Any] = {"time_s": _STRIKES_S}
    clearing: dict[str, Any] = {"clears_after_s": _CLEARED_S, **at}

    def outage(bus: int) -> Event:
        return MachineOutage(bus=bus, **at)

    return dataclasses.replace(
        places,
        line_trips=kept("line trips", places.line_trips, lambda ends: LineTrip(from_bus=ends[0], to_bus=ends[1], **at)),
        fault_lines=kept("faults", places.fault_lines, lambda ends: Fault(bus=ends[0], opens=ends, **clearing)),
        load_trip_buses=kept("load trips", places.load_trip_buses, lambda bus: LoadTrip(bus=bus, **at)),
        machine_buses=kept("machines", places.machine_buses, outage),
        generator_buses=kept("generators", places.generator_buses, outage),
        governor_buses=kept("governors", places.governor_buses, lambda bus: GovernorLoss(bus=bus, **at)),
    )


def screened(grid: str, name: str, on_progress: Callable[[str, float, int], object]) -> GridSuite:
    """Return a suite of a grid whose events some law survives, and whose sizes leave few scenarios that none does.

    Loads are lowered until every operating point starts under all laws; then places are left out at which every tenth
    scenario is lost under all of them, and events are made smaller.

    Args:
        grid: its name, or the path of its file.
        name: of the suite, without version; its scenarios are drawn by it.

    Raises:
        ValueError: no load or no size is small enough, or a mode is hardly damped.
    """
    own = dataclasses.replace(unscreened(grid), name=name)
    while not _starts(own):
        high = round(own.load_level[1] - _LESS_LOAD, 2)
        low = min(own.load_level[0], round(high - _LEAST_RANGE, 2))
        if low < _LEAST_LOAD:
            raise ValueError(f"grid {grid!r} has no equilibrium in some winds at {100.0 * low:.0f} % of its load too")
        own = dataclasses.replace(own, load_level=(low, high), places=all_places(get_grid(grid), low))
        on_progress(f"load level at most {high:g}", 1, 1)
    damping, hertz = _least_damped(own)
    on_progress(f"least damped mode: {hertz:.2f} Hz by {100.0 * damping:.1f} %", 1, 1)
    if damping < _LEAST_DAMPING:
        raise ValueError(
            f"grid {grid!r} has operating points with a mode of {hertz:.2f} Hz that is damped by {100.0 * damping:.1f} "
            f"%; at least {100.0 * _LEAST_DAMPING:g} % are needed: `wtg-gym grid check` shows modes, machines may need "
            "other stabilisers"
        )
    own = dataclasses.replace(own, places=survivable(own, on_progress))
    plant = own.suite.plant
    shares: list[float] = []
    while True:
        scenarios = own.suite.scenarios(own.suite.validation[:_N_TRIED])
        lost: Flags = np.logical_not(survived(plant, scenarios).any(axis=0))
        on_progress(f"events of {own.event_size:g}: {100.0 * lost.mean():.1f} % are lost under every law", 1, 1)
        if lost.mean() <= _LOST:
            return own
        fewer = _without(own.places, scenarios, lost)
        if fewer != own.places:
            own = dataclasses.replace(own, places=fewer)
            continue
        shares.append(lost.mean())
        if own.event_size < _LEAST_SIZE or (len(shares) > _PATIENCE and shares[-1] >= shares[-1 - _PATIENCE]):
            kinds = Counter(s.name.split("/")[1] for s, is_lost in zip(scenarios, lost, strict=True) if is_lost)
            said = ", ".join(f"{n} of {kind}" for kind, n in kinds.most_common(3))
            raise ValueError(
                f"grid {grid!r} loses {100.0 * lost.mean():.1f} % of the scenarios at smaller events too: {said}; "
                "other groups, or more machines beside them, may hold it"
            )
        own = dataclasses.replace(own, event_size=round(_SMALLER * own.event_size, 2))


def _without(places: Places, scenarios: Sequence[Scenario], lost: Flags) -> Places:
    """Return the places without those where a tenth of the scenarios or more is lost."""
    drawn: dict[tuple[str, Any], list[bool]] = defaultdict(list)
    for scenario, is_lost in zip(scenarios, lost, strict=True):
        for place in {place for event in scenario.events for place in _places_of(event)}:
            drawn[place].append(bool(is_lost))
    bad = {place for place, flags in drawn.items() if sum(flags) >= _LOST_AT_PLACE * len(flags)}
    kept: dict[str, Any] = {name: tuple(p for p in getattr(places, name) if (name, p) not in bad) for name, _ in bad}
    return dataclasses.replace(places, **kept)


def _places_of(event: Event) -> list[tuple[str, Any]]:
    """Return the fields of :class:`Places` that an event was drawn from, each with its place."""
    match event:
        case LineTrip():
            return [("line_trips", (event.from_bus, event.to_bus))]
        case Fault():
            return [("fault_lines", event.opens)]
        case LoadTrip():
            return [("load_trip_buses", event.bus)]
        case MachineOutage():
            return [("machine_buses", event.bus), ("generator_buses", event.bus)]
        case GovernorLoss():
            return [("governor_buses", event.bus)]
    return []


def _least_damped(own: GridSuite) -> tuple[float, float]:
    """Return damping [-] and frequency [Hz] of the least damped mode of all operating points tried."""
    plant = own.suite.plant
    found = []
    with closing(Simulator(plant, duration_s=own.suite.duration_s)) as simulator:
        laws = group_laws(LAWS[0], plant.turbines, plant.control)
        for scenario in own.suite.scenarios(own.suite.validation[:_N_DAMPED]):
            simulator.start(0, dataclasses.replace(scenario, events=()), laws)
            rows = simulator.blocks[0, :, 0]
            matrix, _ = moving_matrix(rows, simulator.plant, simulator.layout, -1.0)
            found += swing_modes(matrix)[:1]
    return min(found)


def _starts(own: GridSuite) -> bool:
    """Return whether every operating point of validation and test starts under all laws, and 1,000 of training do."""
    plant = own.suite.plant
    seeds = [*own.suite.validation, *own.suite.test, *own.suite.train[:_N_STARTED]]
    try:
        scenarios = own.suite.scenarios(seeds)
    except ValueError as error:
        # With less load the turbines give a larger share of it.
        low, high = own.load_level
        raise ValueError(
            f"grid {own.grid!r} has no equilibrium in some winds at its loads or a little less; with {low:.0%} … "
            f"{high:.0%} of them, {error}"
        ) from error
    drawn = [dataclasses.replace(scenario, events=()) for scenario in scenarios]
    with closing(Simulator(plant, duration_s=own.suite.duration_s)) as simulator:
        for name in LAWS:
            try:
                simulator.prepare(drawn, group_laws(name, plant.turbines, plant.control))
            except StartError:
                return False
    return True
