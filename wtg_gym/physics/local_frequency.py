"""Local frequency: at every bus, from the angle of its voltage, and the farthest from nominal of all buses and units.

    f += (1 - exp(-Δ / T)) (Δθ / (ω_n Δ) - f)        whenever protections sample, Δ after the last time

is the derivative of the angle behind a low-pass filter T, exact for an angle that turns evenly in between; Δθ is taken
between -π and π in the frame of the angles. It starts at nominal frequency, and waits while the voltage is below
0.2 p.u., as a relay does, after which it begins with the grid's.
"""

from __future__ import annotations

import math

from wtg_gym.physics.units import BUSES, LANE, LOW_VOLTAGE, TRANSFERS, UNITS, Phasor, Sampled, plus
from wtg_gym.systems.elementary import exponential, fma, select
from wtg_gym.systems.programs import Product
from wtg_gym.systems.systems import system

#: Time constant T of the filter [s]: a design value, the length of the shortest window of loss-of-mains relays.
FILTER_S = 0.1
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
    """Return the angle from one voltage to another [rad]: twice the arctangent of the tangent of its half."""
    re = fma(now.re, before.re, now.im * before.im)
    im = fma(now.im, before.re, -(now.re * before.im))
    opposite, adjacent = abs(im), math.sqrt(fma(re, re, im * im)) + re
    t = min(opposite, adjacent) / max(max(opposite, adjacent), 1e-300)
    square, total = t * t, _ARCTAN[-1]
    for coefficient in _ARCTAN[-2::-1]:
        total = fma(total, square, coefficient)
    size = select(opposite > adjacent, math.pi - 2.0 * (t * total), 2.0 * (t * total))
    return select(im < 0.0, -size, size)


@system(LANE, "noise_voltage", when="extended")
def reset_noise_voltage() -> Phasor:
    """Begin the voltage at the bus of the load noise."""
    return Phasor(0.0, 0.0)


@system(UNITS, "noise_voltage", when="extended")
def add_noise_voltage(transfer: Phasor, voltage: Phasor, noise_voltage: Phasor) -> Phasor:
    """Add what a unit brings to it."""
    return plus(noise_voltage, transfer, voltage)


@system(LANE, "noise_voltage", when="extended")
def noise_current(noise_voltage: Phasor, noise_factor: Phasor) -> Phasor:
    """Turn it into the current of the load noise [p.u.]."""
    return plus(Phasor(0.0, 0.0), noise_voltage, noise_factor)


@system(BUSES, "now", when="extended")
def with_noise(now: Phasor, noise_voltage: Phasor, noise_transfer: Phasor) -> Phasor:
    """Take from the voltage of a bus what the load noise draws."""
    return plus(now, Phasor(-noise_voltage.re, -noise_voltage.im), noise_transfer)


#: Voltages of all buses, from those of all units.
BUS_VOLTAGES = (
    reset_noise_voltage,
    add_noise_voltage,
    noise_current,
    Product(TRANSFERS, "share", UNITS, "voltage", "now", of=BUSES),
    with_noise,
)


@system(LANE, "lowest", "highest", "sampled", when="extended")
def reset_frequency_sample(
    angle: float, sampled_angle: float, step: float, sampled_step: float, omega_n: float, simulation_dt: float
) -> tuple[float, float, Sampled]:
    """Begin to look for the frequency that is farthest from nominal, and find how far the frame has turned."""
    passed = max(step - sampled_step, 1.0) * simulation_dt
    gain = 1.0 - exponential(passed * (-1.0 / FILTER_S))
    return math.inf, -math.inf, Sampled(1.0 / (omega_n * passed), angle - sampled_angle, gain)


@system(BUSES, "phasor", "magnitude", "frequency", "lowest", "highest", when="extended")
def sample_bus(
    phasor: Phasor,
    now: Phasor,
    magnitude: float,
    frequency: float,
    island: float,
    sampled: Sampled,
    lowest: float,
    highest: float,
    coi: float,
    active: float,
) -> tuple[Phasor, float, float, float, float]:
    """Return the new voltage, the frequency that its turn shows, and the extremes with it."""
    measured = 1.0 + (sampled.turn + turn_between(phasor, now)) * sampled.per_turn
    live, runs = island >= 0.0, active > 0.5
    size = math.sqrt(fma(now.re, now.re, now.im * now.im))
    seen = runs & live & (size > LOW_VOLTAGE)
    # A bus that had no voltage begins with the grid's frequency.
    moved = select(magnitude > LOW_VOLTAGE, frequency + sampled.gain * (measured - frequency), coi)
    found = select(seen, moved, frequency)
    held = Phasor(select(runs, now.re, phasor.re), select(runs, now.im, phasor.im))
    size = select(runs, size, magnitude)
    return held, size, found, min(lowest, select(live, found, lowest)), max(highest, select(live, found, highest))


@system(UNITS, "lowest", "highest", when="extended")
def sample_unit(omega: float, weight: float, lowest: float, highest: float) -> tuple[float, float]:
    """Compare a connected unit."""
    counts = weight > 0.0
    return min(lowest, select(counts, omega, lowest)), max(highest, select(counts, omega, highest))


@system(LANE, "worst", "worst_min", "worst_max", "sampled_angle", "sampled_step", when="extended")
def note_worst(
    lowest: float,
    highest: float,
    worst: float,
    worst_min: float,
    worst_max: float,
    angle: float,
    step: float,
    active: float,
) -> tuple[float, float, float, float, float]:
    """Note the worst frequency now, the extremes since the start, and when this was."""
    runs, farther = active > 0.5, select(1.0 - lowest > highest - 1.0, lowest, highest)
    return (
        select(runs, farther, worst),
        select(runs, min(worst_min, lowest), worst_min),
        select(runs, max(worst_max, highest), worst_max),
        angle,
        step,
    )


LOCAL = (*BUS_VOLTAGES, reset_frequency_sample, sample_bus, sample_unit, note_worst)


@system(BUSES, "phasor", "magnitude", "frequency", when="extended")
def start_bus(now: Phasor) -> tuple[Phasor, float, float]:
    """Return the voltage that a run starts with, at nominal frequency."""
    return now, math.hypot(now.re, now.im), 1.0
