"""From a scenario to a run: what its events change, the exact equilibrium it starts from, and why it cannot start."""

import math
from collections.abc import Mapping, Sequence

import numba
import numpy as np

from wtg_gym.physics import integration, machine_models, machine_parameters
from wtg_gym.physics import scenario as events
from wtg_gym.physics.layout import OF_ENV, BatchData, Floats, Layout, Network, NetworkEvent, offsets_of, units_of
from wtg_gym.physics.machine import gate_limits
from wtg_gym.physics.network import POWER_FLOW_TOLERANCE, PowerFlow, solve_power_flow, solve_sparse_flow
from wtg_gym.physics.parameters import ConverterLimitParameters, VoltageControlParameters
from wtg_gym.physics.plant import ISLANDS_AT_MOST, Plant, PlantTables
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.units import BUSES, ENV, StartFailure
from wtg_gym.ranges import whole_steps
from wtg_gym.systems.compiled import allocating, compiled
from wtg_gym.systems.programs import Complex, Whole
from wtg_gym.systems.routines import Function

#: Beginning of the names of scenarios that a simulator makes for itself.
NOMINAL = "the plant at "


class StartError(ValueError):
    """A scenario has no equilibrium to start from."""


def scenario_name(scenario: Scenario) -> str:
    """Return what an error calls a scenario."""
    return scenario.name if scenario.name.startswith(NOMINAL) else f"scenario {scenario.name!r}"


def unit_name(settings: Plant, unit: int) -> str:
    """Return what an error calls a unit."""
    n_groups = len(settings.groups)
    names = ["the synchronous machine"] * len(settings.case.machines)
    names += [f"WTG group {number} of {n_groups}" for number in range(1, n_groups + 1)]
    names += [f"a unit of {device.kind.name}" for device in settings.all_devices for _ in device.buses]
    return f"{names[unit]} at bus {settings.unit_buses[unit]}"


def check_internal_voltages(rows: Floats, scenarios: Sequence[Scenario], settings: Plant, layout: Layout) -> None:
    """Refuse a start that needs a larger voltage behind a reactance than anybody builds."""
    of_machines = np.hypot(rows[:, layout.machine("e_d")], rows[:, layout.machine("e_q")])
    voltages = np.concatenate([of_machines, rows[:, layout.wtg("emf")]], axis=1)
    limit = settings.protection.internal_voltage_max_pu
    for env, unit in np.argwhere(~(voltages <= limit)):
        bus = settings.case.buses[settings.case.bus_index(settings.unit_buses[unit])]
        task = "for its share of the power" if bus.voltage_pu is None else f"to hold {bus.voltage_pu:g} p.u. there"
        needed = f"{unit_name(settings, int(unit))} needs an internal voltage of {voltages[env, unit]:.3g} p.u. {task}"
        raise StartError(
            f"{scenario_name(scenarios[env])} cannot start: {needed}; allowed: at most {limit:g} p.u. (a larger rating "
            "needs less)"
        )


def check_rotor_speeds(rows: Floats, scenarios: Sequence[Scenario], settings: Plant, layout: Layout) -> None:
    """Refuse a start with a rotor below the under-speed trip."""
    speeds, least = rows[:, layout.wtg("rotor_speed")], settings.protection.rotor_speed_min_pu
    for env, group in np.argwhere(speeds < least):
        scenario = scenarios[env]
        raise StartError(
            f"scenario {scenario.name!r} cannot start: the rotor of {unit_name(settings, layout.n_sync + group)} would "
            f"start at {speeds[env, group]:.3g} p.u. in a wind of {scenario.wind_speed[group, 0]:.3g} m/s, below the "
            f"under-speed trip at {least:g} p.u."
        )


def start_failure(
    failure: StartFailure, unit: int, rows: Floats, scenario: Scenario, settings: Plant, layout: Layout
) -> str:
    """Say why a unit cannot start, with the numbers that its rows (n_rows,) hold."""
    if failure == StartFailure.POWER_FLOW_DIVERGED:
        return f"the power flow has no solution at a load level of {scenario.load_level:g} and this wind"
    if failure == StartFailure.WIND_SHORTAGE:
        return (
            f"in this wind the WTG groups alone cannot meet the load at a level of {scenario.load_level:g}; "
            "more wind or turbines, or less load, are needed"
        )
    name = unit_name(settings, unit)
    if unit < layout.n_sync:
        quantity, value, low, high = _limited(failure, unit, rows, settings, layout)
        what = quantity.replace("_", " ")
        return (
            f"{name} would start at {value:.4g} p.u. of {what}, beyond its {what} "
            f"limits {low:g} … {high:g} p.u.; change wind, load level or committed"
        )
    j = unit - layout.n_sync
    if j >= layout.n_wtg:
        return f"{name} finds no equilibrium within its limits"
    if failure == StartFailure.NO_TURBINE_EQUILIBRIUM:
        k = rows[layout.wtg("k_nominal")[j]]
        return f"{name} has no equilibrium at a wind of {scenario.wind_speed[j, 0]:g} m/s with k = {k:g} p.u."
    if failure == StartFailure.CONVERTER_LIMIT:
        limits = settings.limits or ConverterLimitParameters()
        return (
            f"{name} would start with {rows[layout.wtg('power')[j]]:.4g} p.u. of power, beyond its converter's limits: "
            f"power {limits.power_min_pu:g} … {limits.power_max_pu:g} p.u., current at most "
            f"{limits.current_max_pu:g} p.u."
        )
    control, emf = settings.voltage_control or VoltageControlParameters(), rows[layout.wtg("internal_voltage")[j]]
    return (
        f"{name} would start with {emf:.4g} p.u. behind X_g, beyond the limits {control.internal_voltage_min_pu:g} … "
        f"{control.internal_voltage_max_pu:g} p.u. of its voltage control"
    )


def _limited(
    failure: StartFailure, unit: int, rows: Floats, settings: Plant, layout: Layout
) -> tuple[str, float, float, float]:
    """Return the quantity of a machine that starts beyond its limits, its value, and the limits [p.u.]."""
    machine = settings.case.machines[unit]
    for control, parameters in machine_models.controls_of(machine):
        limits = control.start_limits
        if limits is not None and limits.failure == failure:
            place = np.flatnonzero(layout.seen(control.kind, "machine") == unit)[0]
            return limits.state, float(rows[layout.rows_of(control.kind, limits.state)[place]]), *limits.of(parameters)
    if failure == StartFailure.GOVERNOR_LIMIT:
        return "gate", float(rows[layout.machine("gate")[unit]]), *gate_limits(machine.governor)
    exciter = machine.exciter
    assert isinstance(exciter, machine_parameters.ExciterParameters)
    value = rows[layout.machine("field_voltage")[unit]]
    return "field_voltage", float(value), exciter.field_min_pu, exciter.field_max_pu


#: Rows in scratch of an environment that starts and of its buses, and these as columns of the power flow.
_OF_START, _OF_BUS = offsets_of(ENV, scratch=True), offsets_of(BUSES, scratch=True)
FLOW_COLUMNS = PowerFlow(
    power=_OF_BUS.planned, polar=_OF_BUS.polar, holds_voltage=_OF_BUS.holds, flow=_OF_BUS.flow, voltage=_OF_BUS.at_bus
)
POWER_FLOW = Function(solve_power_flow, 1)
#: Compiled for large networks alone.
SPARSE_FLOW = Function(solve_sparse_flow, 2, numba.int64)
_flow, _sparse_flow = POWER_FLOW.call, SPARSE_FLOW.call
_SHORTAGE = float(StartFailure.WIND_SHORTAGE)
#: Least common factor on k with which WTG groups alone balance the power, by design.
_LEAST_CURTAILMENT = 0.02
#: Width of the range in which losses are still unknown, and how much of k they may take, by design.
_CLOSE, _LOSSES = 0.01, 0.15
#: Power that the slack bus may lack once the factor is exact to its last bit [p.u.].
_BALANCED = 1e-10
_DIVERGED = float(StartFailure.POWER_FLOW_DIVERGED)


@allocating
def _plan_flow(arrays: tuple[Floats, Floats], buses: Floats, y: Complex, network: Network) -> float:
    """Solve the power flow of what all units plan; return what the slack bus lacks [p.u.], NaN where nothing starts."""
    facts, code, scratch = network.facts, network.code, arrays[1]
    env = units_of(scratch, facts.starting)[0]
    integration.plan(arrays, code)
    released = env[_OF_START.failure, 0] == 0.0
    balances = facts.n_balances
    while released:
        if facts.is_large:
            steps = _sparse_flow(code, (y, facts.slack, buses, FLOW_COLUMNS, network.pattern))
        else:
            steps = _flow(code, (y, facts.slack, buses, FLOW_COLUMNS))
        if steps < 0:
            env[_OF_START.failure, 0] = _DIVERGED
            break
        if balances:
            integration.balance(arrays, code)
            balances -= 1
            continue
        # Each time at least one bus lets go, and no bus does twice.
        integration.release(arrays, code)
        released = env[_OF_START.released, 0] > 0.0
    if env[_OF_START.failure, 0] != 0.0:
        return math.nan
    return float(buses[facts.slack, _OF_BUS.flow] - buses[facts.slack, _OF_BUS.planned])


@allocating
def _curtail(arrays: tuple[Floats, Floats], buses: Floats, y: Complex, network: Network) -> None:
    """Find the common factor on k with which the WTG groups alone meet the load, by halving its range."""
    env = units_of(arrays[1], network.facts.starting)[0]
    at, failure = _OF_START.curtailment, _OF_START.failure
    low, high = _LEAST_CURTAILMENT, 1.0
    # Far from the balance no power flow exists: the sum of all powers without losses comes close.
    while high - low > _CLOSE and env[failure, 0] == 0.0:
        env[at, 0] = 0.5 * (low + high)
        integration.plan(arrays, network.code)
        if env[_OF_START.needed, 0] > 0.0:
            low = env[at, 0]
        else:
            high = env[at, 0]
    low, high = max(low - _CLOSE, _LEAST_CURTAILMENT), min(high + _LOSSES, 1.0)
    env[at, 0] = high
    lacking = _plan_flow(arrays, buses, y, network)
    if env[failure, 0] == 0.0 and lacking > POWER_FLOW_TOLERANCE:
        env[failure, 0] = _SHORTAGE
    # The more the groups give, the less reactive power they have: without a power flow there is too much.
    while env[failure, 0] in (0.0, _DIVERGED) and not abs(lacking) <= POWER_FLOW_TOLERANCE:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        env[at, 0], env[failure, 0] = middle, 0.0
        lacking = _plan_flow(arrays, buses, y, network)
        if lacking > 0.0:
            low = middle
        else:
            high = middle
    if env[failure, 0] == 0.0 and not abs(lacking) <= _BALANCED:
        env[failure, 0] = _DIVERGED


@compiled
def prepare_envs(
    rows: Floats, scratch: Floats, y: Complex, network: Network, data: BatchData, load_levels: Floats, failures: Whole
) -> None:
    """Put environments into the equilibrium of their wind, law and load, at nominal frequency.

    In their rows (n, n_rows, 1) laws, first wind, bus of the load noise, the machines' inv_two_h and inv_droop are set;
    the scratch is (n_scratch, 1). `y` is the bus admittance matrix without loads and units (n_bus, n_bus) [p.u.], load
    levels are shares of the nominal load (n,). Load events of `data` are given as P + jQ [p.u.], and turned into
    admittances here. `failures` takes why one cannot start, and the number of the unit that cannot, machines first
    (n, 2).
    """
    facts, code = network.facts, network.code
    starting, planning = units_of(scratch, facts.starting)[0], facts.planning
    end = planning.first + planning.n_units * planning.n_rows
    buses = scratch[planning.first : end].reshape(planning.n_units, planning.n_rows)
    for env in range(rows.shape[0]):
        block, arrays = rows[env], (rows[env], scratch)
        starting[_OF_START.load_level, 0] = load_levels[env]
        starting[_OF_START.curtailment, 0] = 1.0
        if facts.curtails:
            _curtail(arrays, buses, y, network)
        else:
            _plan_flow(arrays, buses, y, network)
        if starting[_OF_START.failure, 0] == 0.0:
            integration.settle(arrays, code)
            run = units_of(block, facts.env)[0]
            voltage = buses[int(run[OF_ENV.noise_bus, 0]), _OF_BUS.polar]
            run[OF_ENV.noise_per_mw, 0] = 1.0 / (facts.base_mva * voltage * voltage)
            events = data.events[env]
            for e in range(events.shape[0]):
                if events[e].bus >= 0:
                    voltage = buses[events[e].bus, _OF_BUS.polar]
                    events[e].active /= voltage * voltage
                    events[e].reactive /= -(voltage * voltage)
            integration.refresh(code, (block, 0, env, network, data))
            integration.combine_load_noise(arrays, code)
            integration.find(arrays, code)
            integration.find_rates(arrays, code)
            integration.start(arrays, code)
        failures[env, 0] = int(starting[_OF_START.failure, 0])
        failures[env, 1] = int(starting[_OF_START.failure + 1, 0])


def network_events(scenario: Scenario, settings: Plant, plant: PlantTables) -> list[NetworkEvent]:
    """Return what a scenario's events change, one by one.

    A ValueError says that an event does not fit the plant, or the events do not fit each other.
    """
    name = f"scenario {scenario.name!r}"
    lost = [event.bus for event in scenario.events if isinstance(event, events.LoadTrip)]
    if len(set(lost)) < len(lost):
        raise ValueError(f"{name} disconnects a load twice; load trips at buses {lost}")
    changes = [change for event in scenario.events for change in _changes(event, scenario.load_level, settings, plant)]
    _check_lines(name, [event for event in changes if event.branch >= 0 and event.factor == 0.0], settings)
    for verb, units in (
        ("disconnects", [event.unit for event in changes if event.unit >= 0]),
        ("loses the governor of", [event.governor for event in changes if event.governor >= 0]),
    ):
        for place, unit in enumerate(units):
            if unit in units[:place]:
                raise ValueError(f"{name} {verb} {unit_name(settings, unit)} twice")
    return changes


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
        units = _units_at(event.bus, "synchronous machine", dict(enumerate(case.unit_buses)))
        if units[0] >= n_sync:
            # Sources come after the groups.
            return [NetworkEvent(start, end, unit=unit + n_wtg) for unit in units]
        return [NetworkEvent(start, end, unit=unit) for unit in units if unit < n_sync]
    if isinstance(event, events.GovernorLoss):
        governed = {number: m.bus for number, m in enumerate(case.machines) if m.governor is not None}
        machines = _units_at(event.bus, "machine with a governor", governed)
        return [NetworkEvent(start, end, governor=machine) for machine in machines]
    if isinstance(event, events.LoadTrip):
        if not case.buses[bus].load_mw and not case.buses[bus].load_mvar:
            loads = [each.number for each in case.buses if each.load_mw or each.load_mvar]
            raise ValueError(f"no load at bus {event.bus}; buses with one: {loads}")
        power = -load_level * complex(plant.buses["load.re"][bus], plant.buses["load.im"][bus])
    else:
        power = complex(event.power_mw, event.reactive_mvar) / case.base_mva
    if isinstance(event, events.LoadRamp):
        end = start + whole_steps("ramp duration", event.duration_s, dt, "simulation step")
    return [NetworkEvent(start, end, bus, power.real, power.imag)]


def _units_at(bus: int, what: str, buses: Mapping[int, int]) -> list[int]:
    """Return the numbers of the units at a bus, of those whose buses are given by their numbers."""
    units = [number for number, at in buses.items() if at == bus]
    if not units:
        raise ValueError(f"no {what} at bus {bus}; buses with one: {sorted(set(buses.values()))}")
    return units
