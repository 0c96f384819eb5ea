"""Systems of the start: what buses and units plan, the reactive limits of groups, and what each unit starts from.

Between them the power flow is solved (:mod:`wtg_gym.physics.equilibrium`).
"""

import math

from wtg_gym.physics import units
from wtg_gym.physics.units import BUSES, ENV, UNITS, Bus, Connection, Phasor, Sizes
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.elementary import select
from wtg_gym.systems.systems import system


@system(BUSES, "needed")
def add_needed_load(needed: float, load_level: float, bus: Bus) -> float:
    return needed + load_level * bus.load.re


@system(GROUPS, "needed")
def subtract_group_power(needed: float, planned_power: float) -> float:
    return needed - planned_power


@system(BUSES, "lacking")
def find_slack_mismatch(lacking: float, flow: Phasor, planned: Phasor, bus: Bus) -> float:
    return lacking + select(bus.is_slack, flow.re - planned.re, 0.0)


@system(UNITS, "planned", "planned_power")
def balance_unit(planned: Phasor, planned_power: float, lacking: float, connection: Connection) -> tuple[Phasor, float]:
    """Let a unit give its share of what the slack bus lacks."""
    balance = connection.participation * lacking
    return Phasor(planned.re + balance, planned.im), planned_power + balance


@system(BUSES, "planned", "polar", "holds", "sizes")
def plan_bus(load_level: float, bus: Bus) -> tuple[Phasor, units.Polar, float, Sizes]:
    """Return what a bus takes without units, and where its power flow starts."""
    planned = Phasor(-load_level * bus.load.re, -load_level * bus.load.im)
    return planned, units.Polar(bus.voltage, 0.0), select(bus.holds_voltage, 1.0, 0.0), Sizes(0.0, 0.0, 0.0)


@system(UNITS, "planned", "sizes")
def plan_unit(planned: Phasor, planned_power: float, sizes: Sizes, connection: Connection) -> tuple[Phasor, Sizes]:
    """Add a unit to its bus."""
    return Phasor(planned.re + planned_power, planned.im), Sizes(
        sizes.ratings + connection.rating,
        sizes.machine_weights + connection.machine_weight,
        sizes.group_weights + connection.group_weight,
    )


@system(BUSES, "holds", "planned", "released")
def release_voltage(
    holds: float,
    planned: Phasor,
    released: float,
    flow: Phasor,
    sizes: Sizes,
    bus: Bus,
    load_level: float,
    reactive_max: float,
    voltage_gain: float,
) -> tuple[float, Phasor, float]:
    """Turn a bus whose WTG groups lack the reactive power to hold the voltage into a PQ bus.

    A bus with a machine too keeps its voltage: the machine gives what is missing.
    """
    demand, limit = flow.im + load_level * bus.load.im, reactive_max * sizes.group_weights
    alone = (sizes.ratings == 0.0) & (sizes.group_weights > 0.0) & (voltage_gain > 0.0)
    lacks = alone & (holds > 0.5) & (abs(demand) > limit * (1.0 + 1e-9))
    reactive = select(demand < 0.0, -limit, limit) - load_level * bus.load.im
    return (
        select(lacks, 0.0, holds),
        Phasor(planned.re, select(lacks, reactive, planned.im)),
        released + select(lacks, 1.0, 0.0),
    )


@system(BUSES, "load", "served", "island")
def load_at_bus(load_level: float, polar: units.Polar, bus: Bus) -> tuple[Phasor, float, float]:
    """Turn a load from power at the initial voltage into an admittance; all of it is served, in one island."""
    square = polar.size * polar.size
    return Phasor(load_level * bus.load.re / square, load_level * -bus.load.im / square), 1.0, 0.0


@system(UNITS, "start")
def share_flow(
    planned_power: float,
    planned: Phasor,
    flow: Phasor,
    at_bus: Phasor,
    sizes: Sizes,
    bus: Bus,
    connection: Connection,
    load_level: float,
    reactive_max: float,
    voltage_gain: float,
) -> units.Terminal:
    """Share a bus's power among its units.

    Reactive power goes by the units' weights; beside machines, WTG groups with voltage control give no more than their
    limit. Machines at the slack bus share the active power that is missing by rating.
    """
    total = flow.im + load_level * bus.load.im
    machines, groups = sizes.machine_weights, sizes.group_weights
    weight = connection.machine_weight + connection.group_weight
    reactive = select(bus.holds_voltage, total * weight / (machines + groups), 0.0)
    limit = reactive_max * groups
    of_groups = min(max(total * groups / (machines + groups), -limit), limit)
    of_group, of_machine = of_groups * weight / groups, (total - of_groups) * weight / machines
    limited = select(connection.group_weight > 0.0, of_group, of_machine)
    mixed = (voltage_gain > 0.0) & (groups > 0.0) & (machines > 0.0) & (reactive != 0.0)
    reactive = select(mixed, limited, reactive)
    gives_slack = bus.is_slack & (connection.rating > 0.0)
    power = planned_power + select(gives_slack, (flow.re - planned.re) * connection.rating / sizes.ratings, 0.0)
    current = units.quotient(Phasor(power, reactive), at_bus)
    return units.Terminal(power, reactive, at_bus, math.hypot(at_bus.re, at_bus.im), Phasor(current.re, -current.im))


@system(ENV, "angle", "sampled_angle")
def start_angle(frame: float) -> tuple[float, float]:
    """Let the angle of the first unit begin where the network's frame is."""
    return frame, frame
