"""Imposed sources: a voltage of constant size behind an impedance, whose frequency events prescribe.

    δ̇ = ω_n (ω - ω_ref),    ω̇ = r

r is zero but for a frequency ramp; a phase jump adds to δ. A source balances the power at its bus in the power flow. It
does not count in the centre of inertia: the units that it drags along do.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

from wtg_gym.physics.devices import Devices
from wtg_gym.physics.network import Source
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.units import LANE, UNITS, Connection, Joining, Phasor, Sample, Terminal, quotient
from wtg_gym.systems.elementary import sine_cosine
from wtg_gym.systems.systems import Kind, system


class SourceState(NamedTuple):
    """States."""

    angle: float  # δ of its voltage against the frame [rad]
    speed: float  # ω [p.u.]


class SourceInput(NamedTuple):
    """Inputs, constant between events."""

    emf: float  # size of its voltage [p.u.]
    ramp: float  # r [p.u./s]
    connected: float  # 1, or 0 after a loss


SOURCES = Kind(
    name="imposed sources",
    rows={"state": SourceState, "given": SourceInput},
    sees={"unit": UNITS, "lane": LANE},
    states=("state",),
)


@system(SOURCES, "planned_power")
def plan_source() -> float:
    """Return the power before the balance's share."""
    return 0.0


@system(SOURCES, "state", "given")
def start_source(start: Terminal, connection: Connection, frame: float) -> tuple[SourceState, SourceInput]:
    """Return the voltage that gives what the power flow asks for, at nominal frequency."""
    drop = quotient(start.current, connection.y)
    re, im = start.voltage.re + drop.re, start.voltage.im + drop.im
    return SourceState(math.atan2(im, re) - frame, 1.0), SourceInput(math.hypot(re, im), 0.0, 1.0)


@system(SOURCES, "voltage")
def voltage_of_source(state: SourceState, given: SourceInput) -> Phasor:
    """Return the voltage behind the impedance."""
    sine, cosine = sine_cosine(state.angle)
    return Phasor(given.emf * cosine, given.emf * sine)


@system(SOURCES, "state_rates")
def rates_of_source(state: SourceState, given: SourceInput, reference_speed: float, omega_n: float) -> SourceState:
    """Return the rates."""
    return SourceState(omega_n * (state.speed - reference_speed), given.ramp)


@system(SOURCES, "sample")
def sample_source(state: SourceState, given: SourceInput) -> Sample:
    """Return the angle, which others can slip against; its voltage is beyond doubt."""
    return Sample(state.angle, 1.0, given.connected, 0.0)


stage_of_source = moving(rates_of_source)


@functools.lru_cache(maxsize=64)
def source_units(sources: tuple[Source, ...]) -> tuple[Devices, ...]:
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
                Joining.PLAN: (plan_source,),
                Joining.SETTLE: (start_source,),
                Joining.VOLTAGES: (voltage_of_source,),
                Joining.MOVE: (stage_of_source,),
                Joining.RATES: (rates_of_source,),
                Joining.SAMPLE: (sample_source,),
            },
        ),
    )
