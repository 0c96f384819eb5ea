"""The environment that all units are in, and the network between them."""

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple

from wtg_gym.physics.wind_turbine import Limits
from wtg_gym.systems.elementary import fma, select, sine_cosine
from wtg_gym.systems.systems import Kind, System, each, system

_OF_STAGE = ("active", "ahead", "first", "last")


def moving(rates: System, *limits: Callable[..., Any] | None, constants: Sequence[str] = ()) -> System:
    """Return the system that moves the states whose rates another system finds, by a stage of the method.

    Scalars say how far the stage goes (`ahead` [s], a sixth of the step for the last) and whether it is the `first` or
    the `last`.

    Args:
        rates: writes "x_rates" of states "x" first, then other parts.
        limits: for each of these states the function of it and of some constants that holds it within its limits, which
            it does at the end of a step; None where there are none.
        constants: names of those that each limit depends on.
    """
    states = tuple(name.removesuffix("_rates") for name in rates.writes if name.endswith("_rates"))
    bases_and_sums = tuple(f"{state}_{what}" for state in states for what in ("base", "sum"))
    rate_arguments, equation = rates.arguments_named, rates.equation
    arguments = tuple(dict.fromkeys((*rate_arguments, *states, *bases_and_sums, *constants, *_OF_STAGE)))

    def stage(*values: Any) -> tuple[Any, ...]:
        named = dict(zip(arguments, values, strict=True))
        results = equation(*(named[name] for name in rate_arguments))
        results = results if type(results) is tuple else (results,)
        active, ahead, first, last = (named[name] for name in _OF_STAGE)
        moved: list[Any] = []
        for i, state in enumerate(states):
            base, total = named[f"{state}_base"], named[f"{state}_sum"]
            free, base, total = _moved(named[state], base, total, results[i], ahead, first, last)
            limit = limits[i] if limits else None
            within = free if limit is None else limit(free, named[constants[i]])
            moved += (_kept(free, within, base, last, active), base, total)
        return (*moved, *results[len(states) :])

    writes = [name for state in states for name in (state, f"{state}_base", f"{state}_sum")]
    origin = functools.partial(moving, constants=constants), (rates, *limits)
    written = (*writes, *rates.writes[len(states) :])
    return System(rates.kind, stage, written, rates.when, arguments=arguments, origin=origin)


def _moved(
    state: Any, base: Any, total: Any, rates: Any, ahead: float, first: float, last: float
) -> tuple[Any, Any, Any]:
    """Return states that a stage has moved, their base and the sum of their rates."""
    base = each(lambda now, before: select(first > 0.5, now, before), state, base)
    # The last stage goes along the sum of all rates, k1 + 2 k2 + 2 k3 + k4; that sum is not read again.
    along = each(lambda rate, so_far: select(last > 0.5, so_far + rate, rate), rates, total)
    moved = each(lambda way, start: fma(ahead, way, start), along, base)
    more = each(lambda rate, so_far: select(first > 0.5, rate, fma(2.0, rate, so_far)), rates, total)
    return moved, base, each(lambda new, so_far: select(last > 0.5, so_far, new), more, total)


def _kept(moved: Any, within: Any, base: Any, last: float, active: float) -> Any:
    """Return states after a stage; an ended one keeps its base exactly, to which not even a rounding is added."""
    held = each(lambda free, limited: select(last > 0.5, limited, free), moved, within)
    return each(lambda new, old: select(active > 0.5, new, old), held, base)


#: Voltage below which nothing measures a frequency [p.u.], by design.
LOW_VOLTAGE = 0.2


class Phasor(NamedTuple):
    """A voltage, a current or an admittance [p.u.]."""

    re: float
    im: float


class Terminal(NamedTuple):
    """What a unit starts from at its terminal [p.u.]."""

    power: float
    reactive: float
    voltage: Phasor
    magnitude: float  # of the voltage
    current: Phasor  # into the network


class Polar(NamedTuple):
    """A voltage by magnitude [p.u.] and angle [rad]."""

    size: float
    turn: float


class Sizes(NamedTuple):
    """Sums over the units at a bus."""

    ratings: float  # by which machines share what the slack gives
    machine_weights: float  # by which units share reactive power
    group_weights: float


class Bus(NamedTuple):
    load: Phasor  # P + jQ of the case [p.u.]
    voltage: float  # held, or where the power flow starts [p.u.]
    holds_voltage: bool
    is_slack: bool


class Connection(NamedTuple):
    """Constants of a unit in the network."""

    number: float  # among all units
    rating: float  # of a machine; 0 for a group
    machine_weight: float  # share of reactive power; 0 for a group
    group_weight: float  # 0 for a machine
    participation: float  # share of what all machines give at the start; 0 where the case says what it gives
    y: Phasor  # internal admittance [p.u.]


class Sampled(NamedTuple):
    """What happened between two samples of the local frequencies."""

    per_turn: float  # 1/(ω_n Δ) [p.u./rad]
    turn: float  # of the frame [rad]
    gain: float  # of the filter


class Sample(NamedTuple):
    """What is compared of a unit."""

    turn: float  # angle [rad]
    squared_voltage: float  # at the terminal [p.u.²]
    there: float  # 1 where it is connected
    falls: float  # 1 where its island has failed


class Failure(NamedTuple):
    """Why a run cannot start, of :class:`StartFailure`, and the number of the unit that cannot."""

    start_failure: float
    failing_unit: float


class Verdict(NamedTuple):
    """What the protections find now."""

    code: float  # of protection.Status, 0 for none
    finite: float  # 1 where all speeds are finite numbers


class Sums(NamedTuple):
    """Sums over the connected units of an island."""

    momentum: float  # Σ 2H (ω - 1) [s]
    inertia: float  # Σ 2H [s]


class Spread(NamedTuple):
    """Extremes of the connected units of an island."""

    least_angle: float  # [rad]
    largest_angle: float
    least_squared_voltage: float  # at the terminals [p.u.²]


class StartFailure(IntEnum):
    """Why a run cannot start; 0 means it can."""

    NONE = 0
    NO_TURBINE_EQUILIBRIUM = 1
    POWER_FLOW_DIVERGED = 2
    GOVERNOR_LIMIT = 3
    EXCITER_LIMIT = 4
    CONVERTER_LIMIT = 5
    INTERNAL_VOLTAGE_LIMIT = 6
    WIND_SHORTAGE = 7


class TripCause(IntEnum):
    """Why a WTG group was disconnected; a failure of its rotor has the number that it has in `protection.Status`."""

    EVENT = 0  # of the scenario; what is noted before any trip, too
    STALL = 1
    OVER_SPEED = 2
    ISLAND_LOST = 3
    OVER_VOLTAGE = 4
    CHOPPER = 5
    UNDER_SPEED = 7


class Joining(StrEnum):
    """Where systems of devices may join the lists of a step; the last two are lists of the task."""

    PLAN = "plan"
    SETTLE = "settle"
    VOLTAGES = "voltages"
    MOVE = "move"
    RATES = "rates"
    SAMPLE = "sample"
    START = "start"
    CHARGE = "charge"
    OBSERVE = "observe"


class ControlJoining(StrEnum):
    """Where systems of controls that only some machines have join those lists."""

    SETTLE = "control settle"
    MOVE = "control move"
    RATES = "control rates"
    START = "control start"


def joining(systems: Sequence[Mapping[str, tuple[System, ...]]]) -> dict[str, tuple[System, ...]]:
    """Return the systems of several, each by the places where they join lists, as those of all by these places."""
    places = dict.fromkeys(itertools.chain(*systems))
    return {place: tuple(itertools.chain(*(each.get(place, ()) for each in systems))) for place in places}


#: The environment that a unit is in, a column of a block. Numbers of a whole run are of the environment.
ENV = Kind(
    name="environments",
    rows={
        "angle": float,  # of the first unit against a frame at nominal frequency [rad]
        "active": float,  # 1 while it runs, 0 once it has ended
        "step": float,  # simulation steps since the reset
        "next_change": float,  # simulation step of the next network change
        "last_change": float,  # simulation step at which the network was last reduced
        "status": float,  # of protection.Status
        "coi": float,  # frequency of the centre of inertia [p.u.]
        "coi_min": float,  # least since the start [p.u.]
        "coi_max": float,
        "noise_bus": float,  # index of the bus of the load noise
        "noise_z": Phasor,  # Thévenin impedance at the bus of the load noise [p.u.]
        "noise_per_mw": float,  # admittance per MW of load noise [p.u.]
        "noise_y": float,  # conductance of the load noise in the present control interval [p.u.]
        "unserved": float,  # load that is shed or without voltage, at 1 p.u. of voltage [p.u.]
        "shed_energy": float,  # its integral [p.u. s]
        "worst": float,  # frequency of the bus or unit that is farthest from nominal [p.u.]
        "worst_min": float,  # least frequency of any bus or unit since the start [p.u.]
        "worst_max": float,
        "sampled_angle": float,  # of the frame when the protections last sampled [rad]
        "sampled_step": float,  # and the simulation step
        "was_low": float,  # 1 while an island's frequency is below that of the first stage of shedding
        "split": float,  # 1 while there is another island than the grid
    },
    scratch={
        "reference_speed": float,  # of the first unit, or where it stands still after an outage [p.u.]
        "noise_factor": Phasor,  # of the load noise's part in the reduced admittance: Δy/(1 + Δy z) [p.u.]
        "exceeded": float,  # groups whose current is too large
        "unsettled": float,  # groups whose voltage the latest sweep has moved
        "lowest": float,  # frequency of any bus or unit now [p.u.]
        "highest": float,
        "sampled": Sampled,
        "noise_voltage": Phasor,  # at the bus of the load noise, if there were none; then its current [p.u.]
        "verdict": Verdict,
        "alarm": float,  # 1 where the stages of shedding have to be looked at
        "stops": float,  # 1 where a protection ends the run now
        "load_level": float,  # share of the nominal load that a run starts with
        "searching": float,  # groups whose equilibrium is not found yet
        "released": float,  # buses that let go of their voltage
        "needed": float,  # load beyond the power of the groups [p.u.]
        "lacking": float,  # missing at the slack bus [p.u.]
        "curtailment": float,  # common factor on k by which groups share the balance
        "frame": float,  # angle of the first unit against the network's frame [rad]
        "failure": Failure,
    },
    constants={
        "omega_n": float,
        "base_mva": float,
        "shedding_speed": float,  # frequency at which the first stage of load shedding acts [p.u.]
        "simulation_dt": float,
        "limits": Limits,
        "trips_groups": bool,
        "reactive_max": float,  # of the groups' voltage control [p.u.]
        "voltage_gain": float,  # of that; 0 without one
        "secondary_gain": float,  # simulation step over the time of secondary control; 0 without one
    },
    states=("angle",),
    conditions=(
        *("table", "curve"),  # of C_p
        *("extended", "constant voltage"),  # WTG groups
        "no machine",
        "saturates",  # the rotor of a machine
        "sheds",  # load, by stages
        "secondary control",
    ),
)
#: Parts of the network that hang together; the first has the most of the load that a run starts with, and is the grid,
#: whose end is the run's.
ISLANDS = Kind(
    name="islands",
    rows={
        "centre": float,  # frequency of its centre of inertia [p.u.]
        "healthy_step": float,  # last simulation step at which the protections found no low voltage
        "turned": float,  # angle of one of its units when the protections last sampled [rad]
    },
    scratch={
        "sums": Sums,
        "spread": Spread,
        "violation": float,  # status that the protections find now
    },
    constants={"number": float},
    sees={"env": ENV},
)
#: Buses of the network; their scratch serves the start of a run.
BUSES = Kind(
    name="buses",
    rows={
        "load": Phasor,  # admittance [p.u.]
        "served": float,  # share of its load that shedding has left
        "island": float,  # number of the island that it is in, -1 without voltage
        "noise_transfer": Phasor,  # impedance to the bus of the load noise [p.u.]
        "phasor": Phasor,  # voltage when the protections last sampled [p.u.]
        "magnitude": float,  # of that voltage [p.u.]
        "frequency": float,  # local, filtered [p.u.]
    },
    scratch={
        "present_voltage": Phasor,  # voltage now [p.u.]
        "planned": Phasor,  # P + jQ into the network before the slack's share [p.u.]
        "polar": Polar,
        "holds": float,  # 1 where a unit holds the voltage
        "flow": Phasor,  # P + jQ from the units and loads into the branches [p.u.]
        "at_bus": Phasor,  # voltage [p.u.]
        "sizes": Sizes,
    },
    constants={"bus": Bus},
    sees={"env": ENV},
)
#: All units as the network sees them, machines first.
UNITS = Kind(
    name="units",
    rows={
        "transfer": Phasor,  # y_i Z_in to the bus n of the load noise
        "transfer_back": Phasor,  # Z_ni y_i from it: the same where no branch shifts the phase
        "island": float,  # number of the island that it is in
        "committed": float,  # share of a machine's rating that is on line; 1 for others
        "inv_committed": float,
    },
    scratch={
        "voltage": Phasor,  # behind the internal impedance
        "current": Phasor,  # into the network
        "planned_power": float,  # before the slack's share [p.u.]
        "start": Terminal,
        "weight": float,  # 2H, 0 where it is disconnected [s]
        "omega": float,  # frequency [p.u.]
        "sample": Sample,
    },
    constants={"connection": Connection},
    sees={"env": ENV, "bus": BUSES, "grid_": ISLANDS},
)
#: Every unit with every island but the grid, island after island.
MEMBERS = Kind(name="members", sees={"unit_": UNITS, "island_": ISLANDS, "env": ENV})
#: The first island.
MAIN = Kind(name="main island", sees={"island": ISLANDS, "env": ENV})
#: Every unit's effect on every bus, bus after bus.
TRANSFERS = Kind(name="transfers", rows={"share": Phasor}, sees={"bus_": BUSES, "unit_": UNITS})
#: Pairs of units, row by row of the reduced admittance matrix.
PAIRS = Kind(
    name="pairs",
    rows={"fixed_admittance": Phasor},  # without load noise
    scratch={"admittance": Phasor},
    sees={"row_": UNITS, "column_": UNITS, "env": ENV},
)


def plus(total: Phasor, a: Phasor, b: Phasor) -> Phasor:
    """Return total + a b."""
    return Phasor(total.re + fma(a.re, b.re, -(a.im * b.im)), total.im + fma(a.re, b.im, a.im * b.re))


def noted(fits: bool, reason: int, number: float, failure: Failure) -> Failure:
    """Return why a run cannot start and the number of the unit that cannot, unless another was found before."""
    known = fits | (failure.start_failure != 0.0)
    return Failure(select(known, failure.start_failure, float(reason)), select(known, failure.failing_unit, number))


def quotient(a: Phasor, b: Phasor) -> Phasor:
    """Return a/b, by the larger part of b (Smith's algorithm)."""
    by_real = abs(b.re) >= abs(b.im)
    ratio = select(by_real, b.im / b.re, b.re / b.im)
    below = select(by_real, b.re + b.im * ratio, b.re * ratio + b.im)
    return Phasor(
        select(by_real, a.re + a.im * ratio, a.re * ratio + a.im) / below,
        select(by_real, a.im - a.re * ratio, a.im * ratio - a.re) / below,
    )


def phasor(size: float, angle: float) -> Phasor:
    """Return a voltage of a size [p.u.] and an angle [rad]."""
    sine, cosine = sine_cosine(angle)
    return Phasor(size * cosine, size * sine)


def internal_voltage(start: Terminal, connection: Connection) -> tuple[float, float]:
    """Return size [p.u.] and angle [rad] of the voltage behind a unit's impedance at the start of a run."""
    drop = quotient(start.current, connection.y)
    re, im = start.voltage.re + drop.re, start.voltage.im + drop.im
    return math.hypot(re, im), math.atan2(im, re)


@system(ENV, "noise_factor")
def load_noise(noise_y: float, noise_z: Phasor) -> Phasor:
    """Return Δy/(1 + Δy z) of the load noise's conductance Δy."""
    d_re, d_im = 1.0 + noise_y * noise_z.re, noise_y * noise_z.im
    size = noise_y / (d_re * d_re + d_im * d_im)
    return Phasor(size * d_re, -size * d_im)


@system(PAIRS, "admittance")
def admittance_with_noise(
    row_transfer: Phasor, column_transfer_back: Phasor, noise_factor: Phasor, fixed_admittance: Phasor
) -> Phasor:
    """Put the load noise into the reduced admittance by a rank-one update.

    Y = Y0 + Δy/(1 + Δy z) u wᵀ (Sherman-Morrison): exact for one bus, and cheap enough for every control interval.
    """
    column = column_transfer_back
    v_re = row_transfer.re * column.re - row_transfer.im * column.im
    v_im = row_transfer.re * column.im + row_transfer.im * column.re
    f, y0 = noise_factor, fixed_admittance
    return Phasor(y0.re + f.re * v_re - f.im * v_im, y0.im + f.re * v_im + f.im * v_re)


@system(ENV, "angle_rates")
def reference_rate(reference_speed: float, omega_n: float) -> float:
    """Return the rate of the first unit's angle against a frame at nominal frequency."""
    return omega_n * (reference_speed - 1.0)


reference_stage = moving(reference_rate)


@system(ENV, "step")
def count_step(step: float, active: float) -> float:
    """Count a simulation step of a running environment."""
    return step + select(active > 0.5, 1.0, 0.0)
