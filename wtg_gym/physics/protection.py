"""Protections: extremes, angles and voltages are watched; a run ends, a group trips, or a load is shed."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from wtg_gym.physics.machine import MachineInput, MachineOutput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.units import LANE, Phasor
from wtg_gym.physics.wind_turbine import (
    Limits,
    Turbine,
    WtgExtremes,
    WtgInput,
    WtgOutput,
    WtgState,
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


#: Stages of load shedding. `shed` is the last step without a low frequency; once the stage has acted, -1 - the step of
#: that.
STAGES = Kind(name="shedding stages", rows={"shed": float}, constants={"stage": SheddingConstants}, sees={"lane": LANE})


# --- after every simulation step --------------------------------------------------------------------------------------


@system(LANE, "momentum", "inertia")
def begin_coi() -> tuple[float, float]:
    """Begin the sums over all units."""
    return 0.0, 0.0


@system(MACHINES, "momentum", "inertia")
def add_machine(state: MachineState, given: MachineInput, momentum: float, inertia: float) -> tuple[float, float]:
    """Add a machine to the sums."""
    two_h = given.connected / given.inv_two_h
    return momentum + two_h * (state.speed - 1.0), inertia + two_h


@system(GROUPS, "momentum", "inertia")
def add_group(
    state: WtgState, given: WtgInput, turbine: Turbine, share: float, momentum: float, inertia: float
) -> tuple[float, float]:
    """Add a WTG group to the sums."""
    two_h = turbine.converter.two_h * share * given.connected
    return momentum + two_h * (state.converter.speed - 1.0), inertia + two_h


@system(LANE, "coi", "coi_min", "coi_max")
def centre_of_inertia(momentum: float, inertia: float, coi_min: float, coi_max: float) -> tuple[float, float, float]:
    """Return the frequency of the centre of inertia, and its extremes."""
    coi = 1.0 + momentum / inertia
    return coi, min(coi_min, coi), max(coi_max, coi)


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


@system(STAGES, "shed", "next_change")
def shed_load(
    shed: float,
    stage: SheddingConstants,
    next_change: float,
    coi: float,
    step: float,
    active: float,
    simulation_dt: float,
) -> tuple[float, float]:
    """Let a stage act whose time has come; the network changes before the next step."""
    waits = (shed >= 0.0) & (active > 0.5)
    healthy = coi >= stage.speed
    late = (step - shed) * simulation_dt >= stage.delay - 1e-9
    kept = select(waits, select(healthy, step, select(late, -1.0 - step, shed)), shed)
    change = select(waits, select(healthy, next_change, select(late, step, next_change)), next_change)
    return kept, change


# --- when the protections sample the grid -----------------------------------------------------------------------------


@system(LANE, "least_angle", "largest_angle", "least_squared_voltage")
def begin_sample() -> tuple[float, float, float]:
    """Begin to compare all connected units."""
    return math.inf, -math.inf, math.inf


@system(MACHINES, "least_angle", "largest_angle", "least_squared_voltage")
def sample_machine(
    state: MachineState,
    given: MachineInput,
    output: MachineOutput,
    least_angle: float,
    largest_angle: float,
    least_squared_voltage: float,
) -> tuple[float, float, float]:
    """Compare a machine; its terminal is a bus of the network."""
    connected = given.connected > 0.5
    return (
        min(least_angle, select(connected, state.angle, math.inf)),
        max(largest_angle, select(connected, state.angle, -math.inf)),
        min(least_squared_voltage, select(connected, output.voltage * output.voltage, math.inf)),
    )


@system(GROUPS, "least_angle", "largest_angle", "least_squared_voltage")
def sample_group(
    state: WtgState,
    given: WtgInput,
    voltage: Phasor,
    current: Phasor,
    turbine: Turbine,
    share: float,
    least_angle: float,
    largest_angle: float,
    least_squared_voltage: float,
) -> tuple[float, float, float]:
    """Compare a WTG group; buses without a unit do not count."""
    connected = given.connected > 0.5
    reactance = turbine.converter.reactance / share
    v_re, v_im = voltage.re + reactance * current.im, voltage.im - reactance * current.re
    return (
        min(least_angle, select(connected, state.converter.angle, math.inf)),
        max(largest_angle, select(connected, state.converter.angle, -math.inf)),
        min(least_squared_voltage, select(connected, v_re * v_re + v_im * v_im, math.inf)),
    )


@system(LANE, "finding", "finite", "healthy_step")
def judge_grid(
    active: float,
    coi: float,
    step: float,
    least_angle: float,
    largest_angle: float,
    least_squared_voltage: float,
    healthy_step: float,
    simulation_dt: float,
    limits: Limits,
) -> tuple[float, float, float]:
    """Say whether the grid has failed.

    If several findings apply, the first in this order counts: not finite; under-speed, stall or over-speed of the last
    such group; loss of synchronism; voltage collapse; frequency limit. The others follow from it.
    """
    finding = select((coi < limits.coi_min) | (coi > limits.coi_max), float(Status.FREQUENCY_LIMIT), 0.0)
    healthy = least_squared_voltage >= limits.low_voltage * limits.low_voltage
    healthy_step = select(active > 0.5, select(healthy, step, healthy_step), healthy_step)
    low = (step - healthy_step) * simulation_dt > limits.low_voltage_time
    finding = select(low, float(Status.VOLTAGE_COLLAPSE), finding)
    apart = largest_angle - least_angle > limits.angle_spread
    finding = select(apart, float(Status.LOSS_OF_SYNCHRONISM), finding)
    return finding, select(math.isfinite(coi), 1.0, 0.0), healthy_step


@system(GROUPS, "connected", "finding", "finite", "next_change")
def judge_rotor(
    state: WtgState,
    given: WtgInput,
    output: WtgOutput,
    turbine: Turbine,
    finding: float,
    finite: float,
    next_change: float,
    step: float,
    active: float,
    trips_groups: bool,
) -> tuple[float, float, float, float]:
    """Say whether a rotor has failed; its group trips, or the run has failed with it."""
    limits = turbine.limits
    ratio = tip_speed_ratio(state.rotor_speed, output.wind, turbine.rotor)
    stalls = select(state.pitch.pitch < limits.stall_pitch, float(Status.STALL), 0.0)
    races = select(state.rotor_speed > limits.over_speed, float(Status.OVER_SPEED), 0.0)
    failure = select(ratio < limits.stall_tip_speed_ratio, stalls, races)
    failure = select(state.rotor_speed < limits.rotor_speed_min, float(Status.UNDER_SPEED), failure)
    failed = (failure > 0.0) & (given.connected > 0.5) & (active > 0.5)
    trips = failed & trips_groups
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
def still_wind(wind_start: float, wind_end: float, output: WtgOutput, stops: float) -> tuple[float, float]:
    """Let nothing be added in what is left of a control interval once a run has ended, no wind either."""
    still = stops > 0.5
    return select(still, output.wind, wind_start), select(still, output.wind, wind_end)
