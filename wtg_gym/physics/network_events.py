"""What the events of a scenario change in the network and its units."""

from __future__ import annotations

from collections.abc import Iterable

from wtg_gym.physics.kernel_data import NetworkEvent
from wtg_gym.physics.network import NetworkCase
from wtg_gym.physics.plant import Plant, PlantSettings
from wtg_gym.physics.scenario import (
    Event,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadTrip,
    MachineOutage,
    Scenario,
)
from wtg_gym.physics.start_errors import unit_name
from wtg_gym.ranges import whole_steps


def network_events(scenario: Scenario, settings: PlantSettings, plant: Plant) -> list[NetworkEvent]:
    """Return what a scenario's events change, one by one.

    Raises:
        ValueError: an event does not fit the plant, or the events do not fit each other.
    """
    name = f"scenario {scenario.name!r}"
    lost = [event.bus for event in scenario.events if isinstance(event, LoadTrip)]
    if len(set(lost)) < len(lost):
        raise ValueError(f"{name} disconnects a load twice; load trips at buses {lost}")
    found = [each for event in scenario.events for each in _changes(event, scenario.load_level, settings, plant)]
    _check_lines(name, [event for event in found if event.branch >= 0], settings.case)
    units = [event.unit for event in found if event.unit >= 0]
    governed = [event.governor for event in found if event.governor >= 0]
    for verb, given in (("disconnects", units), ("loses the governor of", governed)):
        for unit in given:
            if given.count(unit) > 1:
                raise ValueError(f"{name} {verb} {unit_name(settings, unit)} twice")
    n_sync = len(settings.case.machines)
    if sum(unit < n_sync for unit in units) == n_sync:
        raise ValueError(f"{name} disconnects every synchronous machine; one must stay connected")
    return found


def _check_lines(name: str, trips: list[NetworkEvent], case: NetworkCase) -> None:
    """Refuse a line that opens while it is open, and lines whose opening splits the network."""
    trips = sorted(trips, key=lambda trip: trip.start)
    for place, trip in enumerate(trips):
        opened = [before.branch for before in trips[:place] if before.end == before.start or trip.start < before.end]
        if trip.branch in opened:
            ends = case.branches[trip.branch]
            raise ValueError(f"{name} opens the line {ends.from_bus}-{ends.to_bus} twice")
        opened.append(trip.branch)
        if trip.branch in case.bridges or (len(opened) > 1 and not case.connected_without(tuple(opened))):
            raise ValueError(f"{name}: its line trips would split the network")


def _changes(event: Event, load_level: float, settings: PlantSettings, plant: Plant) -> list[NetworkEvent]:
    """Return what an event changes, with its times in steps and its load as power [p.u.]."""
    case, dt = settings.case, settings.simulation_dt
    n_sync, n_wtg = len(case.machines), len(settings.groups)
    start = end = float(whole_steps("event time", event.time_s, dt, "simulation step"))
    if isinstance(event, GroupTrip):
        if event.group >= n_wtg:
            raise ValueError(f"unknown WTG group {event.group}; the plant has {n_wtg}, counted from 0")
        return [NetworkEvent(start, end, unit=n_sync + event.group)]
    if isinstance(event, LineTrip):
        if event.recloses_after_s is not None:
            end += whole_steps("recloses_after_s", event.recloses_after_s, dt, "simulation step")
        return [NetworkEvent(start, end, branch=case.branch_index(event.from_bus, event.to_bus))]
    bus = case.bus_index(event.bus)
    if isinstance(event, MachineOutage):
        machines = _machines_at(case, event.bus, "synchronous machine", range(n_sync))
        return [NetworkEvent(start, end, unit=machine) for machine in machines]
    if isinstance(event, GovernorLoss):
        governed = [index for index, machine in enumerate(case.machines) if machine.governor is not None]
        machines = _machines_at(case, event.bus, "machine with a governor", governed)
        return [NetworkEvent(start, end, governor=machine) for machine in machines]
    if isinstance(event, LoadTrip):
        power = -load_level * complex(plant.buses["load.re"][bus], plant.buses["load.im"][bus])
    else:
        power = complex(event.power_mw, event.reactive_mvar) / case.base_mva
    if isinstance(event, LoadRamp):
        end = start + whole_steps("ramp duration", event.duration_s, dt, "simulation step")
    return [NetworkEvent(start, end, bus, power.real, power.imag)]


def _machines_at(case: NetworkCase, bus: int, what: str, machines: Iterable[int]) -> list[int]:
    """Return those of some machines that are at a bus, by their indices."""
    buses = {machine: case.machines[machine].bus for machine in machines}
    found = [machine for machine, at in buses.items() if at == bus]
    if not found:
        raise ValueError(f"no {what} at bus {bus}; buses with one: {sorted(set(buses.values()))}")
    return found
