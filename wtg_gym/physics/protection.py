"""Protections: frequencies, angles and voltages are watched; a run ends, a group trips, or a load is shed.

The local frequency of every bus follows from the angle of its voltage,

    f += (1 - exp(-Δ / T)) (Δθ / (ω_n Δ) - f)        whenever protections sample, Δ after the last time

which is the angle's derivative behind a low-pass filter T, exact for an angle that turns evenly in between; Δθ is taken
between -π and π in the frame of the angles. It starts at nominal frequency, and waits while the voltage is below
0.2 p.u., as a relay does, after which it begins with the grid's.
"""

import math
from enum import IntEnum
from typing import NamedTuple

from wtg_gym.physics import units, wind_turbine
from wtg_gym.physics.machine import MachineInput, MachineOutput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.units import BUSES, ENV, ISLANDS, UNITS, Phasor, Sample, Spread, Sums, Verdict, plus
from wtg_gym.physics.wind_turbine import Turbine, WtgInput, WtgOutput, WtgState
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.elementary import exponential, fma, select
from wtg_gym.systems.programs import Product
from wtg_gym.systems.systems import Kind, setting, system

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


@system(UNITS, "noise_voltage", when="extended")
def add_noise_voltage(transfer_back: Phasor, voltage: Phasor, noise_voltage: Phasor) -> Phasor:
    """Add a unit's part of the voltage at the bus of the load noise."""
    return plus(noise_voltage, transfer_back, voltage)


@system(ENV, "noise_voltage", when="extended")
def noise_current(noise_voltage: Phasor, noise_factor: Phasor) -> Phasor:
    """Return the current of the load noise [p.u.]: that voltage times its admittance."""
    return plus(Phasor(0.0, 0.0), noise_voltage, noise_factor)


@system(BUSES, "present_voltage", when="extended")
def with_noise(present_voltage: Phasor, noise_voltage: Phasor, noise_transfer: Phasor) -> Phasor:
    """Subtract from the voltage of a bus the drop that the load noise causes."""
    return plus(present_voltage, Phasor(-noise_voltage.re, -noise_voltage.im), noise_transfer)


#: Voltages of all buses, from those of all units.
BUS_VOLTAGES = (
    setting(ENV, "extended", noise_voltage=Phasor(0.0, 0.0)),
    add_noise_voltage,
    noise_current,
    Product(units.TRANSFERS, "share", UNITS, "voltage", "present_voltage", of=BUSES),
    with_noise,
)


@system(ENV, "lowest", "highest", "sampled", when="extended")
def reset_frequency_sample(
    angle: float, sampled_angle: float, step: float, sampled_step: float, omega_n: float, simulation_dt: float
) -> tuple[float, float, units.Sampled]:
    """Reset the extremes of the frequencies, and find how far the frame has turned since the last sample."""
    passed = max(step - sampled_step, 1.0) * simulation_dt
    gain = 1.0 - exponential(passed * (-1.0 / FILTER_S))
    return math.inf, -math.inf, units.Sampled(1.0 / (omega_n * passed), angle - sampled_angle, gain)


@system(BUSES, "phasor", "magnitude", "frequency", "lowest", "highest", when="extended")
def sample_bus(
    phasor: Phasor,
    present_voltage: Phasor,
    magnitude: float,
    frequency: float,
    island: float,
    sampled: units.Sampled,
    lowest: float,
    highest: float,
    coi: float,
    active: float,
) -> tuple[Phasor, float, float, float, float]:
    """Return the new voltage, the frequency that its turn shows, and the extremes with it."""
    measured = 1.0 + (sampled.turn + turn_between(phasor, present_voltage)) * sampled.per_turn
    live, runs = island >= 0.0, active > 0.5
    size = math.sqrt(fma(present_voltage.re, present_voltage.re, present_voltage.im * present_voltage.im))
    seen = runs & live & (size > units.LOW_VOLTAGE)
    # A bus that had no voltage begins with the grid's frequency.
    moved = select(magnitude > units.LOW_VOLTAGE, frequency + sampled.gain * (measured - frequency), coi)
    filtered = select(seen, moved, frequency)
    held = Phasor(select(runs, present_voltage.re, phasor.re), select(runs, present_voltage.im, phasor.im))
    size = select(runs, size, magnitude)
    lowest, highest = min(lowest, select(live, filtered, lowest)), max(highest, select(live, filtered, highest))
    return held, size, filtered, lowest, highest


@system(UNITS, "lowest", "highest", when="extended")
def sample_unit(omega: float, weight: float, lowest: float, highest: float) -> tuple[float, float]:
    """Compare a connected unit."""
    counts = weight > 0.0
    return min(lowest, select(counts, omega, lowest)), max(highest, select(counts, omega, highest))


@system(ENV, "worst", "worst_min", "worst_max", "sampled_angle", "sampled_step", when="extended")
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
def start_bus(present_voltage: Phasor) -> tuple[Phasor, float, float]:
    """Return the voltage that a run starts with, at nominal frequency."""
    return present_voltage, math.hypot(present_voltage.re, present_voltage.im), 1.0


#: Protections sample the grid at the end of every control interval, and at least this often within a longer one [s].
PROTECTION_INTERVAL_S = 0.1


class Status(IntEnum):
    """Why an environment has ended; a stall, an over-speed or an under-speed is the failure of a rotor."""

    RUNNING = 0
    STALL = 1
    OVER_SPEED = 2
    FREQUENCY_LIMIT = 3
    NUMERICAL_FAILURE = 4
    LOSS_OF_SYNCHRONISM = 5
    VOLTAGE_COLLAPSE = 6
    UNDER_SPEED = 7


class Shedding(NamedTuple):
    """A stage of load shedding."""

    speed: float  # frequency of the centre of inertia at which it acts [p.u.]
    share: float  # of the load
    delay: float  # [s]


#: Stages of load shedding in every island. `shed` counts steps with a low frequency; once the stage has acted, it is
#: -1 - the step of that.
STAGES = Kind(
    name="shedding stages", rows={"shed": float}, constants={"stage": Shedding}, sees={"island": ISLANDS, "env": ENV}
)


def _added(two_h: float, omega: float, counts: bool, sums: Sums) -> Sums:
    inertia = select(counts, two_h, 0.0)
    return Sums(sums.momentum + inertia * (omega - 1.0), sums.inertia + inertia)


@system(MACHINES, "sums", "weight", "omega")
def add_machine(
    state: MachineState, inputs: MachineInput, committed: float, island: float, sums: Sums
) -> tuple[Sums, float, float]:
    """Add a machine to the sums of the grid; return its inertia and frequency, for those of other islands."""
    two_h, omega = committed * (inputs.connected / inputs.inv_two_h), state.speed
    return _added(two_h, omega, island == 0.0, sums), two_h, omega


@system(GROUPS, "sums", "weight", "omega")
def add_group(
    state: WtgState, inputs: WtgInput, output: WtgOutput, turbine: Turbine, share: float, island: float, sums: Sums
) -> tuple[Sums, float, float]:
    """Add a WTG group to the sums of the grid; return its inertia and frequency, for those of other islands."""
    two_h = turbine.converter.two_h * share * inputs.connected
    omega = wind_turbine.frequency_of(state, output)
    return _added(two_h, omega, island == 0.0, sums), two_h, omega


@system(units.MEMBERS, "island_sums")
def add_member(
    unit_weight: float, unit_omega: float, unit_island: float, island_number: float, island_sums: Sums
) -> Sums:
    """Add a unit to the sums of its island, if that is not the grid."""
    return _added(unit_weight, unit_omega, unit_island == island_number, island_sums)


@system(ISLANDS, "centre")
def centre_of_inertia(sums: Sums, centre: float) -> float:
    """Return the frequency of the centre of inertia; an island that has lost its last unit keeps it."""
    return select(sums.inertia > 0.0, 1.0 + sums.momentum / sums.inertia, centre)


@system(units.MAIN, "coi", "coi_min", "coi_max")
def centre_of_grid(centre: float, coi_min: float, coi_max: float) -> tuple[float, float, float]:
    """Return the frequency of the grid's centre of inertia, and its extremes."""
    return centre, min(coi_min, centre), max(coi_max, centre)


@system(GROUPS, "extremes")
def track_extremes(
    state: WtgState,
    inputs: WtgInput,
    output: WtgOutput,
    extremes: wind_turbine.WtgExtremes,
    turbine: Turbine,
    active: float,
    simulation_dt: float,
) -> wind_turbine.WtgExtremes:
    """Return a group's extremes; its power is that of the step's last stage, which lies at the step's end."""
    ratio = wind_turbine.tip_speed_ratio(state.rotor_speed, output.wind, turbine.rotor)
    turning = (active > 0.5) & (inputs.connected > 0.5)
    overloaded = turning & (output.power > turbine.converter.overload_limit)
    return wind_turbine.WtgExtremes(
        peak_power=select(turning, max(extremes.peak_power, output.power), extremes.peak_power),
        least_tsr=select(turning, min(extremes.least_tsr, ratio), extremes.least_tsr),
        largest_tsr=select(turning, max(extremes.largest_tsr, ratio), extremes.largest_tsr),
        overload_time=extremes.overload_time + select(overloaded, simulation_dt, 0.0),
    )


@system(ENV, "alarm", "was_low")
def reset_alarm(was_low: float) -> tuple[float, float]:
    """Check the stages of shedding once more after a low frequency."""
    return was_low, 0.0


@system(ISLANDS, "alarm", "was_low", when="sheds")
def alarm_island(centre: float, alarm: float, was_low: float, shedding_speed: float) -> tuple[float, float]:
    """Check the stages while the frequency of an island is below that of the first."""
    low = centre < shedding_speed
    return select(low, 1.0, alarm), select(low, 1.0, was_low)


@system(STAGES, "shed", "next_change")
def shed_load(
    shed: float, stage: Shedding, next_change: float, centre: float, step: float, active: float, simulation_dt: float
) -> tuple[float, float]:
    """Shed a stage whose delay has passed; the network changes before the next step."""
    waits = (shed >= 0.0) & (active > 0.5)
    count = select(centre >= stage.speed, 0.0, shed + 1.0)
    late = count * simulation_dt >= stage.delay - 1e-9
    acts = waits & late & (count > 0.0)
    return select(waits, select(acts, -1.0 - step, count), shed), select(acts, step, next_change)


@system(ENV, "shed_energy", when="extended")
def count_shed_energy(shed_energy: float, unserved: float, active: float, simulation_dt: float) -> float:
    return shed_energy + select(active > 0.5, unserved * simulation_dt, 0.0)


@system(MACHINES, "sample")
def sample_machine(state: MachineState, inputs: MachineInput, output: MachineOutput) -> Sample:
    """Return what is compared of a machine; its terminal is a bus of the network."""
    return Sample(state.angle, output.voltage * output.voltage, inputs.connected, 0.0)


@system(GROUPS, "sample")
def sample_group(
    state: WtgState, inputs: WtgInput, voltage: Phasor, current: Phasor, turbine: Turbine, share: float
) -> Sample:
    """Return what is compared of a WTG group; buses without a unit do not count."""
    reactance = turbine.converter.reactance / share
    v_re, v_im = voltage.re + reactance * current.im, voltage.im - reactance * current.re
    return Sample(state.converter.angle, v_re * v_re + v_im * v_im, inputs.connected, 0.0)


def _compared(sample: Sample, counts: bool, spread: Spread) -> Spread:
    counts = counts & (sample.there > 0.5)
    return Spread(
        min(spread.least_angle, select(counts, sample.turn, math.inf)),
        max(spread.largest_angle, select(counts, sample.turn, -math.inf)),
        min(spread.least_squared_voltage, select(counts, sample.squared_voltage, math.inf)),
    )


@system(UNITS, "grid_spread")
def compare_unit(sample: Sample, own_island: float, grid_spread: Spread) -> Spread:
    """Compare a unit with the others of the grid."""
    return _compared(sample, own_island == 0.0, grid_spread)


@system(units.MEMBERS, "island_spread")
def compare_member(unit_sample: Sample, unit_island: float, island_number: float, island_spread: Spread) -> Spread:
    """Compare a unit with the others of its island, if that is not the grid."""
    return _compared(unit_sample, unit_island == island_number, island_spread)


@system(ISLANDS, "violation", "healthy_step", "turned")
def judge_island(
    active: float,
    centre: float,
    step: float,
    spread: Spread,
    healthy_step: float,
    turned: float,
    simulation_dt: float,
    limits: wind_turbine.Limits,
) -> tuple[float, float, float]:
    """Find what an island violates.

    If several apply, the first in this order counts: not finite; where rotors end a run, under-speed, stall or
    over-speed of the last such group; loss of synchronism; voltage collapse; frequency limit. The others follow from
    it. An island without a unit has no voltage.
    """
    beyond = (centre < limits.frequency_min) | (centre > limits.frequency_max)
    violation = select(beyond, float(Status.FREQUENCY_LIMIT), 0.0)
    empty = spread.least_angle > spread.largest_angle
    healthy = spread.least_squared_voltage >= limits.low_voltage * limits.low_voltage
    healthy_step = select(active > 0.5, select(healthy, step, healthy_step), healthy_step)
    low = ((step - healthy_step) * simulation_dt > limits.low_voltage_time) | empty
    violation = select(low, float(Status.VOLTAGE_COLLAPSE), violation)
    apart = spread.largest_angle - spread.least_angle > limits.angle_spread
    turned = select(empty, turned, spread.least_angle)
    return select(apart, float(Status.LOSS_OF_SYNCHRONISM), violation), healthy_step, turned


@system(units.MAIN, "verdict")
def judge_grid(violation: float, centre: float) -> Verdict:
    """Return the verdict on the grid; those on groups are added to it."""
    return Verdict(violation, select(math.isfinite(centre), 1.0, 0.0))


@system(units.MEMBERS, "unit_sample_falls")
def fall_member(unit_sample_falls: float, unit_island: float, island_number: float, island_violation: float) -> float:
    """Mark the units of a failed island that is not the grid."""
    return select((unit_island == island_number) & (island_violation > 0.0), 1.0, unit_sample_falls)


@system(MACHINES, "connected", "next_change", when="extended")
def trip_machine(
    inputs: MachineInput, falls: float, next_change: float, step: float, active: float
) -> tuple[float, float]:
    """Disconnect a machine whose island has failed."""
    trips = (falls > 0.5) & (inputs.connected > 0.5) & (active > 0.5)
    return select(trips, 0.0, inputs.connected), select(trips, step, next_change)


@system(GROUPS, "connected", "verdict", "next_change", "trip_cause")
def judge_rotor(
    state: WtgState,
    inputs: WtgInput,
    output: WtgOutput,
    turbine: Turbine,
    verdict: Verdict,
    next_change: float,
    trip_cause: float,
    falls: float,
    step: float,
    active: float,
    trips_groups: bool,
) -> tuple[float, Verdict, float, float]:
    """Detect stall, over- and under-speed. Depending on `trips_groups` the group is disconnected or the run ends.

    A group is disconnected with its island too.
    """
    limits = turbine.limits
    ratio = wind_turbine.tip_speed_ratio(state.rotor_speed, output.wind, turbine.rotor)
    stalls = select(state.pitch.pitch < limits.stall_pitch, float(Status.STALL), 0.0)
    races = select(state.rotor_speed > limits.over_speed, float(Status.OVER_SPEED), 0.0)
    failure = select(ratio < limits.stall_tip_speed_ratio, stalls, races)
    failure = select(state.rotor_speed < limits.rotor_speed_min, float(Status.UNDER_SPEED), failure)
    failed = (failure > 0.0) & (inputs.connected > 0.5) & (active > 0.5)
    trips = (failed & trips_groups) | ((falls > 0.5) & (inputs.connected > 0.5) & (active > 0.5))
    is_finite = math.isfinite(state.rotor_speed) & math.isfinite(state.converter.speed)
    code = select(failed, select(trips_groups, verdict.code, failure), verdict.code)
    verdict = Verdict(code, select(is_finite, verdict.finite, 0.0))
    cause = select(failed & trips_groups, failure, float(units.TripCause.ISLAND_LOST))
    changes = select(trips, step, next_change), select(trips, cause, trip_cause)
    return select(trips, 0.0, inputs.connected), verdict, *changes


@system(ENV, "status", "active", "stops")
def end_run(status: float, active: float, verdict: Verdict) -> tuple[float, float, float]:
    """End a run that has failed."""
    violation = select(verdict.finite > 0.5, verdict.code, float(Status.NUMERICAL_FAILURE))
    stops = (active > 0.5) & (violation > 0.0)
    return select(stops, violation, status), select(stops, 0.0, active), select(stops, 1.0, 0.0)


@system(GROUPS, "wind_start", "wind_end")
def freeze_wind(wind_start: float, wind_end: float, output: WtgOutput, stops: float) -> tuple[float, float]:
    """Keep the wind constant in the rest of a control interval in which a run has ended."""
    still = stops > 0.5
    return select(still, output.wind, wind_start), select(still, output.wind, wind_end)
