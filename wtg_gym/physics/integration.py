"""Fixed-step integration of blocks: Runge-Kutta stages, limits, events, extremes and the end of a run."""

from __future__ import annotations

import math

import numpy as np

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.dynamics import derivatives
from wtg_gym.physics.elementary import fma
from wtg_gym.physics.layout import (
    N_SYNC_STATES,
    N_WTG_STATES,
    Floats,
    LaneData,
    LaneRow,
    Lanes,
    Plant,
    Status,
    SyncRow,
    WtgRow,
    lane_row,
    network_row,
)
from wtg_gym.physics.reduction import combine_load_noise, refresh_network
from wtg_gym.physics.synchronous_machine import MachineConstant, SyncState
from wtg_gym.physics.wind_turbine import TurbineConstant, WtgState

#: Protections look at the end of every control interval, and at least this often within a longer one [s].
PROTECTION_INTERVAL_S = 0.1


@inlined
def _stage(block: Floats, plant: Plant, ahead: float, first: bool, lanes: Lanes) -> None:
    """Add the rates of one of the first three stages to the sum and move the states `ahead` [s] from the base."""
    width = len(lanes)
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    for i in range(n_sync):
        _stage_rows(block, i * SyncRow.N_ROWS * width, N_SYNC_STATES, ahead, first, lanes)
    for j in range(n_wtg):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        _stage_rows(block, o, N_WTG_STATES, ahead, first, lanes)
    _stage_rows(block, lane_row(plant) * width, 1, ahead, first, lanes)


@inlined
def _stage_rows(block: Floats, o: int, n_states: int, ahead: float, first: bool, lanes: Lanes) -> None:
    # States, rates, base and sum of a record follow each other at the same distance. Unsigned indices, which cannot
    # count from the end, are what lets the compiler use vectors here.
    u, c = np.uint64(o), np.uint64(n_states * len(lanes))
    if first:
        for q in range(n_states * len(lanes)):
            r = u + np.uint64(q)
            value, rate = block[r], block[r + c]
            block[r + c + c] = value
            block[r + c + c + c] = rate
            block[r] = fma(ahead, rate, value)
    else:
        for q in range(n_states * len(lanes)):
            r = u + np.uint64(q)
            rate = block[r + c]
            block[r + c + c + c] = fma(2.0, rate, block[r + c + c + c])
            block[r] = fma(ahead, rate, block[r + c + c])


@inlined
def _finish_rows(
    block: Floats, o: int, n_states: int, sixth: float, active: int, all_active: bool, lanes: Lanes
) -> None:
    """Move a record's states from the base along the sum of all four stages, the last one's rates included."""
    width = len(lanes)
    u, c = np.uint64(o), np.uint64(n_states * width)
    if all_active:
        for q in range(n_states * width):
            r = u + np.uint64(q)
            block[r] = fma(sixth, block[r + c + c + c] + block[r + c], block[r + c + c])
        return
    # An ended lane keeps its base exactly: nothing, not even a rounding, is added to it.
    count = n_states * width
    for at in range(o, o + count, width):
        for x in range(width):
            base = block[at + 2 * count + x]
            moved = fma(sixth, block[at + 3 * count + x] + block[at + count + x], base)
            block[at + x] = moved if block[active + x] > 0.5 else base


@inlined
def runge_kutta_step(block: Floats, plant: Plant, step: int, lanes: Lanes) -> None:
    """Advance a block by one simulation step with the classical fourth-order method.

    Args:
        block, plant, lanes: as for :func:`derivatives`.
        step: number of the step within the control interval, for the wind's interpolation.
    """
    width = len(lanes)
    n_sync, n_wtg = len(plant.syncs), len(plant.wtgs)
    h = plant.simulation_dt
    part = 1.0 / plant.n_substeps
    for stage in range(4):
        offset = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        derivatives(block, plant, (step + offset) * part, lanes)
        if stage < 3:
            _stage(block, plant, 0.5 * h if stage < 2 else h, stage == 0, lanes)
    active = (lane_row(plant) + LaneRow.ACTIVE) * width
    all_active = True
    for x in range(width):
        all_active = all_active and block[active + x] > 0.5
    for i in range(n_sync):
        o = i * SyncRow.N_ROWS * width
        _finish_rows(block, o, N_SYNC_STATES, h / 6.0, active, all_active, lanes)
        field_min = plant.machines[i, MachineConstant.FIELD_MIN]
        field_max = plant.machines[i, MachineConstant.FIELD_MAX]
        gate_min = plant.machines[i, MachineConstant.GATE_MIN]
        gate_max = plant.machines[i, MachineConstant.GATE_MAX]
        _clip_row(block, o + SyncState.FIELD_VOLTAGE * width, field_min, field_max, width)
        _clip_row(block, o + SyncState.GATE * width, gate_min, gate_max, width)
    for j in range(n_wtg):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        _finish_rows(block, o, N_WTG_STATES, h / 6.0, active, all_active, lanes)
        pitch_max = plant.turbine[TurbineConstant.PITCH_MAX]
        _clip_row(block, o + WtgState.PITCH_INTEGRAL * width, 0.0, pitch_max, width)
        _clip_row(block, o + WtgState.PITCH * width, 0.0, pitch_max, width)
    _finish_rows(block, lane_row(plant) * width, 1, h / 6.0, active, all_active, lanes)


@inlined
def _clip_row(block: Floats, o: int, low: float, high: float, width: int) -> None:
    for x in range(width):
        block[o + x] = min(max(block[o + x], low), high)


@inlined
def track_extremes(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """Update the frequency of the centre of inertia and the extremes of running lanes after a simulation step."""
    width = len(lanes)
    n_sync = len(plant.syncs)
    lane = lane_row(plant) * width
    tip_speed = plant.turbine[TurbineConstant.TIP_SPEED]
    overload = plant.turbine[TurbineConstant.OVERLOAD]
    two_h_wtg = plant.turbine[TurbineConstant.TWO_H]
    for x in range(width):
        momentum, inertia = 0.0, 0.0
        for i in range(n_sync):
            o = i * SyncRow.N_ROWS * width
            two_h = 1.0 / block[o + SyncRow.INV_TWO_H * width + x]
            momentum += two_h * (block[o + SyncState.SPEED * width + x] - 1.0)
            inertia += two_h
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
            two_h = two_h_wtg * plant.share[j] * block[o + WtgRow.CONNECTED * width + x]
            momentum += two_h * (block[o + WtgState.SPEED * width + x] - 1.0)
            inertia += two_h
        coi = 1.0 + momentum / inertia
        running = block[lane + LaneRow.ACTIVE * width + x] > 0.5
        lowest, highest = block[lane + LaneRow.COI_MIN * width + x], block[lane + LaneRow.COI_MAX * width + x]
        block[lane + LaneRow.COI * width + x] = coi
        block[lane + LaneRow.COI_MIN * width + x] = min(lowest, coi)
        block[lane + LaneRow.COI_MAX * width + x] = max(highest, coi)
        block[lane + LaneRow.STEP * width + x] += 1.0 if running else 0.0
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
            # The row holds the power of the step's last stage, which lies at the step's end.
            power = block[o + WtgRow.POWER * width + x]
            ratio = tip_speed * block[o + WtgState.ROTOR_SPEED * width + x] / block[o + WtgRow.WIND * width + x]
            peak = block[o + WtgRow.PEAK_POWER * width + x]
            least = block[o + WtgRow.LEAST_TSR * width + x]
            largest = block[o + WtgRow.LARGEST_TSR * width + x]
            turning = running and block[o + WtgRow.CONNECTED * width + x] > 0.5
            block[o + WtgRow.PEAK_POWER * width + x] = max(peak, power) if turning else peak
            block[o + WtgRow.LEAST_TSR * width + x] = min(least, ratio) if turning else least
            block[o + WtgRow.LARGEST_TSR * width + x] = max(largest, ratio) if turning else largest
            block[o + WtgRow.OVERLOAD_TIME * width + x] += plant.simulation_dt if turning and power > overload else 0.0


@inlined
def enter_interval(block: Floats, first_lane: int, plant: Plant, data: LaneData, noise_y: Floats, lanes: Lanes) -> None:
    """Put wind and load noise of the control interval that begins into force, for every lane of a block.

    `first_lane` is the row of the block's first lane in `data`; `noise_y` (width) takes the noise's admittance [p.u.].
    """
    width = len(lanes)
    n_sync = len(plant.syncs)
    own = lane_row(plant) * width
    last = data.wind.shape[2] - 1
    for x in range(width):
        index = int(block[own + LaneRow.STEP * width + x]) // plant.n_substeps
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
            block[o + WtgRow.WIND_START * width + x] = data.wind[first_lane + x, j, min(index, last)]
            block[o + WtgRow.WIND_END * width + x] = data.wind[first_lane + x, j, min(index + 1, last)]
        noise = data.noise[first_lane + x, min(index, data.noise.shape[1] - 1)]
        noise_y[x] = noise * block[own + LaneRow.NOISE_PER_MW * width + x]
    combine_load_noise(block, plant, noise_y, lanes)


@inlined
def apply_network_changes(
    block: Floats, first_lane: int, plant: Plant, data: LaneData, noise_y: Floats, lanes: Lanes
) -> None:
    """Let the events that are due at the present step change the networks of a block's lanes."""
    width = len(lanes)
    own = lane_row(plant) * width
    changed = False
    for x in range(width):
        if block[own + LaneRow.STEP * width + x] >= block[own + LaneRow.NEXT_CHANGE * width + x]:
            refresh_network(block, x, first_lane + x, plant, data, width)
            changed = True
    if changed:
        # For the whole block: a lane without a change gets the same bits again.
        combine_load_noise(block, plant, noise_y, lanes)


@inlined
def advance_interval(
    block: Floats, first_lane: int, plant: Plant, data: LaneData, noise_y: Floats, lanes: Lanes
) -> None:
    """Advance every running lane of a block by one control interval.

    The control inputs (K_OFFSET, INV_TAU) are rows of the block and hold over the interval. On return the rows hold
    powers, coefficients and rates at the interval's end; `noise_y` (width) is scratch.
    """
    enter_interval(block, first_lane, plant, data, noise_y, lanes)
    between_looks = max(1, int(PROTECTION_INTERVAL_S / plant.simulation_dt + 1e-6))
    for step in range(plant.n_substeps):
        apply_network_changes(block, first_lane, plant, data, noise_y, lanes)
        runge_kutta_step(block, plant, step, lanes)
        track_extremes(block, plant, lanes)
        if (step + 1) % between_looks == 0 or step + 1 == plant.n_substeps:
            look_at_grid(block, plant, lanes)
            update_status(block, plant, len(lanes))
    derivatives(block, plant, 1.0, lanes)


@inlined
def look_at_grid(block: Floats, plant: Plant, lanes: Lanes) -> None:
    """Find how far the angles of connected units lie apart and the lowest of their terminal voltages, in every lane.

    A condenser's or turbine's terminal is a bus of the network; buses without a unit are not looked at.
    """
    width = len(lanes)
    n_sync, n = len(plant.syncs), len(plant.syncs) + len(plant.wtgs)
    lane = lane_row(plant) * width
    least_angle, largest_angle = lane + LaneRow.LEAST_ANGLE * width, lane + LaneRow.LARGEST_ANGLE * width
    least_voltage = lane + LaneRow.LEAST_VOLTAGE * width
    for x in range(width):
        block[least_angle + x] = block[largest_angle + x] = 0.0
        block[least_voltage + x] = math.inf
    for i in range(n_sync):
        o = i * SyncRow.N_ROWS * width
        for x in range(width):
            angle, voltage = block[o + SyncState.ANGLE * width + x], block[o + SyncRow.VOLTAGE * width + x]
            block[least_angle + x] = min(block[least_angle + x], angle)
            block[largest_angle + x] = max(block[largest_angle + x], angle)
            block[least_voltage + x] = min(block[least_voltage + x], voltage * voltage)
    e_re = network_row(plant) * width
    e_im, i_re, i_im = e_re + n * width, e_re + 2 * n * width, e_re + 3 * n * width
    for j in range(len(plant.wtgs)):
        o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width
        at = (n_sync + j) * width
        reactance = plant.turbine[TurbineConstant.REACTANCE] / plant.share[j]
        for x in range(width):
            connected = block[o + WtgRow.CONNECTED * width + x] > 0.5
            angle = block[o + WtgState.ANGLE * width + x] if connected else 0.0
            v_re = block[e_re + at + x] + reactance * block[i_im + at + x]
            v_im = block[e_im + at + x] - reactance * block[i_re + at + x]
            voltage = v_re * v_re + v_im * v_im if connected else math.inf
            block[least_angle + x] = min(block[least_angle + x], angle)
            block[largest_angle + x] = max(block[largest_angle + x], angle)
            block[least_voltage + x] = min(block[least_voltage + x], voltage)


@inlined
def update_status(block: Floats, plant: Plant, width: int) -> None:
    """End lanes that a protection ends or that are no longer finite; or trip groups that stalled or over-sped.

    What is worse counts: a stall or an over-speed goes before the grid's failures, lost synchronism before a low
    voltage, and that before the frequency, which all of them drag along.
    """
    n_sync = len(plant.syncs)
    own = lane_row(plant) * width
    t = plant.turbine
    for x in range(width):
        if block[own + LaneRow.ACTIVE * width + x] < 0.5:
            continue
        coi = block[own + LaneRow.COI * width + x]
        status = 0
        if coi < t[TurbineConstant.COI_MIN] or coi > t[TurbineConstant.COI_MAX]:
            status = Status.FREQUENCY_LIMIT
        step = block[own + LaneRow.STEP * width + x]
        if block[own + LaneRow.LEAST_VOLTAGE * width + x] >= t[TurbineConstant.LOW_VOLTAGE] ** 2:
            block[own + LaneRow.HEALTHY_STEP * width + x] = step
        low_steps = step - block[own + LaneRow.HEALTHY_STEP * width + x]
        if low_steps * plant.simulation_dt > t[TurbineConstant.LOW_VOLTAGE_TIME]:
            status = Status.VOLTAGE_COLLAPSE
        spread = block[own + LaneRow.LARGEST_ANGLE * width + x] - block[own + LaneRow.LEAST_ANGLE * width + x]
        if spread > t[TurbineConstant.ANGLE_SPREAD]:
            status = Status.LOSS_OF_SYNCHRONISM
        total = coi
        for j in range(len(plant.wtgs)):
            o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width + x
            rotor = block[o + WtgState.ROTOR_SPEED * width]
            ratio = t[TurbineConstant.TIP_SPEED] * rotor / block[o + WtgRow.WIND * width]
            total += rotor + block[o + WtgState.SPEED * width]
            failure = 0
            if ratio < t[TurbineConstant.STALL_TIP_SPEED_RATIO]:
                if block[o + WtgState.PITCH * width] < t[TurbineConstant.STALL_PITCH]:
                    failure = Status.STALL
            elif rotor > t[TurbineConstant.OVER_SPEED]:
                failure = Status.OVER_SPEED
            if failure != 0 and block[o + WtgRow.CONNECTED * width] > 0.5:
                if plant.trips_groups:
                    block[o + WtgRow.CONNECTED * width] = 0.0
                    block[own + LaneRow.NEXT_CHANGE * width + x] = block[own + LaneRow.STEP * width + x]
                else:
                    status = failure
        if not math.isfinite(total):
            status = Status.NUMERICAL_FAILURE
        if status != 0:
            block[own + LaneRow.STATUS * width + x] = status
            block[own + LaneRow.ACTIVE * width + x] = 0.0
            for j in range(len(plant.wtgs)):
                # What is left of the control interval adds nothing, no wind either.
                o = (n_sync * SyncRow.N_ROWS + j * WtgRow.N_ROWS) * width + x
                wind = block[o + WtgRow.WIND * width]
                block[o + WtgRow.WIND_START * width] = block[o + WtgRow.WIND_END * width] = wind


@compiled
def advance_blocks(blocks: Floats, first: int, last: int, plant: Plant, data: LaneData, lanes: Lanes) -> None:
    """Advance the blocks first … last - 1 of `blocks` (n_blocks, n_rows · width) by one control interval."""
    noise_y = np.empty(len(lanes))
    for b in range(first, last):
        advance_interval(blocks[b], b * len(lanes), plant, data, noise_y, lanes)
