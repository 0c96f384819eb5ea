"""Protections: extremes, angles and voltages are watched; a run ends, a group trips, or a load is shed."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from wtg_gym.physics.machine import MachineInput, MachineOutput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.units import ISLANDS, LANE, MAIN, MEMBERS, UNITS, Phasor, Sample
from wtg_gym.physics.wind_turbine import (
    Limits,
    Turbine,
    WtgExtremes,
    WtgInput,
    WtgOutput,
    WtgState,
    frequency_of,
    tip_speed_ratio,
)
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.elementary import select
from wtg_gym.systems.systems import Kind, system

#: Protections sample the grid at the end of every control interval, and at least this often within a longer one [s].
PROTECTION_INTERVAL_S = 0.1


class Status(IntEnum):
    """Why a lane has ended; a stall, an over-speed or an under-speed is the failure of a rotor."""

    RUNNING = 0
    STALL = 1
    OVER_SPEED = 2
    FREQUENCY_LIMIT = 3
    NUMERICAL_FAILURE = 4
    LOSS_OF_SYNCHRONISM = 5
    VOLTAGE_COLLAPSE = 6
    UNDER_SPEED = 7


class SheddingConstants(NamedTuple):
    """A stage of load shedding."""

    speed: float  # frequency of the centre of inertia at which it acts [p.u.]
    share: float  # of the load
    delay: float  # [s]


#: Stages of load shedding in every island. `shed` counts steps with a low frequency; once the stage has acted, it is
#: -1 - the step of that.
STAGES = Kind(
    name="shedding stages",
    rows={"shed": float},
    constants={"stage": SheddingConstants},
    sees={"island": ISLANDS, "lane": LANE},
)


# --- after every simulation step --------------------------------------------------------------------------------------


@system(ISLANDS, "momentum", "inertia")
def reset_inertia_sums() -> tuple[float, float]:
    """Begin the sums over all units."""
    return 0.0, 0.0


def _added(two_h: float, omega: float, counts: bool, momentum: float, inertia: float) -> tuple[float, float]:
    """Return the sums of an island with a unit that counts there."""
    own = select(counts, two_h, 0.0)
    return momentum + own * (omega - 1.0), inertia + own


@system(MACHINES, "momentum", "inertia", "weight", "omega")
def add_machine(
    state: MachineState, given: MachineInput, committed: float, island: float, momentum: float, inertia: float
) -> tuple[float, float, float, float]:
    """Add a machine to the sums of the grid; return its inertia and frequency, for those of other islands."""
    two_h, omega = committed * (given.connected / given.inv_two_h), state.speed
    return *_added(two_h, omega, island == 0.0, momentum, inertia), two_h, omega


@system(GROUPS, "momentum", "inertia", "weight", "omega")
def add_group(
    state: WtgState,
    given: WtgInput,
    output: WtgOutput,
    turbine: Turbine,
    share: float,
    island: float,
    momentum: float,
    inertia: float,
) -> tuple[float, float, float, float]:
    """Add a WTG group to the sums of the grid; return its inertia and frequency, for those of other islands."""
    two_h = turbine.converter.two_h * share * given.connected
    omega = frequency_of(state, output)
    return *_added(two_h, omega, island == 0.0, momentum, inertia), two_h, omega


@system(MEMBERS, "island_momentum", "island_inertia")
def add_member(
    unit_weight: float,
    unit_omega: float,
    unit_island: float,
    island_number: float,
    island_momentum: float,
    island_inertia: float,
) -> tuple[float, float]:
    """Add a unit to the sums of its island, if that is not the grid."""
    return _added(unit_weight, unit_omega, unit_island == island_number, island_momentum, island_inertia)


@system(ISLANDS, "centre")
def centre_of_inertia(momentum: float, inertia: float, centre: float) -> float:
    """Return the frequency of the centre of inertia; an island that has lost its last unit keeps it."""
    return select(inertia > 0.0, 1.0 + momentum / inertia, centre)


@system(MAIN, "coi", "coi_min", "coi_max")
def centre_of_grid(centre: float, coi_min: float, coi_max: float) -> tuple[float, float, float]:
    """Return the frequency of the grid's centre of inertia, and its extremes."""
    return centre, min(coi_min, centre), max(coi_max, centre)


@system(GROUPS, "extremes")
def track_extremes(
    state: WtgState,
    given: WtgInput,
    output: WtgOutput,
    extremes: WtgExtremes,
    turbine: Turbine,
    active: float,
    simulation_dt: float,
) -> WtgExtremes:
    """Return a group's extremes; its power is that of the step's last stage, which lies at the step's end."""
    ratio = tip_speed_ratio(state.rotor_speed, output.wind, turbine.rotor)
    turning = (active > 0.5) & (given.connected > 0.5)
    overloaded = turning & (output.power > turbine.converter.overload)
    return WtgExtremes(
        peak_power=select(turning, max(extremes.peak_power, output.power), extremes.peak_power),
        least_tsr=select(turning, min(extremes.least_tsr, ratio), extremes.least_tsr),
        largest_tsr=select(turning, max(extremes.largest_tsr, ratio), extremes.largest_tsr),
        overload_time=extremes.overload_time + select(overloaded, simulation_dt, 0.0),
    )


@system(LANE, "alarm", "was_low")
def reset_alarm(was_low: float) -> tuple[float, float]:
    """Look at the stages once more after a low frequency."""
    return was_low, 0.0


@system(ISLANDS, "alarm", "was_low", when="sheds")
def alarm_island(centre: float, alarm: float, was_low: float, shedding_speed: float) -> tuple[float, float]:
    """Look at the stages while the frequency of an island is below that of the first."""
    low = centre < shedding_speed
    return select(low, 1.0, alarm), select(low, 1.0, was_low)


@system(STAGES, "shed", "next_change")
def shed_load(
    shed: float,
    stage: SheddingConstants,
    next_change: float,
    centre: float,
    step: float,
    active: float,
    simulation_dt: float,
) -> tuple[float, float]:
    """Let a stage act whose time has come; the network changes before the next step."""
    waits = (shed >= 0.0) & (active > 0.5)
    count = select(centre >= stage.speed, 0.0, shed + 1.0)
    late = count * simulation_dt >= stage.delay - 1e-9
    acts = waits & late & (count > 0.0)
    return select(waits, select(acts, -1.0 - step, count), shed), select(acts, step, next_change)


@system(LANE, "shed_energy", when="extended")
def count_shed_energy(shed_energy: float, unserved: float, active: float, simulation_dt: float) -> float:
    """Count the load that is not served."""
    return shed_energy + select(active > 0.5, unserved * simulation_dt, 0.0)


# --- when the protections sample the grid -----------------------------------------------------------------------------


@system(ISLANDS, "least_angle", "largest_angle", "least_squared_voltage")
def reset_island_extremes() -> tuple[float, float, float]:
    """Begin to compare all connected units."""
    return math.inf, -math.inf, math.inf


@system(MACHINES, "sample")
def sample_machine(state: MachineState, given: MachineInput, output: MachineOutput) -> Sample:
    """Return what is compared of a machine; its terminal is a bus of the network."""
    return Sample(state.angle, output.voltage * output.voltage, given.connected, 0.0)


@system(GROUPS, "sample")
def sample_group(
    state: WtgState, given: WtgInput, voltage: Phasor, current: Phasor, turbine: Turbine, share: float
) -> Sample:
    """Return what is compared of a WTG group; buses without a unit do not count."""
    reactance = turbine.converter.reactance / share
    v_re, v_im = voltage.re + reactance * current.im, voltage.im - reactance * current.re
    return Sample(state.converter.angle, v_re * v_re + v_im * v_im, given.connected, 0.0)


def _compared(
    sample: Sample, counts: bool, least_angle: float, largest_angle: float, least_squared_voltage: float
) -> tuple[float, float, float]:
    """Return the extremes of an island with a unit that counts there."""
    counts = counts & (sample.there > 0.5)
    return (
        min(least_angle, select(counts, sample.turn, math.inf)),
        max(largest_angle, select(counts, sample.turn, -math.inf)),
        min(least_squared_voltage, select(counts, sample.squared_voltage, math.inf)),
    )


@system(UNITS, "grid_least_angle", "grid_largest_angle", "grid_least_squared_voltage")
def compare_unit(
    sample: Sample,
    own_island: float,
    grid_least_angle: float,
    grid_largest_angle: float,
    grid_least_squared_voltage: float,
) -> tuple[float, float, float]:
    """Compare a unit with the others of the grid."""
    return _compared(sample, own_island == 0.0, grid_least_angle, grid_largest_angle, grid_least_squared_voltage)


@system(MEMBERS, "island_least_angle", "island_largest_angle", "island_least_squared_voltage")
def compare_member(
    unit_sample: Sample,
    unit_island: float,
    island_number: float,
    island_least_angle: float,
    island_largest_angle: float,
    island_least_squared_voltage: float,
) -> tuple[float, float, float]:
    """Compare a unit with the others of its island, if that is not the grid."""
    counts = unit_island == island_number
    return _compared(unit_sample, counts, island_least_angle, island_largest_angle, island_least_squared_voltage)


@system(ISLANDS, "found", "healthy_step", "turned")
def judge_island(
    active: float,
    centre: float,
    step: float,
    least_angle: float,
    largest_angle: float,
    least_squared_voltage: float,
    healthy_step: float,
    turned: float,
    simulation_dt: float,
    limits: Limits,
) -> tuple[float, float, float]:
    """Say whether an island has failed.

    If several findings apply, the first in this order counts: not finite; where rotors end a run, under-speed, stall or
    over-speed of the last such group; loss of synchronism; voltage collapse; frequency limit. The others follow from
    it. An island without a unit has no voltage.
    """
    found = select((centre < limits.coi_min) | (centre > limits.coi_max), float(Status.FREQUENCY_LIMIT), 0.0)
    empty = least_angle > largest_angle
    healthy = least_squared_voltage >= limits.low_voltage * limits.low_voltage
    healthy_step = select(active > 0.5, select(healthy, step, healthy_step), healthy_step)
    low = ((step - healthy_step) * simulation_dt > limits.low_voltage_time) | empty
    found = select(low, float(Status.VOLTAGE_COLLAPSE), found)
    apart = largest_angle - least_angle > limits.angle_spread
    turned = select(empty, turned, least_angle)
    return select(apart, float(Status.LOSS_OF_SYNCHRONISM), found), healthy_step, turned


@system(MAIN, "finding", "finite")
def judge_grid(found: float, centre: float) -> tuple[float, float]:
    """Say whether the grid has failed."""
    return found, select(math.isfinite(centre), 1.0, 0.0)


@system(MEMBERS, "unit_sample_falls")
def fall_member(unit_sample_falls: float, unit_island: float, island_number: float, island_found: float) -> float:
    """Let the units of an island that is not the grid fall with it."""
    return select((unit_island == island_number) & (island_found > 0.0), 1.0, unit_sample_falls)


@system(MACHINES, "connected", "next_change", when="extended")
def trip_machine(
    given: MachineInput, falls: float, next_change: float, step: float, active: float
) -> tuple[float, float]:
    """Disconnect a machine whose island has failed."""
    trips = (falls > 0.5) & (given.connected > 0.5) & (active > 0.5)
    return select(trips, 0.0, given.connected), select(trips, step, next_change)


@system(GROUPS, "connected", "finding", "finite", "next_change")
def judge_rotor(
    state: WtgState,
    given: WtgInput,
    output: WtgOutput,
    turbine: Turbine,
    finding: float,
    finite: float,
    next_change: float,
    falls: float,
    step: float,
    active: float,
    trips_groups: bool,
) -> tuple[float, float, float, float]:
    """Detect stall, over- and under-speed. Depending on `trips_groups` the group is disconnected or the run ends.

    A group is disconnected with its island too.
    """
    limits = turbine.limits
    ratio = tip_speed_ratio(state.rotor_speed, output.wind, turbine.rotor)
    stalls = select(state.pitch.pitch < limits.stall_pitch, float(Status.STALL), 0.0)
    races = select(state.rotor_speed > limits.over_speed, float(Status.OVER_SPEED), 0.0)
    failure = select(ratio < limits.stall_tip_speed_ratio, stalls, races)
    failure = select(state.rotor_speed < limits.rotor_speed_min, float(Status.UNDER_SPEED), failure)
    failed = (failure > 0.0) & (given.connected > 0.5) & (active > 0.5)
    trips = (failed & trips_groups) | ((falls > 0.5) & (given.connected > 0.5) & (active > 0.5))
    is_finite = math.isfinite(state.rotor_speed) & math.isfinite(state.converter.speed)
    return (
        select(trips, 0.0, given.connected),
        select(failed, select(trips_groups, finding, failure), finding),
        select(is_finite, finite, 0.0),
        select(trips, step, next_change),
    )


@system(LANE, "status", "active", "stops")
def end_run(status: float, active: float, finding: float, finite: float) -> tuple[float, float, float]:
    """End a run that has failed."""
    finding = select(finite > 0.5, finding, float(Status.NUMERICAL_FAILURE))
    stops = (active > 0.5) & (finding > 0.0)
    return select(stops, finding, status), select(stops, 0.0, active), select(stops, 1.0, 0.0)


@system(GROUPS, "wind_start", "wind_end")
def freeze_wind(wind_start: float, wind_end: float, output: WtgOutput, stops: float) -> tuple[float, float]:
    """Let nothing be added in what is left of a control interval once a run has ended, no wind either."""
    still = stops > 0.5
    return select(still, output.wind, wind_start), select(still, output.wind, wind_end)
