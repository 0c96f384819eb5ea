"""One control interval of a block: read wind and load noise, apply events, integrate, check the protections."""

from __future__ import annotations

from wtg_gym.physics import step as systems
from wtg_gym.physics.kernel_data import LaneData, Network
from wtg_gym.physics.layout import N_WTG_ROWS, OF_LANE, Floats, place_of
from wtg_gym.physics.protection import PROTECTION_INTERVAL_S
from wtg_gym.physics.reduction import refresh_network
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.compiled import compiled, inlined, internal
from wtg_gym.systems.programs import NONE, in_one_table
from wtg_gym.systems.routines import Function, Routine

PROGRAMS = in_one_table(
    ADMITTANCES=systems.ADMITTANCES,
    FIND=systems.FIND,
    RATES=systems.RATES,
    MOVE=systems.MOVE,
    FINISH=systems.FINISH,
    PROTECT=systems.PROTECT,
    PLAN=systems.PLAN,
    BALANCE=systems.BALANCE,
    RELEASE=systems.RELEASE,
    SETTLE=systems.SETTLE,
    START=systems.START,
)
_ADMITTANCES, _FIND, _RATES, _MOVE, _FINISH, _PROTECT, *_STARTING = PROGRAMS
_FIRST, _MIDDLE, _LAST = (
    Routine(_MOVE, place=place, first=first, last=last)
    for place, (first, last) in enumerate(((1.0, 0.0), (0.0, 0.0), (0.0, 1.0)))
)
#: Routines of an evaluation, of a step, and of the start of a run.
EVALUATING = tuple(map(Routine, (_ADMITTANCES, _FIND, _RATES)))
STEPPING = (*EVALUATING, *map(Routine, (_FINISH, _PROTECT)), _FIRST, _MIDDLE, _LAST)
STARTING = (*EVALUATING, *map(Routine, _STARTING))
combine_load_noise, find, find_rates, _finish, protect, _move_first, _move, _move_last = (r.call for r in STEPPING)
plan, balance, release, settle, start = (routine.call for routine in STARTING[3:])
#: Scalars of an evaluation at an interval's end.
AT_END = (1.0, 0.0, 0.0, 0.0)
REFRESH = Function(refresh_network, 0)
refresh = REFRESH.call
_WIND_START, _WIND_END = place_of(GROUPS, "wind_start"), place_of(GROUPS, "wind_end")


@internal
def enter_interval(block: Floats, first_lane: int, network: Network, data: LaneData) -> None:
    """Read wind and load noise of the control interval that begins, for every lane of a block.

    `first_lane` is the row of the block's first lane in `data`.
    """
    facts = network.facts
    lane, groups, n_substeps = facts.lane, facts.groups, facts.n_substeps
    last, last_noise = data.wind.shape[2] - 1, data.noise.shape[1] - 1
    for x in range(block.shape[1]):
        index = int(block[lane + OF_LANE.step, x]) // n_substeps
        begin, end = index if index < last else last, index + 1 if index < last else last
        for j in range(data.wind.shape[1]):
            group = groups + j * N_WTG_ROWS
            block[group + _WIND_START, x] = data.wind[first_lane + x, j, begin]
            block[group + _WIND_END, x] = data.wind[first_lane + x, j, end]
        noise = data.noise[first_lane + x, index if index < last_noise else last_noise]
        block[lane + OF_LANE.noise_y, x] = noise * block[lane + OF_LANE.noise_per_mw, x]


@internal
def apply_events(block: Floats, first_lane: int, network: Network, data: LaneData) -> bool:
    """Let the events that are due at the present step change the networks of a block's lanes; return whether any is."""
    lane, changed = network.facts.lane, False
    for x in range(block.shape[1]):
        if block[lane + OF_LANE.step, x] >= block[lane + OF_LANE.next_change, x]:
            refresh(network.tables, (block, x, first_lane + x, network, data))
            changed = True
    return changed


@inlined
def stage_scalars(h: float, part: float, step: int, stage: int) -> tuple[float, float, float, float]:
    """Return what a stage 0 … 3 is told: when in the interval, how far it goes [s], whether it is first or last.

    Args:
        h: simulation step [s].
        part: of the control interval that it takes.
        step: its number within the interval.
        stage: of the Runge-Kutta method.
    """
    first, last = 1.0 if stage == 0 else 0.0, 1.0 if stage == 3 else 0.0
    passed = step + 0.5 * (1.0 - first + last)
    return passed * part, h / 6.0 if stage == 3 else h if stage == 2 else 0.5 * h, first, last


@internal
def advance_interval(block: Floats, scratch: Floats, first_lane: int, network: Network, data: LaneData) -> None:
    """Advance every running lane of a block by one control interval, with the classical Runge-Kutta method.

    The control inputs (k_offset, inv_tau) are rows of the block and hold over the interval. On return the rows hold
    powers and coefficients at the interval's end, and the scratch the rates.

    Args:
        block, scratch: rows of the block and of the thread (see :mod:`wtg_gym.physics.layout`).
        first_lane: the row of the block's first lane in `data`.
        network, data: constants, and what the lanes were given.
    """
    arrays, tables, facts = (block, scratch), network.tables, network.facts
    n_substeps, h = facts.n_substeps, facts.simulation_dt
    part, between = 1.0 / n_substeps, steps_between_samples(h)
    enter_interval(block, first_lane, network, data)
    combine_load_noise(arrays, tables, NONE)
    for step in range(n_substeps):
        # Again where units come back: they are synchronised first, then the network has them.
        while apply_events(block, first_lane, network, data):
            # For the whole block: a lane without a change gets the same bits again.
            combine_load_noise(arrays, tables, NONE)
        for stage in range(4):
            scalars = stage_scalars(h, part, step, stage)
            find(arrays, tables, scalars)
            if stage == 0:
                _move_first(arrays, tables, scalars)
            elif stage == 3:
                _move_last(arrays, tables, scalars)
            else:
                _move(arrays, tables, scalars)
        _finish(arrays, tables, NONE)
        if (step + 1) % between == 0 or step + 1 == n_substeps:
            protect(arrays, tables, NONE)
    find(arrays, tables, AT_END)
    find_rates(arrays, tables, AT_END)


@inlined
def steps_between_samples(h: float) -> int:
    """Return after how many simulation steps of h [s] protections sample the grid, and at an interval's end."""
    return max(1, int(PROTECTION_INTERVAL_S / h + 1e-6))


@compiled
def advance_blocks(blocks: Floats, scratch: Floats, first: int, last: int, network: Network, data: LaneData) -> None:
    """Advance the blocks first … last - 1 of `blocks` (n_blocks, n_rows, width) by one control interval.

    `scratch` (n_scratch, width) is the caller's thread's own.
    """
    for b in range(first, last):
        advance_interval(blocks[b], scratch, b * blocks.shape[2], network, data)


def evaluate_blocks(blocks: Floats, scratches: Floats, network: Network) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, each in a scratch of its own."""
    for routine in EVALUATING:
        routine((blocks, scratches), network.tables)
