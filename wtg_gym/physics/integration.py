"""One control interval of a block: read wind and load noise, apply events, integrate, check the protections."""

from __future__ import annotations

from wtg_gym.physics import step as systems
from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import N_WTG_ROWS, OF_LANE, Floats, Lanes, place_of
from wtg_gym.physics.protection import PROTECTION_INTERVAL_S
from wtg_gym.physics.reduction import refresh_network
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.compiled import compiled, inlined
from wtg_gym.systems.programs import NONE, in_one_table

PROGRAMS = in_one_table(
    ADMITTANCES=systems.ADMITTANCES,
    STAGE=systems.STAGE,
    EVALUATE=systems.EVALUATE,
    FINISH=systems.FINISH,
    PROTECT=systems.PROTECT,
    START_MACHINES=systems.START_MACHINES,
    START=systems.START,
)
_admittances, _, _evaluate, _finish, _protect, _start_machines, _start = (program.function() for program in PROGRAMS)
_first_stage, _middle_stage, _last_stage = (
    PROGRAMS[1].function(first=first, last=last) for first, last in ((1.0, 0.0), (0.0, 0.0), (0.0, 1.0))
)
_WIND_START, _WIND_END = place_of(GROUPS, "wind_start"), place_of(GROUPS, "wind_end")


@inlined
def enter_interval(block: Floats, first_lane: int, plant: Plant, data: LaneData, lanes: Lanes) -> None:
    """Read wind and load noise of the control interval that begins, for every lane of a block.

    `first_lane` is the row of the block's first lane in `data`.
    """
    facts, lane = plant.facts[0], plant.facts[0]["lane"]
    last, last_noise = data.wind.shape[2] - 1, data.noise.shape[1] - 1
    for x in range(len(lanes)):
        index = int(block[lane + OF_LANE.step, x]) // facts["n_substeps"]
        for j in range(data.wind.shape[1]):
            group, wind = facts["groups"] + j * N_WTG_ROWS, data.wind[first_lane + x, j]
            block[group + _WIND_START, x], block[group + _WIND_END, x] = (
                wind[min(index, last)],
                wind[min(index + 1, last)],
            )
        noise = data.noise[first_lane + x, min(index, last_noise)]
        block[lane + OF_LANE.noise_y, x] = noise * block[lane + OF_LANE.noise_per_mw, x]


@inlined
def apply_events(block: Floats, first_lane: int, plant: Plant, data: LaneData, lanes: Lanes) -> bool:
    """Let the events that are due at the present step change the networks of a block's lanes; return whether any is."""
    lane, changed = plant.facts[0]["lane"], False
    for x in range(len(lanes)):
        if block[lane + OF_LANE.step, x] >= block[lane + OF_LANE.next_change, x]:
            refresh_network(block, x, first_lane + x, plant, data)
            changed = True
    return changed


@inlined
def combine_load_noise(block: Floats, scratch: Floats, plant: Plant, lanes: Lanes) -> None:
    """Put the load noise into the reduced admittance of every lane of a block."""
    _admittances(block, scratch, plant.tables, NONE, lanes)


@inlined
def advance_step(block: Floats, scratch: Floats, plant: Plant, step: int, lanes: Lanes) -> None:
    """Advance every running lane of a block by one simulation step with the classical Runge-Kutta method.

    Args:
        block, scratch: rows of the block and of the thread (see :mod:`wtg_gym.physics.layout`).
        plant: constants.
        step: number of the step within the control interval, for the wind's interpolation.
        lanes: a tuple as long as the block is wide.
    """
    _first_stage(block, scratch, plant.tables, stage_scalars(plant, step, 0), lanes)
    # A loop, so that the stage is compiled once.
    for stage in range(1, 3):
        _middle_stage(block, scratch, plant.tables, stage_scalars(plant, step, stage), lanes)
    _last_stage(block, scratch, plant.tables, stage_scalars(plant, step, 3), lanes)
    _finish(block, scratch, plant.tables, NONE, lanes)


@inlined
def stage_scalars(plant: Plant, step: int, stage: int) -> tuple[float, float, float, float]:
    """Return what a stage 0 … 3 is told: when in the interval, how far it goes [s], whether it is first or last."""
    h, part = plant.facts[0]["simulation_dt"], 1.0 / plant.facts[0]["n_substeps"]
    first, last = 1.0 if stage == 0 else 0.0, 1.0 if stage == 3 else 0.0
    passed = step + 0.5 * (1.0 - first + last)
    return passed * part, h / 6.0 if stage == 3 else h if stage == 2 else 0.5 * h, first, last


@inlined
def protect(block: Floats, scratch: Floats, plant: Plant, lanes: Lanes) -> None:
    """Let the protections sample the grid."""
    _protect(block, scratch, plant.tables, NONE, lanes)


@inlined
def protections_sample(plant: Plant, step: int) -> bool:
    """Return whether protections sample the grid after a simulation step of the control interval (0 is the first)."""
    between = max(1, int(PROTECTION_INTERVAL_S / plant.facts[0]["simulation_dt"] + 1e-6))
    return (step + 1) % between == 0 or step + 1 == plant.facts[0]["n_substeps"]


@inlined
def evaluate(block: Floats, scratch: Floats, plant: Plant, fraction: float, lanes: Lanes) -> None:
    """Evaluate rates and outputs of every lane of a block at its present state."""
    _evaluate(block, scratch, plant.tables, (fraction, 0.0, 0.0, 0.0), lanes)


@inlined
def start_machines(block: Floats, scratch: Floats, plant: Plant, lanes: Lanes) -> None:
    """Put machines into the equilibrium of what scratch says of their terminals."""
    _start_machines(block, scratch, plant.tables, NONE, lanes)


@inlined
def start_run(block: Floats, scratch: Floats, plant: Plant, lanes: Lanes) -> None:
    """Evaluate the first outputs and extremes of every lane of a block."""
    _start(block, scratch, plant.tables, NONE, lanes)


@inlined
def advance_interval(
    block: Floats, scratch: Floats, first_lane: int, plant: Plant, data: LaneData, lanes: Lanes
) -> None:
    """Advance every running lane of a block by one control interval.

    The control inputs (k_offset, inv_tau) are rows of the block and hold over the interval. On return the rows hold
    powers and coefficients at the interval's end, and the scratch the rates.
    """
    enter_interval(block, first_lane, plant, data, lanes)
    combine_load_noise(block, scratch, plant, lanes)
    for step in range(plant.facts[0]["n_substeps"]):
        if apply_events(block, first_lane, plant, data, lanes):
            # For the whole block: a lane without a change gets the same bits again.
            combine_load_noise(block, scratch, plant, lanes)
        advance_step(block, scratch, plant, step, lanes)
        if protections_sample(plant, step):
            protect(block, scratch, plant, lanes)
    evaluate(block, scratch, plant, 1.0, lanes)


@compiled
def advance_blocks(
    blocks: Floats, scratch: Floats, first: int, last: int, plant: Plant, data: LaneData, lanes: Lanes
) -> None:
    """Advance the blocks first … last - 1 of `blocks` (n_blocks, n_rows, width) by one control interval.

    `scratch` (n_scratch, width) is the caller's thread's own.
    """
    for b in range(first, last):
        advance_interval(blocks[b], scratch, b * len(lanes), plant, data, lanes)


@compiled
def evaluate_blocks(blocks: Floats, scratches: Floats, plant: Plant, lanes: Lanes) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, each in a scratch of its own."""
    for b in range(blocks.shape[0]):
        combine_load_noise(blocks[b], scratches[b], plant, lanes)
        evaluate(blocks[b], scratches[b], plant, 0.0, lanes)
