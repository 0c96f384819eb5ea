"""The reserve margin: whether wind and governors can carry the load after every event of a scenario, whoever controls.

    margin = (wind + machines - 1.03 · load) / load, at its least over the start and all events

- wind: what the groups in service could give at most, in the mean wind of the 30 s from there on;
- machines: their power at the start, and what droop adds at 0.8 Hz below nominal, up to the gate's limit; a machine that
  has lost its governor stays where it was;
- load: at nominal voltage and frequency, before any is shed; losses are 3 % of it.

Where the network has fallen apart, the part with the least margin counts, of those that anything feeds. Grid planners
call the same sum, over seasons instead of seconds, generation adequacy.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from wtg_gym.physics import scenario as events
from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.governor import gate_limits
from wtg_gym.physics.network import NetworkCase
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario

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
    instants = [0.0, *(event.time_s for event in scenario.events)]
    return min(_margin_at(time_s, scenario, facts, at_start_mw) for time_s in sorted(set(instants)))


def _wind_mw(facts: _Facts, scenario: Scenario, first_s: float, last_s: float) -> list[float]:
    """Return what each group could give in the mean wind of a time."""
    first, last = (int(time_s / scenario.wind_dt_s) for time_s in (first_s, last_s))
    n = scenario.wind_speed.shape[1]
    first = min(first, n - 1)
    means = scenario.wind_speed[:, first : max(last, first + 1)].mean(axis=1).tolist()
    return [rated * min(cubic * mean**3, 1.0) for (_, rated, cubic), mean in zip(facts.groups, means, strict=True)]


def _machines_at_start(facts: _Facts, scenario: Scenario) -> list[float]:
    """Return what each machine gives at the start [MW]: they share what the wind leaves."""
    load_mw = scenario.load_level * facts.case.load_mw
    wind_mw = facts.nominal_share * sum(_wind_mw(facts, scenario, 0.0, 0.0))
    needed_mw = (1.0 + _LOSSES) * load_mw - wind_mw - sum(m.dispatch_mw for m in facts.machines if not m.share)
    return [m.share * max(needed_mw, 0.0) if m.share else m.dispatch_mw for m in facts.machines]


def _margin_at(time_s: float, scenario: Scenario, facts: _Facts, at_start_mw: list[float]) -> float:
    loads = {bus: scenario.load_level * load_mw for bus, load_mw in facts.loads_mw.items()}
    stuck, gone, away, opened = set[int](), set[int](), set[int](), set[int]()
    for event in scenario.events:
        if event.time_s > time_s:
            continue
        if isinstance(event, (events.LoadStep, events.LoadRamp)):
            loads[event.bus] += event.power_mw
        elif isinstance(event, events.LoadTrip):
            loads[event.bus] = 0.0
        elif isinstance(event, events.GovernorLoss):
            stuck.add(event.bus)
        elif isinstance(event, events.MachineOutage):
            if not event.returns_after_s or time_s < event.end_s:
                gone.add(event.bus)
        elif isinstance(event, events.GroupTrip):
            if not event.returns_after_s or time_s < event.end_s:
                away.add(event.group)
        else:
            opened.update(_opened(event, time_s, facts.case))
    wind_mw = _wind_mw(facts, scenario, time_s, time_s + WIND_S)
    margins = [
        (power_mw - (1.0 + _LOSSES) * load_mw) / load_mw
        for power_mw, load_mw in _parts(facts, scenario, loads, wind_mw, at_start_mw, (stuck, gone, away, opened))
        if load_mw > 0.0
    ]
    return min(margins, default=math.inf)


def _opened(event: events.Event, time_s: float, case: NetworkCase) -> list[int]:
    """Return the branches that an event holds open at an instant."""
    if isinstance(event, events.LineTrip):
        closed = event.recloses_after_s is not None and time_s >= event.time_s + event.recloses_after_s
        return [] if closed else [case.branch_index(event.from_bus, event.to_bus)]
    if isinstance(event, events.Fault) and event.opens is not None:
        return [case.branch_index(*event.opens)]
    return []


def _parts(
    facts: _Facts,
    scenario: Scenario,
    loads: dict[int, float],
    wind_mw: list[float],
    at_start_mw: list[float],
    out: tuple[set[int], set[int], set[int], set[int]],
) -> Iterator[tuple[float, float]]:
    """Yield the most that each part of the network can be given, and its load [MW]."""
    stuck, gone, away, opened = out
    parts = facts.case.parts_without(tuple(sorted(opened))) if opened else [set(loads)]
    fall = DEVIATION_HZ / facts.case.frequency_hz
    for part in parts:
        supplies = [
            power for j, ((bus, _, _), power) in enumerate(zip(facts.groups, wind_mw, strict=True)) if bus in part and j not in away
        ]
        for machine, power_mw in zip(facts.machines, at_start_mw, strict=True):
            if machine.bus not in part or machine.bus in gone:
                continue
            if math.isfinite(machine.droop) and machine.bus not in stuck:
                rating_mw = machine.rating_mw * scenario.committed
                droop = scenario.governor_droop or machine.droop
                power_mw = max(power_mw, min(machine.limit * rating_mw, power_mw + fall / droop * rating_mw))
                supplies.append(power_mw)
            elif power_mw:
                supplies.append(power_mw)
        if supplies:
            yield sum(supplies), sum(loads[bus] for bus in part)
