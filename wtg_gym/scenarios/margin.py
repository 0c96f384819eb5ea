"""The reserve margin: the power of wind and governors beyond the load after an event, under any controller.

    margin = (wind + machines - 1.03 · load) / load, at its least over the start and all events

- wind: what the groups in service could give at most, in the mean wind of the 30 s from there on;
- machines: their power at the start, and what droop adds at 0.8 Hz below nominal, up to the gate's limit; one that has
  lost its governor stays where it was;
- load: at nominal voltage and frequency, before any is shed; losses are 3 % of it.

Where the network has fallen apart, the part with the least margin counts, of those that anything feeds. Grid planners
call the same sum, over seasons instead of seconds, generation adequacy.
"""

import math

import numpy as np

from wtg_gym.physics import aerodynamics, grid
from wtg_gym.physics import scenario as events
from wtg_gym.physics.machine import gate_limits
from wtg_gym.physics.plant import Plant, power_at_gate_mw
from wtg_gym.physics.scenario import Event, Scenario

#: Deviation of the frequency at which governors are counted [Hz]: the largest that continental Europe's grid is
#: designed for.
DEVIATION_HZ = 0.8
#: Time for which the wind after an event counts [s].
WIND_S = 30.0
_LOSSES = 0.03


class ReserveMargin:
    """The reserve margin of scenarios in a plant."""

    def __init__(self, plant: Plant) -> None:
        self._case = case = plant.case
        self._loads_mw = {bus.number: bus.load_mw for bus in case.buses}
        self._at_nominal = 1.0 - plant.control.deloading_nominal
        sizes = zip(plant.groups, plant.turbines, strict=True)
        #: Bus, rated power [MW] and available power at 1 m/s [p.u.] of each group.
        self._groups = [
            (group.bus, group.n_turbines * turbine.rated_power_mw, float(aerodynamics.available_power_pu(1.0, turbine)))
            for group, turbine in sizes
        ]
        governed = [m for m in case.machines if m.governor is not None]
        #: Most that each machine's turbine gives, as a share of its rating.
        self._most = [gate_limits(m.governor)[1] if m.governor else 0.0 for m in case.machines]
        if not plant.shares_dispatch:
            governed = [m for m in governed if m.bus == case.slack_bus]
        total = sum(map(power_at_gate_mw, governed))
        #: Each machine's share of the load at the start, 0 if the case has its dispatch.
        self._shares = [power_at_gate_mw(machine) / total if machine in governed else 0.0 for machine in case.machines]
        self._parts: dict[tuple[int, ...], list[set[int]]] = {(): [set(self._loads_mw)]}

    def of(self, scenario: Scenario, least: float = -math.inf) -> float:
        """Return the margin of a scenario, as a share of the load [-]; infinite if nothing feeds any.

        The search ends at the first instant with a margin below `least`: the least may be lower still.
        """
        wind_mw = self._at_nominal * sum(self._wind_mw(scenario, 0.0, 0.0))
        machines = [*zip(self._case.machines, self._shares, strict=True)]
        given_mw = sum(machine.dispatch_mw for machine, share in machines if not share)
        needed_mw = max((1.0 + _LOSSES) * scenario.load_level * self._case.load_mw - wind_mw - given_mw, 0.0)
        # The machines share what the wind leaves.
        at_start_mw = [share * needed_mw if share else machine.dispatch_mw for machine, share in machines]
        margin = math.inf
        # The last instant, with most lost, decides most often.
        for time_s in sorted({0.0, *(event.time_s for event in scenario.events)}, reverse=True):
            margin = min(margin, self._at(time_s, scenario, at_start_mw))
            if margin < least:
                break
        return margin

    def _wind_mw(self, scenario: Scenario, first_s: float, last_s: float) -> list[float]:
        """Return what each group could give in the mean wind of a time [MW]."""
        first = min(int(first_s / scenario.wind_dt_s), scenario.wind_speed.shape[1] - 1)
        last = max(int(last_s / scenario.wind_dt_s), first + 1)
        speeds = scenario.wind_speed[:, first:last]
        # The mean, without what numpy's asks before.
        means = (np.add.reduce(speeds, axis=1) / speeds.shape[1]).tolist()
        return [rated * min(cubic * mean**3, 1.0) for (_, rated, cubic), mean in zip(self._groups, means, strict=True)]

    def _at(self, time_s: float, scenario: Scenario, at_start_mw: list[float]) -> float:
        """Return the least margin of all parts of the network from an instant on."""
        past = [event for event in scenario.events if event.time_s <= time_s]
        lost = {event.bus for event in past if isinstance(event, events.MachineOutage)}
        away = {event.group for event in past if isinstance(event, events.GroupTrip)}
        stuck = {event.bus for event in past if isinstance(event, events.GovernorLoss)}
        loads_mw = {bus: scenario.load_level * load_mw for bus, load_mw in self._loads_mw.items()}
        for event in past:
            if isinstance(event, events.LoadStep | events.LoadRamp):
                loads_mw[event.bus] += event.power_mw
            elif isinstance(event, events.LoadTrip):
                loads_mw[event.bus] = 0.0
        wind_mw = zip(self._groups, self._wind_mw(scenario, time_s, time_s + WIND_S), strict=True)
        supplies = [(bus, power_mw) for j, ((bus, _, _), power_mw) in enumerate(wind_mw) if j not in away]
        fall = DEVIATION_HZ / self._case.frequency_hz
        for machine, most, power_mw in zip(self._case.machines, self._most, at_start_mw, strict=True):
            if machine.governor is not None and machine.bus not in stuck:
                rating_mw = machine.rating_mva * scenario.committed
                raised_mw = power_mw + fall / (scenario.governor_droop or machine.governor.droop_pu) * rating_mw
                power_mw = max(power_mw, min(raised_mw, most * rating_mw))
            if machine.bus not in lost:
                supplies.append((machine.bus, power_mw))
        opened = tuple(sorted({branch for event in past for branch in _opened(event, time_s, self._case)}))
        if opened not in self._parts:
            self._parts[opened] = self._case.parts_without(opened)
        margins = []
        for part in self._parts[opened]:
            power_mw = sum(power for bus, power in supplies if bus in part)
            load_mw = sum(loads_mw[bus] for bus in part)
            if power_mw > 0.0 and load_mw > 0.0:
                margins.append(power_mw / load_mw - (1.0 + _LOSSES))
        return min(margins, default=math.inf)


def _opened(event: Event, time_s: float, case: grid.NetworkCase) -> list[int]:
    """Return the branches that an event holds open at an instant; the line with a fault opens when it is cleared."""
    if isinstance(event, events.LineTrip):
        closed = event.recloses_after_s is not None and time_s >= event.time_s + event.recloses_after_s
        return [] if closed else [case.branch_index(event.from_bus, event.to_bus)]
    return [case.branch_index(*event.opens)] if isinstance(event, events.Fault) and event.opens is not None else []
