"""Local frequency: at every bus, from the angle of its voltage, and the farthest from nominal of all buses and units.

    f += (1 - exp(-h / T)) (Δθ / (ω_n h) - f)        after every step h, Δθ the turn of the voltage in it

is the derivative of the angle behind a low-pass filter T, exact for an angle that moves evenly within a step. It starts
at nominal frequency, and waits while the voltage is below :data:`LOW_VOLTAGE`, as a relay does.
"""

from __future__ import annotations

import math

from wtg_gym.physics.units import BUSES, LANE, TRANSFERS, UNITS, Phasor
from wtg_gym.systems.elementary import fma, select
from wtg_gym.systems.systems import system

#: Time constant T of the filter [s]: a design value, the length of the shortest window of loss-of-mains relays.
FILTER_S = 0.1
#: Voltage below which a bus's frequency is not measured [p.u.], by design.
LOW_VOLTAGE = 0.2
#: arctan t = t P(t²) for |t| ≤ 1, interpolated at the Chebyshev nodes of t² in 0 … 1.
_ARCTAN = (
    0.999999999998197,
    -0.33333333262482967,
    0.19999995340490048,
    -0.14285592395639787,
    0.11109428372711115,
    -0.09076798900548438,
    0.07614250202479768,
    -0.06366092036692635,
    0.05045557051279092,
    -0.03526770820050834,
    0.01993742902003464,
    -0.008241890713208962,
    0.0021627909862173417,
    -0.00026660141018806016,
)


def turn_between(before: Phasor, now: Phasor) -> float:
    """Return the angle from one voltage to another [rad], within ±π/2: twice the arctangent of the half."""
    re = fma(now.re, before.re, now.im * before.im)
    im = fma(now.im, before.re, -(now.re * before.im))
    t = im / max(math.sqrt(re * re + im * im) + re, 1e-12)
    t = min(max(t, -1.0), 1.0)
    square, total = t * t, _ARCTAN[-1]
    for coefficient in _ARCTAN[-2::-1]:
        total = fma(total, square, coefficient)
    return 2.0 * t * total


@system(LANE, "noise_voltage", when="extended")
def begin_noise_voltage() -> Phasor:
    """Begin the voltage at the bus of the load noise."""
    return Phasor(0.0, 0.0)


@system(UNITS, "noise_voltage", when="extended")
def add_noise_voltage(transfer: Phasor, voltage: Phasor, noise_voltage: Phasor) -> Phasor:
    """Add what a unit brings to it."""
    return _plus(noise_voltage, transfer, voltage)


@system(BUSES, "now", when="extended")
def begin_voltage(noise_voltage: Phasor, noise_factor: Phasor, noise_transfer: Phasor) -> Phasor:
    """Begin the voltage of a bus with what the load noise takes away."""
    drawn = _plus(Phasor(0.0, 0.0), noise_factor, noise_voltage)
    taken = _plus(Phasor(0.0, 0.0), drawn, noise_transfer)
    return Phasor(-taken.re, -taken.im)


@system(TRANSFERS, "bus_now", when="extended")
def add_voltage(bus_now: Phasor, share: Phasor, unit_voltage: Phasor) -> Phasor:
    """Add what a unit brings to the voltage of a bus."""
    return _plus(bus_now, share, unit_voltage)


def _plus(total: Phasor, a: Phasor, b: Phasor) -> Phasor:
    return Phasor(total.re + fma(a.re, b.re, -(a.im * b.im)), total.im + fma(a.re, b.im, a.im * b.re))


@system(BUSES, "phasor", "frequency", when="extended")
def turn_bus(
    phasor: Phasor,
    now: Phasor,
    frequency: float,
    angle: float,
    angle_base: float,
    active: float,
    omega_n: float,
    simulation_dt: float,
    frequency_gain: float,
) -> tuple[Phasor, float]:
    """Return the new voltage, and the frequency that its turn shows."""
    measured = 1.0 + (angle - angle_base + turn_between(phasor, now)) / (omega_n * simulation_dt)
    seen = fma(now.re, now.re, now.im * now.im) > LOW_VOLTAGE * LOW_VOLTAGE
    runs = active > 0.5
    moved = frequency + frequency_gain * (measured - frequency)
    held = Phasor(select(runs, now.re, phasor.re), select(runs, now.im, phasor.im))
    return held, select(runs & seen, moved, frequency)


@system(BUSES, "phasor", "frequency", when="extended")
def start_bus(now: Phasor) -> tuple[Phasor, float]:
    """Return the voltage that a run starts with, at nominal frequency."""
    return now, 1.0


@system(LANE, "lowest", "highest", when="extended")
def begin_worst() -> tuple[float, float]:
    """Begin to look for the frequency that is farthest from nominal."""
    return math.inf, -math.inf


@system(BUSES, "lowest", "highest", when="extended")
def compare_bus(frequency: float, island: float, lowest: float, highest: float) -> tuple[float, float]:
    """Compare a bus that has a voltage."""
    counts = island >= 0.0
    return min(lowest, select(counts, frequency, lowest)), max(highest, select(counts, frequency, highest))


@system(UNITS, "lowest", "highest", when="extended")
def compare_unit(frequency: float, weight: float, lowest: float, highest: float) -> tuple[float, float]:
    """Compare a connected unit."""
    counts = weight > 0.0
    return min(lowest, select(counts, frequency, lowest)), max(highest, select(counts, frequency, highest))


@system(LANE, "worst", "worst_min", "worst_max", when="extended")
def note_worst(
    lowest: float, highest: float, worst: float, worst_min: float, worst_max: float, active: float
) -> tuple[float, float, float]:
    """Note the worst frequency now, and the extremes since the start."""
    runs, farther = active > 0.5, select(1.0 - lowest > highest - 1.0, lowest, highest)
    return (
        select(runs, farther, worst),
        select(runs, min(worst_min, lowest), worst_min),
        select(runs, max(worst_max, highest), worst_max),
    )
