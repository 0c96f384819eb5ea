"""One control interval of a block: read wind and load noise, apply events, integrate, check the protections."""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.dynamics import advance_step, derivatives
from wtg_gym.physics.elementary import select
from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import LANE, WTG, Floats, Lanes, load_wtg_input, rows_of, store_wtg_input, wtg_row
from wtg_gym.physics.protection import PROTECTION_INTERVAL_S, sample_grid, shed_load, track_extremes, update_status
from wtg_gym.physics.reduction import combine_load_noise, refresh_network
from wtg_gym.physics.wind_turbine import WtgInput


@inlined
def enter_interval(block: Floats, first_lane: int, c: Any, data: LaneData, noise_y: Floats, lanes: Lanes) -> None:
    """Read wind and load noise of the control interval that begins, for every lane of a block.

    `first_lane` is the row of the block's first lane in `data`; `noise_y` (width) takes the noise's admittance [p.u.].
    """
    width, rows = len(lanes), rows_of(c)
    last = data.wind.shape[2] - 1
    for x in range(width):
        lane = rows.lane * width + x
        index = int(block[lane + LANE.step * width]) // c["n_substeps"]
        for j in range(c["share"].shape[0]):
            at = (wtg_row(c, j) + WTG.input) * width + x
            given = load_wtg_input(block, at, width)
            start = data.wind[first_lane + x, j, min(index, last)]
            end = data.wind[first_lane + x, j, min(index + 1, last)]
            store_wtg_input(WtgInput(given.emf, given.law, given.connected, start, end), block, at, width)
        noise = data.noise[first_lane + x, min(index, data.noise.shape[1] - 1)]
        noise_y[x] = noise * block[lane + LANE.noise_per_mw * width]
    combine_load_noise(block, c, noise_y, lanes)


@inlined
def changes_due(block: Floats, c: Any, lanes: Lanes) -> np.bool_:
    """Return whether events that are due at the present step change the network of any of a block's lanes."""
    width, lane = len(lanes), rows_of(c).lane * len(lanes)
    due = np.int64(0)
    for x in range(width):
        due += np.int64(block[lane + LANE.step * width + x] >= block[lane + LANE.next_change * width + x])
    return due > 0


@inlined
def apply_network_changes(
    block: Floats, first_lane: int, plant: Plant, data: LaneData, noise_y: Floats, lanes: Lanes
) -> None:
    """Let the events that are due at the present step change the networks of a block's lanes."""
    c = plant.constants[0]
    width, rows = len(lanes), rows_of(c)
    changed = False
    for x in range(width):
        lane = rows.lane * width + x
        if block[lane + LANE.step * width] >= block[lane + LANE.next_change * width]:
            refresh_network(block, x, first_lane + x, plant, data, width)
            changed = True
    if changed:
        # For the whole block: a lane without a change gets the same bits again.
        combine_load_noise(block, c, noise_y, lanes)


@inlined
def _count_step(block: Floats, c: Any, lanes: Lanes) -> None:
    """Count a simulation step of every running lane."""
    width = len(lanes)
    lane = rows_of(c).lane * width
    for x in range(width):
        block[lane + LANE.step * width + x] += select(block[lane + LANE.active * width + x] > 0.5, 1.0, 0.0)


@inlined
def protections_sample(c: Any, step: int) -> bool:
    """Return whether protections sample the grid after a simulation step of the control interval (0 is the first)."""
    between = max(1, int(PROTECTION_INTERVAL_S / c["simulation_dt"] + 1e-6))
    return (step + 1) % between == 0 or step + 1 == c["n_substeps"]


@inlined
def end_step(block: Floats, c: Any, samples: bool, lanes: Lanes) -> None:
    """Do what follows the integration of a simulation step; `samples`: whether protections sample the grid."""
    _count_step(block, c, lanes)
    track_extremes(block, c, lanes)
    shed_load(block, c, lanes)
    if samples:
        sample_grid(block, c, lanes)
        update_status(block, c, len(lanes))


@inlined
def advance_interval(
    block: Floats, first_lane: int, plant: Plant, data: LaneData, noise_y: Floats, lanes: Lanes
) -> None:
    """Advance every running lane of a block by one control interval.

    The control inputs (k_offset, inv_tau) are rows of the block and hold over the interval. On return the rows hold
    powers, coefficients and rates at the interval's end; `noise_y` (width) is scratch.
    """
    c = plant.constants[0]
    enter_interval(block, first_lane, c, data, noise_y, lanes)
    for step in range(c["n_substeps"]):
        # Asked first: the call counts references to all arrays, which takes longer than the question.
        if changes_due(block, c, lanes):
            apply_network_changes(block, first_lane, plant, data, noise_y, lanes)
        advance_step(block, c, step, lanes)
        end_step(block, c, protections_sample(c, step), lanes)
    derivatives(block, c, 1.0, lanes)


@compiled
def advance_blocks(blocks: Floats, first: int, last: int, plant: Plant, data: LaneData, lanes: Lanes) -> None:
    """Advance the blocks first … last - 1 of `blocks` (n_blocks, n_rows · width) by one control interval."""
    noise_y = np.empty(len(lanes))
    for b in range(first, last):
        advance_interval(blocks[b], b * len(lanes), plant, data, noise_y, lanes)
