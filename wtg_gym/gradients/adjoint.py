"""Back through one control step: play it again on a tape, then pull cotangents back through its programs in turn.

The programs are those of the step (:mod:`wtg_gym.physics.step`, and a task's), the right-hand side in three
parts: flows, the sweeps that hold currents, motion. Two parts of a step are differentiated by hand: the
fixed point of the sweeps, and a governor that an event takes away. The times of events and of a run's end count as
constant.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.stepping import Notes, TaskData, read_actions, task_interval_of
from wtg_gym.physics import integration
from wtg_gym.physics import step as of_step
from wtg_gym.physics.integration import N_STAGES, interval_of, stage_scalars, strike
from wtg_gym.physics.layout import BatchData, Floats, Layout, Network, Whole
from wtg_gym.physics.units import PAIRS, UNITS
from wtg_gym.physics.wtg_unit import EXTENSIONS
from wtg_gym.systems.compiled import compiled, internal
from wtg_gym.systems.programs import MemoryMap, Program, numbered, unconditional
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.writers import BackWithoutConstants, BackWriter, NotingWriter, TapedWriter, Writer
from wtg_gym.tasks import V1, Task

#: The way back through the sweeps that hold currents ends where no cotangent changes by more than `_SETTLED` of the
#: environment's largest. About thirty suffice; an environment that has not settled after `_SWEEPS` gets NaN.
_SWEEPS = 1000
_SETTLED = 1e-13


class Noted(NamedTuple):
    """Rows that each program notes on the tape in one run, in the order of :func:`programs_of`."""

    acted: int
    flows: int
    sweep: int
    motion: int
    rates: int
    finished: int
    charged: int
    measured: int
    observed: int


@functools.cache
def programs_of(task: Task) -> tuple[Program, ...]:
    """Return the programs of a task's step that are taped, and those it is replayed with."""
    return numbered(
        *integration.PROGRAMS,
        *task.programs,
        ACTED=task.act,
        FLOWS=of_step.FLOWS,
        SWEEP=of_step.SWEEP,
        MOTION=(*of_step.CAPTURE, *of_step.MOVE),
        RATES=(*of_step.CAPTURE, *of_step.RATES),
        FINISHED=unconditional(of_step.MOVED),
        CHARGED=task.charge,
        MEASURED=task.measure,
        OBSERVED=task.observe,
        LIMITS=of_step.LIMITS,
        REST=of_step.WATCH,
    )


# Every task has its programs at the same places.
_PROGRAMS = programs_of(V1)
#: How many of them have a way back.
N_TAPED = len(Noted._fields)
_TAPED = _PROGRAMS[:N_TAPED]
_sweep, (_limits, _rest) = _TAPED[Noted._fields.index("sweep")], _PROGRAMS[N_TAPED:]
_FORWARD = {
    program.name: Routine(program, writer)
    for programs, writer in ((_TAPED, TapedWriter), ((_sweep,), NotingWriter), ((_limits, _rest), Writer))
    for program in programs
}
_act, _flow, _sweep_once, _motion, _rates, _moved, _charge, _measure, _observe, _hold, _watch = (
    _FORWARD[program.name].call for program in _PROGRAMS
)
#: The ways back are one variant, with cotangents of constants or without.
_WITHOUT, _WITH = (
    tuple(Routine(program, writer, variant=1) for program in _TAPED) for writer in (BackWithoutConstants, BackWriter)
)
_act_back, _flow_back, _sweep_back, _motion_back, _rates_back, *_ending_back = (routine.call for routine in _WITH)
_moved_back, _charge_back, _measure_back, _observe_back = _ending_back


def routines_of(*, constants: bool) -> tuple[Routine, ...]:
    """Return the routines of :func:`pull`; with cotangents of constants or without."""
    return (*_FORWARD.values(), *(_WITH if constants else _WITHOUT))


class Rules(NamedTuple):
    """Rows in scratch that the rules read; those of governors are elsewhere."""

    noted: Noted
    admittances: Whole
    flows: Whole  # of all units' voltages and currents, and what limits their currents
    reactances: Whole  # of each group whose current can be limited
    references: Whole  # of the machines' gates, which a lost governor holds where they are
    droops: Whole
    gates: Whole


def rules_of(layout: Layout, plant: MemoryMap, taped: Sequence[Program]) -> Rules:
    """Return what the rules read, for a plant and its programs that are taped."""
    flows = [(UNITS, part) for part in ("voltage", "current")]
    flows += [(EXTENSIONS, part) for part in ("reactance", "source", "change")]
    return Rules(
        Noted(*(program.tape_rows(plant) for program in taped)),
        admittances=layout.number_rows(PAIRS, "admittance"),
        flows=np.concatenate([layout.number_rows(*part) for part in flows]),
        reactances=layout.first_rows(EXTENSIONS, "reactance"),
        references=layout.machine("gate_reference"),
        droops=layout.machine("inv_droop"),
        gates=layout.machine("gate"),
    )


class Bars(NamedTuple):
    """Cotangents of a control step."""

    blocks: Floats  # after the step, on return before it (n_blocks, n_rows, width)
    observations: Floats  # (num_envs, n_observation)
    actions: Floats  # are written (num_envs, n_action)
    constants: Floats  # are added to (n_blocks, n_numbers, width)


class Work(NamedTuple):
    """What a thread needs to go back through a control step of a block."""

    scratch: Floats  # (n_scratch, width)
    bars: Floats  # cotangents of the scratch (n_scratch, width)
    before: Floats  # those before a sweep (n_scratch, width)
    settled: npt.NDArray[np.bool_]  # environments whose cotangents no sweep changes any more (width,)
    tape: Floats  # (any number, width)
    admittances: Floats  # of every simulation step (n_substeps, n_admittances, width)
    limited: npt.NDArray[np.bool_]  # environments with a limited current, at every evaluation (4 n_substeps + 1, width)
    lost: npt.NDArray[np.bool_]  # governors lost at the start of every simulation step (n_substeps, n_machines, width)


def work_of(rules: Rules, layout: Layout, network: Network, width: int) -> Work:
    """Return room for a thread."""
    p, n_substeps = rules.noted, network.facts.n_substeps
    n_taped = _row(p, n_substeps, 0) + p.flows + p.sweep + p.rates + p.charged + p.measured + p.observed
    scratch, bars, before = np.zeros((3, layout.n_scratch, width))
    return Work(
        scratch,
        bars,
        before,
        np.zeros(width, dtype=np.bool_),
        np.zeros((n_taped, width)),
        np.zeros((n_substeps, rules.admittances.size, width)),
        np.zeros((N_STAGES * n_substeps + 1, width), dtype=np.bool_),
        np.zeros((n_substeps, layout.n_sync, width), dtype=np.bool_),
    )


@compiled
def _row(noted: Noted, step: int, stage: int) -> int:
    """Return the row of the tape where the notes of a stage begin; of stage `N_STAGES`, those of the step's end."""
    of_stage = noted.flows + noted.sweep + noted.motion
    return noted.acted + step * (N_STAGES * of_stage + noted.finished) + stage * of_stage


@internal
def _strike(
    block: Floats, scratch: Floats, first: int, network: Network, data: BatchData, tape: tuple[Rules, Work], step: int
) -> None:
    """Let events strike; note the admittances that they leave, and which governors they take away."""
    rules, work = tape
    for i in range(rules.droops.shape[0]):
        for x in range(block.shape[1]):
            work.lost[step, i, x] = block[rules.droops[i], x] > 0.0
    strike(block, scratch, first, network, data, None, step)
    for i in range(rules.droops.shape[0]):
        for x in range(block.shape[1]):
            work.lost[step, i, x] &= block[rules.droops[i], x] == 0.0
    for i in range(rules.admittances.shape[0]):
        for x in range(block.shape[1]):
            work.admittances[step, i, x] = scratch[rules.admittances[i], x]


@internal
def _find(block: Floats, scratch: Floats, network: Network, tape: tuple[Rules, Work], step: int, stage: int) -> None:
    """Find voltages and currents, hold these within their limits, and note the fixed point that the sweeps find."""
    rules, work = tape
    at, evaluation = _row(rules.noted, step, stage), N_STAGES * step + stage
    _flow((block, scratch, work.tape), network.code, (), at)
    _hold((block, scratch), network.code)
    for x in range(block.shape[1]):
        work.limited[evaluation, x] = False
        for i in range(rules.reactances.shape[0]):
            work.limited[evaluation, x] |= scratch[rules.reactances[i], x] > 0.0
    _sweep_once((block, scratch, work.tape), network.code, (), at + rules.noted.flows)


@internal
def _move(block: Floats, scratch: Floats, network: Network, tape: tuple[Rules, Work], step: int, stage: int) -> None:
    rules, work = tape
    at = _row(rules.noted, step, stage) + rules.noted.flows + rules.noted.sweep
    _motion((block, scratch, work.tape), network.code, stage_scalars(network.facts, step, stage), at)


@internal
def _finish(block: Floats, scratch: Floats, network: Network, tape: tuple[Rules, Work], step: int) -> None:
    rules, work = tape
    _moved((block, scratch, work.tape), network.code, (), _row(rules.noted, step, N_STAGES))
    _watch((block, scratch), network.code)


@internal
def _find_rates(block: Floats, scratch: Floats, network: Network, tape: tuple[Rules, Work], step: int) -> None:
    rules, work = tape
    at = _row(rules.noted, step, 0) + rules.noted.flows + rules.noted.sweep
    _rates((block, scratch, work.tape), network.code, stage_scalars(network.facts, step, 0), at)


_replay = interval_of(_strike, _find, _move, _finish, _find_rates)
_play = task_interval_of(_act, _replay, _charge, _measure, _observe)


@internal
def _pull_lost_governors(bars: Floats, rules: Rules, work: Work, step: int) -> None:
    """The reference of a governor that is lost here is where its gate was; no droop acts from here on."""
    for i in range(rules.droops.shape[0]):
        for x in range(bars.shape[1]):
            if work.lost[step, i, x]:
                bars[rules.droops[i], x] = 0.0
                bars[rules.gates[i], x] += bars[rules.references[i], x]
                bars[rules.references[i], x] = 0.0


@internal
def _settle(rules: Rules, work: Work) -> None:
    """Give environments that had settled the cotangents from before a sweep, and find which have settled now."""
    bars, before = work.bars, work.before
    for x in range(bars.shape[1]):
        largest, change = 0.0, 0.0
        for i in range(rules.flows.shape[0]):
            row = rules.flows[i]
            if work.settled[x]:
                bars[row, x] = before[row, x]
            largest, change = max(largest, abs(bars[row, x])), max(change, abs(bars[row, x] - before[row, x]))
        work.settled[x] |= not change > _SETTLED * largest


@internal
def _pull_flows(bars: Floats, to: Floats, network: Network, rules: Rules, work: Work, step: int, stage: int) -> None:
    """Go back through the voltages and currents of a right-hand side.

    First through the sweeps that held the currents of some. As they end at a fixed point, each has the
    derivatives of the last: this is the adjoint of that point, approached as the sweeps approached it. Environments
    without a limited current keep their bits.
    """
    width = work.bars.shape[1]
    at, evaluation, sweeps = _row(rules.noted, step, stage), N_STAGES * step + stage, 0
    for x in range(width):
        work.settled[x] = not work.limited[evaluation, x]
    arrays = bars, work.bars, work.tape, work.scratch, to
    while not work.settled.all() and sweeps < _SWEEPS:
        for i in range(rules.flows.shape[0]):
            for x in range(width):
                work.before[rules.flows[i], x] = work.bars[rules.flows[i], x]
        _sweep_back(arrays, network.code, (), at + rules.noted.flows)
        _settle(rules, work)
        sweeps += 1
    for x in range(width):
        if not work.settled[x]:
            work.bars[:, x] = math.nan
    _flow_back(arrays, network.code, (), at)


@internal
def _pull_interval(bars: Floats, to: Floats, network: Network, rules: Rules, work: Work) -> None:
    """Go back through a control interval, against the order of :func:`~wtg_gym.physics.integration.interval_of`."""
    code, scratch, facts, p = network.code, work.scratch, network.facts, rules.noted
    arrays, n, of_find = (bars, work.bars, work.tape, scratch, to), facts.n_substeps, p.flows + p.sweep
    _rates_back(arrays, code, stage_scalars(facts, n, 0), _row(p, n, 0) + of_find)
    _pull_flows(bars, to, network, rules, work, n, 0)
    for step in range(n - 1, -1, -1):
        for i in range(rules.admittances.shape[0]):
            for x in range(scratch.shape[1]):
                scratch[rules.admittances[i], x] = work.admittances[step, i, x]
        _moved_back(arrays, code, (), _row(p, step, N_STAGES))
        for stage in range(N_STAGES - 1, -1, -1):
            _motion_back(arrays, code, stage_scalars(facts, step, stage), _row(p, step, stage) + of_find)
            _pull_flows(bars, to, network, rules, work, step, stage)
        _pull_lost_governors(bars, rules, work, step)


@compiled
def pull(
    blocks: Floats,
    bars: Bars,
    first: int,
    last: int,
    network: Network,
    data: BatchData,
    task: TaskData,
    actions: Floats,
    tape: tuple[Rules, Work],
) -> None:
    """Go back through one control step of the blocks first … last - 1, with its actions (num_envs, n_action).

    The blocks (n_blocks, n_rows, width) stand as before the step, and as after it on return; `bars` are the cotangents.
    """
    rules, work = tape
    code, scratch, scratch_bars, p = network.code, work.scratch, work.bars, rules.noted
    width = blocks.shape[2]
    charged = _row(p, network.facts.n_substeps, 0) + p.flows + p.sweep + p.rates
    notes = Notes(0, charged, charged + p.charged, charged + p.charged + p.measured)
    for b in range(first, last):
        block, block_bars, to, env = blocks[b], bars.blocks[b], bars.constants[b], b * width
        read_actions(scratch, actions, env, task)
        taped, back = (block, scratch, work.tape), (block_bars, scratch_bars, work.tape, scratch, to)
        _play(taped, env, network, data, notes, tape)
        scratch_bars[:] = 0.0
        num_envs = min(width, actions.shape[0] - env)
        for k in range(task.observed.shape[0]):
            for x in range(num_envs):
                scratch_bars[task.observed[k], x] += bars.observations[env + x, k]
        _observe_back(back, code, (), notes.observed)
        _measure_back(back, code, (), notes.measured)
        _charge_back(back, code, (), notes.charged)
        _pull_interval(block_bars, to, network, rules, work)
        _act_back(back, code, (), notes.acted)
        for a in range(task.wanted.shape[0]):
            for x in range(num_envs):
                bars.actions[env + x, a] = scratch_bars[task.wanted[a], x]
