"""Kinds of unit besides machines and WTG groups: user-defined devices, and imposed sources."""

import cmath
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from wtg_gym.physics import grid, layout, units
from wtg_gym.physics.units import ENV, UNITS, Connection, Joining, Phasor, Sample, Terminal
from wtg_gym.ranges import did_you_mean, require_known, require_range
from wtg_gym.systems.systems import Kind, System, is_record, setting, short_names, system

#: Where systems have to join.
_NEEDED = (Joining.PLAN, Joining.SETTLE, Joining.VOLTAGES, Joining.MOVE, Joining.RATES)


@dataclass(frozen=True, eq=False, kw_only=True)
class Devices:
    """Units of a user-defined kind, each a voltage behind an impedance at a bus."""

    #: What they keep. It sees its :data:`~wtg_gym.physics.units.UNITS` by a label, and has a number `connected`.
    kind: Kind
    buses: tuple[int, ...]  # bus number of each
    impedances: tuple[complex, ...]  # internal impedance of each [p.u. of the system]
    reactive_weights: tuple[float, ...]  # of each in the reactive power of its bus, a rating on the system base [p.u.]
    constants: Mapping[str, Sequence[Any]]  # of the kind, one entry for each unit
    #: By where they join the lists of a step, of :class:`~wtg_gym.physics.units.Joining`: "plan" writes
    #: `planned_power`, "settle" finds the equilibrium from `start`, "voltages" writes `voltage`, "move" has the stages
    #: of the integration and "rates" what they are made of; if wanted "start", "charge", "observe", and "sample", which
    #: writes what protections compare. The centre of inertia does not see devices.
    systems: Mapping[str, tuple[System, ...]]
    shown: str | None = None  # a part in scratch that observations end with
    has: tuple[str, ...] = ()  # conditions of the kind that hold
    balances: bool = False  # whether they balance the power at their buses and hold the voltage, as machines do

    def __post_init__(self) -> None:
        n, kind, name = len(self.buses), self.kind, self.kind.name
        numbers = {"impedances": self.impedances, "reactive_weights": self.reactive_weights, **self.constants}
        for what, values in numbers.items():
            if len(values) != n:
                raise ValueError(f"{n} {name} need {n} {what}, got {len(values)}")
        if not all(cmath.isfinite(value) and value != 0.0 for value in self.impedances):
            raise ValueError(f"impedances of {name} must be finite and not 0 p.u., got {self.impedances}")
        for weight in self.reactive_weights:
            require_range(f"a reactive weight of {name}", weight, 1e-9, 1e6, "p.u.")
        require_known(f"places for systems of {name}", self.systems, list(Joining))
        if missing := [place for place in _NEEDED if place not in self.systems]:
            raise ValueError(f"{name} have no systems for {', '.join(missing)}")
        if others := {entry.kind.name for systems in self.systems.values() for entry in systems} - {name}:
            raise ValueError(f"systems of {', '.join(sorted(others))} cannot join for {name}")
        if set(self.constants) != set(kind.constants):
            raise ValueError(f"{name} have the constants {sorted(kind.constants)}, got {sorted(self.constants)}")
        if "connected" not in layout.names_of(kind):
            raise ValueError(f"the rows of {name} have no number `connected`, which says whether a unit is")
        if self.shown is not None and not is_record(kind.scratch.get(self.shown)):
            like = did_you_mean(self.shown, kind.scratch)
            raise ValueError(f"{self.shown!r} is no record in scratch of {name}{like}")

    def names(self) -> list[str]:
        """Return the names of what observations show, one unit after the other."""
        if self.shown is None:
            return []
        parts = short_names(self.kind.scratch[self.shown])
        return [f"{self.kind.name}{j}.{part}" for j in range(len(self.buses)) for part in parts]


class SourceState(NamedTuple):
    angle: float  # δ of its voltage against the frame [rad]
    speed: float  # ω [p.u.]


class SourceInput(NamedTuple):
    """Inputs, constant between events."""

    emf: float  # size of its voltage [p.u.]
    ramp: float  # r [p.u./s]
    connected: float  # 1, or 0 after a loss


SOURCES = Kind(
    name="imposed sources",
    rows={"state": SourceState, "inputs": SourceInput},
    sees={"unit": UNITS, "env": ENV},
    states=("state",),
)


@system(SOURCES, "state", "inputs")
def start_source(start: Terminal, connection: Connection, frame: float) -> tuple[SourceState, SourceInput]:
    """Return the voltage that gives what the power flow asks for, at nominal frequency."""
    emf, angle = units.internal_voltage(start, connection)
    return SourceState(angle - frame, 1.0), SourceInput(emf, 0.0, 1.0)


@system(SOURCES, "voltage")
def voltage_of_source(state: SourceState, inputs: SourceInput) -> Phasor:
    """Return the voltage behind the impedance."""
    return units.phasor(inputs.emf, state.angle)


@system(SOURCES, "state_rates")
def rates_of_source(state: SourceState, inputs: SourceInput, reference_speed: float, omega_n: float) -> SourceState:
    return SourceState(omega_n * (state.speed - reference_speed), inputs.ramp)


@system(SOURCES, "sample")
def sample_source(state: SourceState, inputs: SourceInput) -> Sample:
    """Return the angle, which others can slip against; the voltage counts as 1 p.u."""
    return Sample(state.angle, 1.0, inputs.connected, 0.0)


stage_of_source = units.moving(rates_of_source)


@functools.lru_cache(maxsize=64)
def source_units(sources: tuple[grid.Source, ...]) -> tuple[Devices, ...]:
    """Return the imposed sources of a network as devices."""
    if not sources:
        return ()
    return (
        Devices(
            kind=SOURCES,
            buses=tuple(source.bus for source in sources),
            impedances=tuple(complex(source.resistance, source.reactance) for source in sources),
            reactive_weights=(1.0,) * len(sources),
            balances=True,
            constants={},
            systems={
                Joining.PLAN: (setting(SOURCES, planned_power=0.0),),
                Joining.SETTLE: (start_source,),
                Joining.VOLTAGES: (voltage_of_source,),
                Joining.MOVE: (stage_of_source,),
                Joining.RATES: (rates_of_source,),
                Joining.SAMPLE: (sample_source,),
            },
        ),
    )
