"""Protections: extremes, angles and voltages are watched; a run ends, a group trips, or a load is shed."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any

from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.elementary import select
from wtg_gym.physics.layout import (
    LANE,
    MACHINE,
    N_EXTREMES,
    N_MACHINE_ROWS,
    WTG,
    Floats,
    Lanes,
    load_extremes,
    load_machine_input,
    load_machine_output,
    load_machine_state,
    load_phasor,
    load_wtg_input,
    load_wtg_output,
    load_wtg_state,
    read_turbine,
    rows_of,
    store_extremes,
    store_wtg_input,
    wtg_row,
)
from wtg_gym.physics.wind_turbine import WtgExtremes, WtgInput, tip_speed_ratio

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


@inlined
def track_extremes(block: Floats, c: Any, lanes: Lanes) -> None:
    """Update the frequency of the centre of inertia and the extremes of running lanes after a simulation step."""
    width, rows = len(lanes), rows_of(c)
    n_sync, n_wtg = c["machines"].shape[0], c["share"].shape[0]
    turbine = read_turbine(c["turbine"])
    lane = rows.lane * width
    for x in range(width):
        momentum, inertia = 0.0, 0.0
        for i in range(n_sync):
            o = i * N_MACHINE_ROWS * width + x
            given = load_machine_input(block, o + MACHINE.input * width, width)
            two_h = given.connected / given.inv_two_h
            momentum += two_h * (load_machine_state(block, o, width).speed - 1.0)
            inertia += two_h
        for j in range(n_wtg):
            o = wtg_row(c, j) * width + x
            connected = load_wtg_input(block, o + WTG.input * width, width).connected
            two_h = turbine.converter.two_h * c["share"][j] * connected
            momentum += two_h * (load_wtg_state(block, o, width).converter.speed - 1.0)
            inertia += two_h
        coi = 1.0 + momentum / inertia
        block[lane + LANE.coi * width + x] = coi
        block[lane + LANE.coi_min * width + x] = min(block[lane + LANE.coi_min * width + x], coi)
        block[lane + LANE.coi_max * width + x] = max(block[lane + LANE.coi_max * width + x], coi)
    for j in range(n_wtg):
        o, extremes = wtg_row(c, j) * width, (rows.extremes + j * N_EXTREMES) * width
        for x in range(width):
            # The power is that of the step's last stage, which lies at the step's end.
            output = load_wtg_output(block, o + WTG.output * width + x, width)
            connected = load_wtg_input(block, o + WTG.input * width + x, width).connected
            rotor_speed = load_wtg_state(block, o + x, width).rotor_speed
            ratio = tip_speed_ratio(rotor_speed, output.wind, turbine.rotor)
            turning = (block[lane + LANE.active * width + x] > 0.5) & (connected > 0.5)
            old = load_extremes(block, extremes + x, width)
            overloaded = turning & (output.power > turbine.converter.overload)
            new = WtgExtremes(
                peak_power=select(turning, max(old.peak_power, output.power), old.peak_power),
                least_tsr=select(turning, min(old.least_tsr, ratio), old.least_tsr),
                largest_tsr=select(turning, max(old.largest_tsr, ratio), old.largest_tsr),
                overload_time=old.overload_time + select(overloaded, c["simulation_dt"], 0.0),
            )
            store_extremes(new, block, extremes + x, width)


@inlined
def sample_grid(block: Floats, c: Any, lanes: Lanes) -> None:
    """Find how far the angles of connected units lie apart and the lowest of their terminal voltages, in every lane.

    A condenser's or turbine's terminal is a bus of the network; buses without a unit do not count.
    """
    width, rows = len(lanes), rows_of(c)
    n_sync = c["machines"].shape[0]
    turbine = read_turbine(c["turbine"])
    least_angle, largest_angle = (rows.lane + LANE.least_angle) * width, (rows.lane + LANE.largest_angle) * width
    least_squared_voltage = (rows.lane + LANE.least_squared_voltage) * width
    for x in range(width):
        block[least_angle + x], block[largest_angle + x] = math.inf, -math.inf
        block[least_squared_voltage + x] = math.inf
    for i in range(n_sync):
        o = i * N_MACHINE_ROWS * width
        for x in range(width):
            connected = load_machine_input(block, o + MACHINE.input * width + x, width).connected > 0.5
            angle = load_machine_state(block, o + x, width).angle
            voltage = load_machine_output(block, o + MACHINE.output * width + x, width).voltage
            block[least_angle + x] = min(block[least_angle + x], select(connected, angle, math.inf))
            block[largest_angle + x] = max(block[largest_angle + x], select(connected, angle, -math.inf))
            block[least_squared_voltage + x] = min(
                block[least_squared_voltage + x], select(connected, voltage * voltage, math.inf)
            )
    for j in range(c["share"].shape[0]):
        o, unit = wtg_row(c, j) * width, 2 * (n_sync + j)
        reactance = turbine.converter.reactance / c["share"][j]
        for x in range(width):
            e = load_phasor(block, (rows.voltage + unit) * width + x, width)
            current = load_phasor(block, (rows.current + unit) * width + x, width)
            connected = load_wtg_input(block, o + WTG.input * width + x, width).connected > 0.5
            v_re, v_im = e.re + reactance * current.im, e.im - reactance * current.re
            angle = load_wtg_state(block, o + x, width).converter.angle
            voltage = select(connected, v_re * v_re + v_im * v_im, math.inf)
            block[least_angle + x] = min(block[least_angle + x], select(connected, angle, math.inf))
            block[largest_angle + x] = max(block[largest_angle + x], select(connected, angle, -math.inf))
            block[least_squared_voltage + x] = min(block[least_squared_voltage + x], voltage)


@inlined
def shed_load(block: Floats, c: Any, lanes: Lanes) -> None:
    """Let the stages of load shedding act whose time has come; the network changes before the next step.

    The row of a stage holds the last step without a low frequency; once the stage has acted, -1 - the step of that.
    """
    width, rows = len(lanes), rows_of(c)
    for k in range(c["shedding"].shape[0]):
        stage = c["shedding"][k]
        for x in range(width):
            at, lane = (rows.shedding + k) * width + x, rows.lane * width + x
            step = block[lane + LANE.step * width]
            if block[at] >= 0.0 and block[lane + LANE.active * width] > 0.5:
                if block[lane + LANE.coi * width] >= stage["speed"]:
                    block[at] = step
                elif (step - block[at]) * c["simulation_dt"] >= stage["delay"] - 1e-9:
                    block[at] = -1.0 - step
                    block[lane + LANE.next_change * width] = step


@inlined
def update_status(block: Floats, c: Any, width: int) -> None:
    """End lanes that a protection ends or that are no longer finite, or trip groups for their rotor's speed.

    If several apply, the first in this order counts: not finite; under-speed, stall or over-speed of the last such
    group; loss of synchronism; voltage collapse; frequency limit. The others follow from it.
    """
    rows = rows_of(c)
    turbine = read_turbine(c["turbine"])
    limits = turbine.limits
    for x in range(width):
        lane = rows.lane * width + x
        if block[lane + LANE.active * width] < 0.5:
            continue
        coi, step = block[lane + LANE.coi * width], block[lane + LANE.step * width]
        status = 0
        if coi < limits.coi_min or coi > limits.coi_max:
            status = Status.FREQUENCY_LIMIT
        if block[lane + LANE.least_squared_voltage * width] >= limits.low_voltage**2:
            block[lane + LANE.healthy_step * width] = step
        low_steps = step - block[lane + LANE.healthy_step * width]
        if low_steps * c["simulation_dt"] > limits.low_voltage_time:
            status = Status.VOLTAGE_COLLAPSE
        spread = block[lane + LANE.largest_angle * width] - block[lane + LANE.least_angle * width]
        if spread > limits.angle_spread:
            status = Status.LOSS_OF_SYNCHRONISM
        finite = math.isfinite(coi)
        for j in range(c["share"].shape[0]):
            o = wtg_row(c, j) * width + x
            state = load_wtg_state(block, o, width)
            given = load_wtg_input(block, o + WTG.input * width, width)
            wind = load_wtg_output(block, o + WTG.output * width, width).wind
            ratio = tip_speed_ratio(state.rotor_speed, wind, turbine.rotor)
            finite = finite and math.isfinite(state.rotor_speed) and math.isfinite(state.converter.speed)
            failure = 0
            if ratio < limits.stall_tip_speed_ratio:
                if state.pitch.pitch < limits.stall_pitch:
                    failure = Status.STALL
            elif state.rotor_speed > limits.over_speed:
                failure = Status.OVER_SPEED
            if state.rotor_speed < limits.rotor_speed_min:
                failure = Status.UNDER_SPEED
            if failure != 0 and given.connected > 0.5:
                if c["trips_groups"]:
                    tripped = WtgInput(given.emf, given.law, 0.0, given.wind_start, given.wind_end)
                    store_wtg_input(tripped, block, o + WTG.input * width, width)
                    block[lane + LANE.next_change * width] = step
                else:
                    status = failure
        if not finite:
            status = Status.NUMERICAL_FAILURE
        if status != 0:
            block[lane + LANE.status * width] = status
            block[lane + LANE.active * width] = 0.0
            for j in range(c["share"].shape[0]):
                # What is left of the control interval adds nothing, no wind either.
                o = wtg_row(c, j) * width + x
                wind = load_wtg_output(block, o + WTG.output * width, width).wind
                given = load_wtg_input(block, o + WTG.input * width, width)
                still = WtgInput(given.emf, given.law, given.connected, wind, wind)
                store_wtg_input(still, block, o + WTG.input * width, width)
