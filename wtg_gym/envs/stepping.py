"""One step of a task over the environments of a block: actions, physics, cost, observation, information, reward.

One compiled call does it all: act → the physics' step → charge → measure → observe → end. The lists of systems are
those of a :class:`~wtg_gym.tasks.task.Task`.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from numba.experimental import structref

from wtg_gym.physics.integration import advance_interval
from wtg_gym.physics.layout import BatchData, Floats, Layout, Network, Whole
from wtg_gym.systems.compiled import compiled, internal
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import count
from wtg_gym.tasks import V1, Task
from wtg_gym.tasks.cost import COST, COST_TERMS
from wtg_gym.tasks.episode import ACTING, ACTION_MODES, TASK
from wtg_gym.tasks.observation import INFO, INFO_KEYS, Info, LocalInfo
from wtg_gym.tasks.task import Choices

N_INFO = len(INFO_KEYS) + len(LocalInfo._fields)
#: Places in `info` of the terms of the cost, and of the violated constraint.
_N_TERMS = len(COST_TERMS)
_FIRST_TERM, _CONSTRAINT = len(Info._fields), Info._fields.index("cost")
# Every task has its lists at the same places.
_act, _charge, _start_sensors, _measure, _observe, _end = (Routine(program).call for program in V1.programs)


class Notes(NamedTuple):
    """Rows of a tape where the programs of an interval begin their notes."""

    acted: int = 0
    charged: int = 0
    measured: int = 0
    observed: int = 0


_NO_NOTES = Notes()


def task_interval_of(
    act: Callable[..., None],
    advance: Callable[..., None],
    charge: Callable[..., None],
    measure: Callable[..., None],
    observe: Callable[..., None],
) -> Callable[[tuple[Floats, ...], int, Network, BatchData, Notes, Any], None]:
    """Return a function that plays an interval of a task in the environments of a block; this alone knows the order.

    `advance` is :func:`~wtg_gym.physics.integration.advance_interval` or its replay, the others are programs. The
    function takes block and scratch, with a tape where the programs have one, the row of the block's first environment
    in `data`, and what `advance` needs of a tape.
    """

    @internal
    def play(
        arrays: tuple[Floats, ...], first_env: int, network: Network, data: BatchData, notes: Notes, tape: Any
    ) -> None:
        act(arrays, network.code, (), notes.acted)
        advance(arrays[0], arrays[1], first_env, network, data, tape)
        charge(arrays, network.code, (), notes.charged)
        measure(arrays, network.code, (), notes.measured)
        observe(arrays, network.code, (), notes.observed)

    return play


_play = task_interval_of(_act, advance_interval, _charge, _measure, _observe)


class Outputs(NamedTuple):
    """Outputs of a step, one row per environment."""

    observations: npt.NDArray[np.float32]  # (num_envs, n_observation)
    rewards: Floats  # (num_envs,), 0 for an environment that had ended
    infos: Floats  # (num_envs, N_INFO)
    terminated: npt.NDArray[np.bool_]  # (num_envs,)
    truncated: npt.NDArray[np.bool_]  # (num_envs,)
    #: Of rewards that are points of the score: the reference's costs up to each control step (num_envs, n_steps + 1),
    #: J0 (num_envs,), and the points up to now, in units of Λ / 100 (num_envs,).
    reference: Floats
    offsets: Floats
    gained: Floats


class TaskData(NamedTuple):
    """Where the loops of the task find rows: in scratch up to `was_active`, then in blocks."""

    wanted: Whole  # actions (n_action,)
    observed: Whole  # numbers of the observation (n_observation,)
    info: int  # the first of N_INFO
    was_active: int
    cost: int
    active: int
    status: int
    step: int
    sums: int  # the first term of the cost of an episode
    n_intervals: int  # in a control step
    points: float  # of the score per unit of what is gained; 0 where rewards are costs


def task_data(task: Task, choices: Choices, layout: Layout, n_intervals: int, points: float) -> TaskData:
    """Return what the loops of the task need: rows, and the numbers that :class:`TaskData` describes."""
    modulated = np.array(ACTION_MODES[choices.action_mode])
    wanted = layout.first_rows(ACTING, "wanted")[:, np.newaxis] + np.arange(count(ACTING.scratch["wanted"]))
    return TaskData(
        wanted=wanted[:, modulated].ravel(),
        observed=np.array([number.row(layout) for number in task.observed_numbers(choices)], dtype=np.int64),
        info=int(layout.first_rows(INFO, "info")[0]),
        was_active=int(layout.first_rows(TASK, "was_active")[0]),
        cost=int(layout.first_rows(COST, "cost")[0]),
        active=layout.env("active"),
        status=layout.env("status"),
        step=layout.env("step"),
        sums=int(layout.first_rows(COST, "sums")[0]),
        n_intervals=n_intervals,
        points=points,
    )


@internal
def read_actions(scratch: Floats, actions: Floats, first: int, task: TaskData) -> int:
    """Copy the actions of a block's environments, from `first` on; return the first with one not finite, or -1."""
    invalid = -1
    for a in range(task.wanted.shape[0]):
        for x in range(scratch.shape[1]):
            # Padding has none.
            action = actions[first + x, a] if first + x < actions.shape[0] else 0.0
            if not math.isfinite(action) and (invalid < 0 or first + x < invalid):
                invalid = first + x
            scratch[task.wanted[a], x] = action
    return invalid


@internal
def _report(block: Floats, scratch: Floats, first: int, task: TaskData, outputs: Outputs, interval: int) -> None:
    """Copy what the environments of a block, from `first` on, have observed, and say whether their episodes are over.

    Costs add up over the intervals of a control step, and one with a violated constraint is enough.
    """
    for x in range(min(block.shape[1], outputs.rewards.shape[0] - first)):
        env = first + x
        if interval == 0:
            outputs.rewards[env] = 0.0
        if scratch[task.was_active, x] > 0.5:
            # 0.0 - cost would give another sign of zero.
            cost = block[task.cost, x]
            outputs.rewards[env] = -cost if interval == 0 else outputs.rewards[env] - cost
            for k in range(task.observed.shape[0]):
                outputs.observations[env, k] = scratch[task.observed[k], x]
            for k in range(N_INFO):
                value, before = scratch[task.info + k, x], outputs.infos[env, k]
                if interval > 0 and _FIRST_TERM <= k < _FIRST_TERM + _N_TERMS:
                    value += before
                elif interval > 0 and k == _CONSTRAINT:
                    value = max(value, before)
                outputs.infos[env, k] = value
            failed = block[task.status, x] != 0.0
            outputs.terminated[env] = failed
            outputs.truncated[env] = not failed and block[task.active, x] < 0.5


@compiled
def log_score(reference: float, cost: float, offset: float) -> float:
    """Return what a score counts of an episode's costs, ln((C_ref + J0) / (C + J0)), in units of Λ / 100."""
    return math.log((reference + offset) / (cost + offset))


@internal
def _cost_of(block: Floats, x: int, task: TaskData) -> float:
    """Return the cost of an environment's episode up to now."""
    cost = 0.0
    for k in range(_N_TERMS):
        cost += block[task.sums + k, x]
    return cost


@internal
def _score(block: Floats, first: int, n_substeps: int, task: TaskData, outputs: Outputs) -> None:
    """Reward the environments of a block, from `first` on, with what their score has gained in a control step.

    On the way gained = (C_ref - C) / (C_ref at the end + J0) of the costs C up to now: a step's reward does not depend
    on earlier costs, which a critic cannot observe. At the end it is
    :func:`log_score`, to which the former is close unless the costs differ much.
    """
    for x in range(min(block.shape[1], outputs.rewards.shape[0] - first)):
        env, cost = first + x, _cost_of(block, x, task)
        steps = math.ceil(block[task.step, x] / n_substeps) if block[task.active, x] > 0.5 else -1
        whole, offset = outputs.reference[env, -1], outputs.offsets[env]
        gained = (outputs.reference[env, steps] - cost) / (whole + offset)
        if steps == -1:
            gained = log_score(whole, cost, offset)
        outputs.rewards[env] = task.points * (gained - outputs.gained[env])
        outputs.gained[env] = gained


# A call into compiled code unpacks every array that it is given, which takes a third as long as the step of one
# environment. Bound to one object, they are unpacked once.


@structref.register
class _BoundType(numba.types.StructRef):  # type: ignore[misc]
    """The compiler's type of :class:`Bound`."""

    def preprocess_fields(self, fields: Any) -> Any:
        return tuple((name, numba.types.unliteral(type_)) for name, type_ in fields)


class Bound(structref.StructRefProxy):  # type: ignore[misc]
    """The arguments of :func:`step_blocks` that last, in one object; :func:`bind` makes it."""


structref.define_proxy(Bound, _BoundType, ["blocks", "scratches", "network", "data", "task", "outputs"])


# The constructor that numba makes for `Bound` is not kept on disk: each process would compile it anew.
@compiled
def bind(blocks: Floats, scratches: Floats, network: Network, data: BatchData, task: TaskData, outputs: Outputs) -> Any:
    """Return the arguments of :func:`step_blocks` that last.

    They are blocks (n_blocks, n_rows, width), the scratch of each worker (n_workers, n_scratch, width), and what is
    read and written; the reward is 0 for environments that had ended.
    """
    return Bound(blocks, scratches, network, data, task, outputs)


@compiled
def step_blocks(bound: Any, actions: Floats, first: int, last: int, worker: int, starts: bool) -> int:
    """Apply actions, advance one control step, observe and charge, for the environments of blocks first … last - 1.

    Actions are (num_envs, n_action). `starts` takes the first measurements and observations of prepared episodes
    instead. It returns -1, or the first environment with an action not finite: its block and later ones have not moved.
    """
    scratch, of_all = bound.scratches[worker], (bound.network, bound.data, bound.task, bound.outputs)
    return _step_blocks(bound.blocks, scratch, of_all, actions, first, last, starts)


@internal
def _step_blocks(
    blocks: Floats, scratch: Floats, of_all: Any, actions: Floats, first: int, last: int, starts: bool
) -> int:
    network, data, task, outputs = of_all
    width, code = blocks.shape[2], network.code
    for b in range(first, last):
        block, arrays = blocks[b], (blocks[b], scratch)
        if starts:
            for x in range(width):
                scratch[task.was_active, x] = 1.0
            _start_sensors(arrays, code)
            _observe(arrays, code)
            _report(block, scratch, b * width, task, outputs, 0)
            continue
        invalid = read_actions(scratch, actions, b * width, task)
        if invalid >= 0:
            return invalid
        for interval in range(task.n_intervals):
            _play(arrays, b * width, network, data, _NO_NOTES, None)
            _end(arrays, code)
            _report(block, scratch, b * width, task, outputs, interval)
        if task.points > 0.0:
            _score(block, b * width, network.facts.n_substeps * task.n_intervals, task, outputs)
    return -1


@compiled
def play_costs(bound: Any, actions: Floats, costs: Floats, first: int, last: int, worker: int) -> None:
    """Play episodes of blocks first … last - 1 that have just been started, with the same actions (num_envs, n_action).

    What each has cost up to every control step is written to `costs` (num_envs, n_steps + 1).
    """
    blocks, scratch, task = bound.blocks, bound.scratches[worker], bound.task
    of_all, width = (bound.network, bound.data, task, bound.outputs), blocks.shape[2]
    for b in range(first, min(last, math.ceil(costs.shape[0] / width))):
        for step in range(1, costs.shape[1]):
            _step_blocks(blocks, scratch, of_all, actions, b, b + 1, False)
            for x in range(min(width, costs.shape[0] - b * width)):
                costs[b * width + x, step] = _cost_of(blocks[b], x, task)
