"""One control interval of a block: read wind and load noise, apply events, integrate, check the protections."""

from collections.abc import Callable
from typing import Any

from wtg_gym.physics import step as systems
from wtg_gym.physics.layout import OF_ENV, BatchData, Facts, Floats, Network, place_of, units_of
from wtg_gym.physics.network_events import refresh_network
from wtg_gym.physics.protection import PROTECTION_INTERVAL_S
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.compiled import allocating, compiled, internal
from wtg_gym.systems.programs import numbered
from wtg_gym.systems.routines import Function, Routine

#: Lists of :mod:`wtg_gym.physics.step` that are programs: those of a step, then those of the start of a run.
PROGRAMS = numbered(
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
    Routine(_MOVE, variant=variant, first=first, last=last)
    for variant, (first, last) in enumerate(((1.0, 0.0), (0.0, 0.0), (0.0, 1.0)))
)
#: Routines of an evaluation, of a step, and of the start of a run.
EVALUATING = tuple(map(Routine, (_ADMITTANCES, _FIND, _RATES)))
STEPPING = (*EVALUATING, *map(Routine, (_FINISH, _PROTECT)), _FIRST, _MIDDLE, _LAST)
STARTING = (*EVALUATING, *map(Routine, _STARTING))
combine_load_noise, find, find_rates, finish, protect, move_first, move_middle, move_last = (r.call for r in STEPPING)
plan, balance, release, settle, start = (routine.call for routine in STARTING[len(EVALUATING) :])
#: Stages of a step of the classical Runge-Kutta method.
N_STAGES = 4
REFRESH = Function(refresh_network, 0)
refresh = REFRESH.call
_WIND_START, _WIND_END = place_of(GROUPS, "wind_start"), place_of(GROUPS, "wind_end")


@allocating
def _enter_interval(block: Floats, first_env: int, network: Network, data: BatchData) -> None:
    """Read wind and load noise of the control interval that begins, for every environment of a block."""
    facts = network.facts
    env, groups = units_of(block, facts.env)[0], units_of(block, facts.groups)
    last, last_noise = data.wind.shape[2] - 1, data.noise.shape[1] - 1
    for x in range(block.shape[1]):
        index = int(env[OF_ENV.step, x]) // facts.n_substeps
        begin, end = min(index, last), min(index + 1, last)
        for j in range(data.wind.shape[1]):
            groups[j, _WIND_START, x] = data.wind[first_env + x, j, begin]
            groups[j, _WIND_END, x] = data.wind[first_env + x, j, end]
        noise = data.noise[first_env + x, min(index, last_noise)]
        env[OF_ENV.noise_y, x] = noise * env[OF_ENV.noise_per_mw, x]


@internal
def strike(
    block: Floats, scratch: Floats, first_env: int, network: Network, data: BatchData, tape: Any, step: int
) -> None:
    """Let the events that are due at the present step change the networks of a block."""
    env, changed = network.facts.env.first, False
    for x in range(block.shape[1]):
        if block[env + OF_ENV.step, x] >= block[env + OF_ENV.next_change, x]:
            refresh(network.code, (block, x, first_env + x, network, data))
            changed = True
    if changed:
        # For the whole block: an environment without a change gets the same bits again.
        combine_load_noise((block, scratch), network.code)


@internal
def stage_scalars(facts: Facts, step: int, stage: int) -> tuple[float, float, float, float]:
    """Return the scalars of a stage, 0 … 3: when in the interval, how far it goes [s], whether it is first or last.

    The step counts within the interval; `n_substeps` stands for the interval's end.
    """
    if step == facts.n_substeps:
        return 1.0, 0.0, 0.0, 0.0
    first, last = 1.0 if stage == 0 else 0.0, 1.0 if stage == 3 else 0.0
    h, passed = facts.simulation_dt, step + 0.5 * (1.0 - first + last)
    return passed * (1.0 / facts.n_substeps), h / 6.0 if stage == 3 else h if stage == 2 else 0.5 * h, first, last


@internal
def _find(block: Floats, scratch: Floats, network: Network, tape: Any, step: int, stage: int) -> None:
    find((block, scratch), network.code, stage_scalars(network.facts, step, stage))


@internal
def _move(block: Floats, scratch: Floats, network: Network, tape: Any, step: int, stage: int) -> None:
    arrays, scalars = (block, scratch), stage_scalars(network.facts, step, stage)
    if stage == 0:
        move_first(arrays, network.code, scalars)
    elif stage == 3:
        move_last(arrays, network.code, scalars)
    else:
        move_middle(arrays, network.code, scalars)


@internal
def _finish(block: Floats, scratch: Floats, network: Network, tape: Any, step: int) -> None:
    finish((block, scratch), network.code)


@internal
def _find_rates(block: Floats, scratch: Floats, network: Network, tape: Any, step: int) -> None:
    find_rates((block, scratch), network.code, stage_scalars(network.facts, step, 0))


def interval_of(
    strike: Callable[..., None],
    find: Callable[..., None],
    move: Callable[..., None],
    finish: Callable[..., None],
    find_rates: Callable[..., None],
) -> Callable[[Floats, Floats, int, Network, BatchData, Any], None]:
    """Return a function that advances every running environment of a block by one control interval.

    This alone knows the order within an interval; the parts do each thing plainly, or record it on a tape as well. The
    function takes the rows of the block and of the thread's scratch (see :mod:`wtg_gym.physics.layout`), the row of the
    block's first environment in `data`, and what its parts need of a tape. Control inputs (k_offset, inv_tau) are rows
    of the block and hold over the interval. On return the rows hold powers and coefficients at the interval's end, and
    the scratch the rates.

    Args:
        strike: lets events strike: (block, scratch, first_env, network, data, tape, step).
        find, move: evaluation and motion of a stage: (block, scratch, network, tape, step, stage).
        finish, find_rates: of a step, and at the interval's end: (block, scratch, network, tape, step).
    """

    @internal
    def advance(block: Floats, scratch: Floats, first_env: int, network: Network, data: BatchData, tape: Any) -> None:
        n_substeps = network.facts.n_substeps
        # Protections sample the grid after so many simulation steps, and at the interval's end.
        between = max(1, int(PROTECTION_INTERVAL_S / network.facts.simulation_dt + 1e-6))
        _enter_interval(block, first_env, network, data)
        combine_load_noise((block, scratch), network.code)
        for step in range(n_substeps):
            strike(block, scratch, first_env, network, data, tape, step)
            for stage in range(N_STAGES):
                find(block, scratch, network, tape, step, stage)
                move(block, scratch, network, tape, step, stage)
            finish(block, scratch, network, tape, step)
            if (step + 1) % between == 0 or step + 1 == n_substeps:
                protect((block, scratch), network.code)
        find(block, scratch, network, tape, n_substeps, 0)
        find_rates(block, scratch, network, tape, n_substeps)

    return advance


#: The plain step; it has no tape.
advance_interval = interval_of(strike, _find, _move, _finish, _find_rates)


@compiled
def advance_blocks(blocks: Floats, scratch: Floats, first: int, last: int, network: Network, data: BatchData) -> None:
    """Advance the blocks first … last - 1 of `blocks` (n_blocks, n_rows, width) by one control interval.

    `scratch` (n_scratch, width) is the caller's thread's own.
    """
    for b in range(first, last):
        advance_interval(blocks[b], scratch, b * blocks.shape[2], network, data, None)


@compiled
def evaluate_blocks(blocks: Floats, scratches: Floats, network: Network) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, each in a scratch of its own."""
    for b in range(blocks.shape[0]):
        arrays = blocks[b], scratches[b]
        combine_load_noise(arrays, network.code)
        find(arrays, network.code)
        find_rates(arrays, network.code)
