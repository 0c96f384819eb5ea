"""The reserve margin: whether wind and governors can carry the load after every event of a scenario, whoever controls.

    margin = (wind + machines - 1.03 · load) / load, at its least over the start and all events

- wind: what the groups in service could give at most, in the mean wind of the 30 s from there on;
- machines: their power at the start, and what droop adds at 0.8 Hz below nominal, up to the gate's limit; one that has
  lost its governor stays where it was;
- load: at nominal voltage and frequency, before any is shed; losses are 3 % of it.

Where the network has fallen apart, the part with the least margin counts, of those that anything feeds. Grid planners
call the same sum, over seasons instead of seconds, generation adequacy.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.governor import gate_limits
from wtg_gym.physics.network import NetworkCase
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import (
    Event,
    Fault,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
    Scenario,
)

#: Deviation of the frequency at which governors are counted [Hz]: the largest that continental Europe's grid is
#: designed for.
DEVIATION_HZ = 0.8
#: Time for which the wind after an event counts [s].
WIND_S = 30.0
_LOSSES = 0.03


class _Machine(NamedTuple):
    bus: int
    rating_mw: float
    limit: float  # largest gate [p.u.]; 0 without a governor
    droop: float  # [p.u.]; infinite without
    share: float  # of what the loads need at the start; 0 where the case says what it gives
    dispatch_mw: float


class _Facts(NamedTuple):
    """What the margin needs to know of a plant."""

    case: NetworkCase
    loads_mw: dict[int, float]  # by bus
    machines: tuple[_Machine, ...]
    groups: tuple[tuple[int, float, float], ...]  # bus, rated power [MW], available power at 1 m/s [p.u.]
    nominal_share: float  # of the available power that a group gives at the start


@functools.lru_cache(maxsize=64)
def _facts(plant: Plant) -> _Facts:
    case = plant.case
    governed = {
        i: m.rating_mva * min(gate_limits(m.governor)[1], 1.0) for i, m in enumerate(case.machines) if m.governor
    }
    total = sum(governed.values()) if plant.shares_dispatch or not case.machines else 0.0
    slack = {i for i in governed if case.machines[i].bus == case.slack_bus}
    shares = {i: size / total for i, size in governed.items()} if total else {i: 1.0 / len(slack) for i in slack}
    machines = tuple(
        _Machine(
            m.bus,
            m.rating_mva,
            0.0 if m.governor is None else gate_limits(m.governor)[1],
            math.inf if m.governor is None else m.governor.droop_pu,
            shares.get(i, 0.0),
            m.dispatch_mw,
        )
        for i, m in enumerate(case.machines)
    )
    groups = tuple(
        (group.bus, group.n_turbines * turbine.rated_power_mw, float(available_power_pu(1.0, turbine)))
        for group, turbine in zip(plant.groups, plant.turbines, strict=True)
    )
    loads = {bus.number: bus.load_mw for bus in case.buses}
    return _Facts(case, loads, machines, groups, 1.0 - plant.control.deloading_nominal)


def reserve_margin(scenario: Scenario, plant: Plant) -> float:
    """Return the reserve margin of a scenario in a plant, as a share of the load [-]."""
    facts = _facts(plant)
    at_start_mw = _machines_at_start(facts, scenario)
    instants = {0.0, *(event.time_s for event in scenario.events)}
    return min(_margin_at(time_s, scenario, facts, at_start_mw) for time_s in instants)


def _wind_mw(facts: _Facts, scenario: Scenario, first_s: float, last_s: float) -> list[float]:
    """Return what each group could give in the mean wind of a time [MW]."""
    first = min(int(first_s / scenario.wind_dt_s), scenario.wind_speed.shape[1] - 1)
    last = max(int(last_s / scenario.wind_dt_s), first + 1)
    means = scenario.wind_speed[:, first:last].mean(axis=1).tolist()
    return [rated * min(cubic * mean**3, 1.0) for (_, rated, cubic), mean in zip(facts.groups, means, strict=True)]


def _machines_at_start(facts: _Facts, scenario: Scenario) -> list[float]:
    """Return what each machine gives at the start [MW]: they share what the wind leaves."""
    load_mw = scenario.load_level * facts.case.load_mw
    wind_mw = facts.nominal_share * sum(_wind_mw(facts, scenario, 0.0, 0.0))
    needed_mw = (1.0 + _LOSSES) * load_mw - wind_mw - sum(m.dispatch_mw for m in facts.machines if not m.share)
    return [m.share * max(needed_mw, 0.0) if m.share else m.dispatch_mw for m in facts.machines]


def _margin_at(time_s: float, scenario: Scenario, facts: _Facts, at_start_mw: list[float]) -> float:
    """Return the least margin of all parts of the network, infinite if nothing feeds any."""
    past = [event for event in scenario.events if event.time_s <= time_s]
    gone = [event for event in past if not (getattr(event, "returns_after_s", None) and time_s >= event.end_s)]
    lost = {event.bus for event in gone if isinstance(event, MachineOutage)}
    away = {event.group for event in gone if isinstance(event, GroupTrip)}
    stuck = {event.bus for event in past if isinstance(event, GovernorLoss)}
    loads_mw = {bus: scenario.load_level * load_mw for bus, load_mw in facts.loads_mw.items()}
    for event in past:
        if isinstance(event, LoadStep | LoadRamp):
            loads_mw[event.bus] += event.power_mw
        elif isinstance(event, LoadTrip):
            loads_mw[event.bus] = 0.0
    opened = tuple(sorted({branch for event in past for branch in _opened(event, time_s, facts.case)}))
    fall = DEVIATION_HZ / facts.case.frequency_hz
    supplies = [
        (bus, power_mw)
        for j, ((bus, _, _), power_mw) in enumerate(
            zip(facts.groups, _wind_mw(facts, scenario, time_s, time_s + WIND_S), strict=True)
        )
        if j not in away
    ]
    for machine, power_mw in zip(facts.machines, at_start_mw, strict=True):
        if machine.bus in lost:
            continue
        rating_mw = machine.rating_mw * scenario.committed
        raised_mw = power_mw + fall / (scenario.governor_droop or machine.droop) * rating_mw
        if machine.limit > 0.0 and machine.bus not in stuck:
            power_mw = max(power_mw, min(raised_mw, machine.limit * rating_mw))
        supplies.append((machine.bus, power_mw))
    margins = []
    for part in facts.case.parts_without(opened) if opened else [set(loads_mw)]:
        power_mw = sum(power for bus, power in supplies if bus in part)
        load_mw = sum(load for bus, load in loads_mw.items() if bus in part)
        if power_mw > 0.0 and load_mw > 0.0:
            margins.append(power_mw / load_mw - (1.0 + _LOSSES))
    return min(margins, default=math.inf)


def _opened(event: Event, time_s: float, case: NetworkCase) -> list[int]:
    """Return the branches that an event holds open at an instant; the line with a fault opens when it is cleared."""
    if isinstance(event, LineTrip):
        closed = event.recloses_after_s is not None and time_s >= event.time_s + event.recloses_after_s
        return [] if closed else [case.branch_index(event.from_bus, event.to_bus)]
    return [case.branch_index(*event.opens)] if isinstance(event, Fault) and event.opens is not None else []
