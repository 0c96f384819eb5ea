"""What the events of a scenario change in the network and its units."""

from __future__ import annotations

import math
from collections.abc import Mapping

from wtg_gym.physics import scenario as events
from wtg_gym.physics.equilibrium import unit_name
from wtg_gym.physics.layout import NetworkEvent
from wtg_gym.physics.plant import ISLANDS_AT_MOST, Plant, PlantTables
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import whole_steps


def network_events(scenario: Scenario, settings: Plant, plant: PlantTables) -> list[NetworkEvent]:
    """Return what a scenario's events change, one by one.

    Raises:
        ValueError: an event does not fit the plant, or the events do not fit each other.
    """
    name = f"scenario {scenario.name!r}"
    lost = [event.bus for event in scenario.events if isinstance(event, events.LoadTrip)]
    if len(set(lost)) < len(lost):
        raise ValueError(f"{name} disconnects a load twice; load trips at buses {lost}")
    found = [each for event in scenario.events for each in _changes(event, scenario.load_level, settings, plant)]
    _check_lines(name, [event for event in found if event.branch >= 0 and event.factor == 0.0], settings)
    returns = [event.unit for event in found if event.unit >= 0 and event.end > event.start]
    if returns and not settings.extended:
        raise ValueError(f"{name} brings back {unit_name(settings, returns[0])}, which needs extended physics")
    for verb, given in (
        ("disconnects", [(event.unit, event.start, event.end) for event in found if event.unit >= 0]),
        (
            "loses the governor of",
            [(event.governor, event.start, event.start) for event in found if event.governor >= 0],
        ),
    ):
        away: dict[int, float] = {}
        for unit, start, end in sorted(given, key=lambda one: one[1]):
            if start <= away.get(unit, -math.inf):
                raise ValueError(f"{name} {verb} {unit_name(settings, unit)} twice")
            away[unit] = end if end > start else math.inf
    return found


def _check_lines(name: str, trips: list[NetworkEvent], settings: Plant) -> None:
    """Refuse a line that opens while it is open, and lines whose opening leaves islands that the plant cannot have."""
    case = settings.case
    most = ISLANDS_AT_MOST if settings.extended else 1
    with_unit = {*case.unit_buses, *(group.bus for group in settings.groups)}
    trips = sorted(trips, key=lambda trip: trip.start)
    for place, trip in enumerate(trips):
        opened = [before.branch for before in trips[:place] if before.end == before.start or trip.start < before.end]
        if trip.branch in opened:
            ends = case.branches[trip.branch]
            raise ValueError(f"{name} opens the line {ends.from_bus}-{ends.to_bus} twice")
        opened.append(trip.branch)
        if len(opened) == 1 and trip.branch not in case.bridges:
            continue
        parts = case.parts_without(tuple(opened))
        if len(parts) > 1 and most == 1:
            raise ValueError(f"{name}: its line trips would split the network, which needs extended physics")
        live = sum(not part.isdisjoint(with_unit) for part in parts)
        if live > most:
            raise ValueError(f"{name}: its line trips leave {live} islands with a unit; allowed: at most {most}")


def _changes(event: events.Event, load_level: float, settings: Plant, plant: PlantTables) -> list[NetworkEvent]:
    """Return what an event changes, with its times in steps and its load as power [p.u.]."""
    case, dt = settings.case, settings.simulation_dt
    n_sync, n_wtg = len(case.machines), len(settings.groups)
    start = end = float(whole_steps("event time", event.time_s, dt, "simulation step"))

    def later(name: str, after_s: float | None) -> float:
        return start if after_s is None else start + whole_steps(name, after_s, dt, "simulation step")

    if isinstance(event, events.GroupTrip):
        if event.group >= n_wtg:
            raise ValueError(f"unknown WTG group {event.group}; the plant has {n_wtg}, counted from 0")
        end = later("returns_after_s", event.returns_after_s)
        return [NetworkEvent(start, end, unit=n_sync + event.group)]
    if isinstance(event, events.LineTrip):
        end = later("recloses_after_s", event.recloses_after_s)
        return [NetworkEvent(start, end, branch=case.branch_index(event.from_bus, event.to_bus, event.circuit))]
    if isinstance(event, events.ReactanceStep):
        branch = case.branch_index(event.from_bus, event.to_bus, event.circuit)
        return [NetworkEvent(start, start, branch=branch, factor=event.factor)]
    bus = case.bus_index(event.bus)
    if isinstance(event, events.Fault):
        end = later("clears_after_s", event.clears_after_s)
        y = 1.0 / complex(event.resistance_pu, event.reactance_pu)
        cleared = []
        if event.opens is not None:
            cleared = [NetworkEvent(end, end, branch=case.branch_index(*event.opens, event.circuit))]
        return [NetworkEvent(start, end, active=y.real, reactive=y.imag, fault=bus), *cleared]
    if isinstance(event, (events.PhaseJump, events.FrequencyRamp)):
        sources = {number: source.bus for number, source in enumerate(case.sources)}
        source = _units_at(event.bus, "imposed source", sources)[0]
        if isinstance(event, events.PhaseJump):
            return [NetworkEvent(start, start, source=source, jump=math.radians(event.angle_deg))]
        end = later("duration_s", event.duration_s)
        return [NetworkEvent(start, end, source=source, ramp=event.rocof_hz_s / case.frequency_hz)]
    if isinstance(event, events.MachineOutage):
        end = later("returns_after_s", event.returns_after_s)
        found = _units_at(event.bus, "synchronous machine", dict(enumerate(case.unit_buses)))
        if found[0] >= n_sync:
            if end > start:
                raise ValueError(f"the imposed source at bus {event.bus} does not come back: leave out returns_after_s")
            # Sources come after the groups.
            return [NetworkEvent(start, end, unit=unit + n_wtg) for unit in found]
        return [NetworkEvent(start, end, unit=unit) for unit in found if unit < n_sync]
    if isinstance(event, events.GovernorLoss):
        governed = {number: m.bus for number, m in enumerate(case.machines) if m.governor is not None}
        machines = _units_at(event.bus, "machine with a governor", governed)
        return [NetworkEvent(start, end, governor=machine) for machine in machines]
    if isinstance(event, events.LoadTrip):
        power = -load_level * complex(plant.buses["load.re"][bus], plant.buses["load.im"][bus])
    else:
        power = complex(event.power_mw, event.reactive_mvar) / case.base_mva
    if isinstance(event, events.LoadRamp):
        end = start + whole_steps("ramp duration", event.duration_s, dt, "simulation step")
    return [NetworkEvent(start, end, bus, power.real, power.imag)]


def _units_at(bus: int, what: str, buses: Mapping[int, int]) -> list[int]:
    """Return the numbers of the units at a bus, of those whose buses are given by their numbers."""
    found = [number for number, at in buses.items() if at == bus]
    if not found:
        raise ValueError(f"no {what} at bus {bus}; buses with one: {sorted(set(buses.values()))}")
    return found
