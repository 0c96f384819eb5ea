"""The kernels of a control step as programs: which numbers they store, worked out from which.

A step is three programs: what comes before the integration, a simulation step, and what comes after the last one. They
are traced from the kernels' own source (:mod:`wtg_gym.gradients.tracing`). Behind the rows of a block come the inputs
of a step, :class:`Inputs`, and behind these its outputs, :class:`Reported`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.task import N_INFO, report, step_blocks
from wtg_gym.envs.task_records import read_task
from wtg_gym.functional.branches import Cells, is_finite, where, without_branches
from wtg_gym.gradients import expressions as ex
from wtg_gym.gradients.tracing import ARITHMETIC, Actions, Rows, retargeted
from wtg_gym.physics.dynamics import advance_stage, advance_step, derivatives
from wtg_gym.physics.integration import end_step, enter_interval
from wtg_gym.physics.layout import LANE, Floats, Layout
from wtg_gym.physics.plant_constants import Plant
from wtg_gym.physics.protection import update_status
from wtg_gym.physics.reduction import combine_load_noise, lose_governor
from wtg_gym.physics.runge_kutta import FIRST, LAST, MIDDLE

_LANES = (0,)


def _least(a: Any, b: Any) -> Any:
    """Sizes stay whole numbers."""
    return min(a, b) if all(isinstance(one, int | np.integer) for one in (a, b)) else ex.smallest(a, b)


_ARITHMETIC: dict[str, Any] = {
    **ARITHMETIC,
    "min": _least,
    "np": SimpleNamespace(empty=lambda n, dtype=None: [0.0] * n, int64=np.int64, uint32=int),
    "math": SimpleNamespace(**vars(ARITHMETIC["math"]), isfinite=is_finite),
}


class Inputs(NamedTuple):
    """Rows of what a step is given."""

    actions: range
    wind_start: range  # of each WTG group [m/s]
    wind_end: range
    noise: int  # load noise [MW]
    noise_y: int  # that noise as an admittance [p.u.]
    stage: range  # of the Runge-Kutta method: share of the interval that has passed, step [s], 1 if first, 1 if last
    samples: int  # 1 where the protections sample the grid at the end of the simulation step
    lost: range  # 1 for machines whose governor is lost


class Reported(NamedTuple):
    """Rows of what a step says."""

    reward: int
    terminated: int
    truncated: int
    info: range
    observation: range


#: The cotangent of a row stands so many rows behind it.
COTANGENT = 1_000_000


class Program:
    """Numbers to store in rows, in an order in which they can be worked out."""

    def __init__(self, stores: Mapping[int, Any]) -> None:
        self.stores = dict(stores)
        self.reads = ex.rows_read(self.stores.values())
        self._order = ex.needed(self.stores.values())

    def of(self, rows: Iterable[int]) -> Program:
        """Return the program that stores only some of the rows."""
        return Program({row: self.stores[row] for row in sorted(rows) if row in self.stores})

    def pulled(self) -> Program:
        """Return the program in reverse: it stores the cotangents of the rows read, given those of the rows stored."""
        outputs = [(value, ex.row_of_block(COTANGENT + row)) for row, value in self.stores.items()]
        return Program(ex.pulled_back(outputs, self.reads))

    def run(self, operations: Mapping[str, Callable[..., Any]], values: Mapping[int, Any]) -> dict[int, Any]:
        """Return the program's results, for given meanings of the operations and values of the rows."""
        found: dict[Any, Any] = {}
        for one in self._order:
            if one.operation == "row":
                found[one] = values[int(one.arguments[0])]
            else:
                given = (found[a] if isinstance(a, ex.Number) else a for a in one.arguments)
                found[one] = operations[one.operation](*given)
        return {row: found[v] if isinstance(v, ex.Number) else v for row, v in self.stores.items()}


class Both(NamedTuple):
    """A program and itself in reverse."""

    forward: Program
    pulled: Program


class Programs(NamedTuple):
    """The programs of a control step, and the rows that they are about."""

    begin: Both
    enter: Both  # a simulation step
    stage: Both  # of the Runge-Kutta method
    leave: Both
    end: Both
    inputs: Inputs
    reported: Reported
    stages: Floats  # the inputs `stage` of each stage of each simulation step (n_substeps, 4, 4)
    network: tuple[int, ...]  # rows that are given anew where an event changes the network
    kept: tuple[int, ...]  # rows that go from one control step to the next
    moved: tuple[int, ...]  # rows that go from one simulation step to the next
    staged: tuple[int, ...]  # rows that go from one stage to the next


class _Actions(Actions):
    def __getitem__(self, place: Any) -> Any:
        return self if isinstance(place, slice) else super().__getitem__(place)


class _Series:
    """A series of which the present interval is known alone: its rows, by what an index begins and ends with."""

    def __init__(self, *rows: range | list[int]) -> None:
        self.shape = (1, len(rows[0]), len(rows))
        self._rows = rows

    def __getitem__(self, place: tuple[int, ...]) -> Any:
        return ex.row_of_block(self._rows[place[-1]][place[1] if len(place) == 3 else 0])


class _Table(dict[Any, Any]):
    def __init__(self, *shape: int) -> None:
        super().__init__()
        self.shape = shape


def _rows_behind(layout: Layout, n_action: int, n_observation: int) -> tuple[Inputs, Reported]:
    n_wtg, n_sync = layout.n_wtg, layout.n_sync
    sizes = [n_action, n_wtg, n_wtg, 1, 1, 4, 1, n_sync, 1, 1, 1, N_INFO, n_observation]
    ends = np.cumsum([layout.n_rows, *sizes]).tolist()
    actions, start, end, noise, noise_y, stage, samples, lost, reward, terminated, truncated, info, seen = (
        range(*pair) for pair in itertools.pairwise(ends)
    )
    return (
        Inputs(actions, start, end, noise[0], noise_y[0], stage, samples[0], lost),
        Reported(reward[0], terminated[0], truncated[0], info, seen),
    )


def network_rows(layout: Layout) -> list[int]:
    """Return the rows that follow from the network: its reduction, and which units are connected."""
    rows, noise_z = layout.rows, layout.rows.lane + LANE.noise_z
    connected = (*layout.machine("connected").tolist(), *layout.wtg("connected").tolist())
    return [*range(rows.transfer, rows.extra), noise_z, noise_z + 1, *connected]


@ex.making()
def trace(plant: Plant, task: npt.NDArray[np.void], layout: Layout, n_action: int, n_observation: int) -> Programs:
    """Trace the kernels of a plant and a task."""
    inputs, reported = _rows_behind(layout, n_action, n_observation)
    c, done, row = plant.constants[0], dict[Any, Any](), ex.row_of_block

    def plain(kernel: Any, **names: Any) -> Callable[..., Any]:
        return retargeted(kernel, {**_ARITHMETIC, **names}, {} if names else done)

    def unbranched(kernel: Any, **names: Any) -> Callable[..., Any]:
        return plain(without_branches(kernel), **names)

    combine, rates, move = plain(combine_load_noise), plain(derivatives), plain(advance_stage)
    protect, lose = unbranched(update_status), unbranched(lose_governor)
    enter = plain(enter_interval, int=lambda _: 0)
    given = SimpleNamespace(wind=_Series(inputs.wind_start, inputs.wind_end), noise=_Series([inputs.noise]))

    # The kernel's work before and after the integration.
    before: dict[int, Any] = {}

    def integrate(block: Rows, first_lane: int, _: Plant, data: Any, noise_y: list[Any], lanes: Any) -> None:
        enter(block, 0, c, given, noise_y, lanes)
        block[inputs.noise_y] = noise_y[0]
        before.update(block)
        block.clear()
        combine(block, c, [row(inputs.noise_y)], lanes)
        rates(block, c, 1.0, lanes)

    step = unbranched(step_blocks, advance_interval=integrate, report=lambda *_: None)
    after, rewards = Cells(row), Cells(lambda _: 0.0)
    actions = _Actions(inputs.actions.start, n_action, row)
    step([after], 0, 1, plant, None, task, actions, SimpleNamespace(rewards=rewards), _LANES)
    observations, infos, terminated, truncated = _Table(1, n_observation), [_Table()], _Table(), _Table()
    said = SimpleNamespace(observations=observations, infos=infos, terminated=terminated, truncated=truncated)
    unbranched(report)(after, 0, 0, c, plain(read_task)(task[0]), said, 1)
    after |= {reported.reward: rewards[0]}
    for at, flag in ((reported.terminated, terminated[0]), (reported.truncated, truncated[0])):
        after[at] = ex.select(flag, 1.0, 0.0)
    after |= {reported.info[k]: value for k, value in infos[0].items()}
    after |= {reported.observation[k]: observations[0, k] for k in range(n_observation)}

    entered = Cells(row)
    for machine in range(layout.n_sync):
        if c["machines"][machine]["governor.inv_droop"] > 0.0:
            with where(row(inputs.lost[machine]) > 0.5):
                lose(entered, 0, c, machine, 1)
    combine(entered, c, [row(inputs.noise_y)], _LANES)

    moving, staged = _stages(c, move, inputs)

    def protect_at_samples(block: Cells, c: Any, width: int) -> None:
        with where(row(inputs.samples) > 0.5):
            protect(block, c, width)

    left = Cells(row)
    # The grid is sampled at every step, so that no step carries samples to the next.
    plain(end_step, update_status=protect_at_samples)(left, c, True, _LANES)
    programs = [Program(_changes(stores)) for stores in (before, entered, staged, left, after)]
    return _linked(programs, moving, _stage_times(c, plain), inputs, reported, layout)


def _stage_times(c: Any, plain: Callable[..., Callable[..., Any]]) -> Floats:
    """Return what :class:`Inputs` says of each stage of each simulation step, (n_substeps, 4, 4)."""
    found: list[tuple[float, ...]] = []
    record = plain(
        advance_step, advance_stage=lambda _, c, at, kind, h, lanes: found.append((at, h, kind == FIRST, kind == LAST))
    )
    for k in range(c["n_substeps"]):
        record(None, c, k, _LANES)
    return np.array(found, dtype=np.float64).reshape(c["n_substeps"], 4, 4)


def _stages(c: Any, move: Callable[..., None], inputs: Inputs) -> tuple[list[Program], dict[int, Any]]:
    """Return the first, middle and last stage of the Runge-Kutta method, and what is stored by whichever it is.

    They have one right-hand side: their numbers are the same up to what is made of the rates.
    """
    row = ex.row_of_block
    fraction, ahead, first, last = (row(at) for at in inputs.stage)
    moving: list[Program] = []
    for kind in (FIRST, MIDDLE, LAST):
        block = Rows(row)
        move(block, c, fraction, np.int64(kind), ahead, _LANES)
        moving.append(Program(_changes(block)))
    staged = {}
    for at in {at for program in moving for at in program.stores}:
        of_first, of_middle, of_last = (program.stores.get(at, row(at)) for program in moving)
        staged[at] = ex.select(first > 0.5, of_first, ex.select(last > 0.5, of_last, of_middle))
    return moving, staged


def _changes(stores: Mapping[int, Any]) -> dict[int, Any]:
    """Return the stored rows, without those that keep their value."""
    return {int(at): value for at, value in stores.items() if value is not ex.row_of_block(int(at))}


def _linked(
    given: list[Program], moving: list[Program], stages: Floats, inputs: Inputs, reported: Reported, layout: Layout
) -> Programs:
    """Leave out what nothing depends on, and find which rows go from one program to another."""
    begin, enter, stage, leave, end = given
    network = network_rows(layout)
    outside = {*network, *range(inputs.actions.start, inputs.lost.stop)}
    said = {reported.reward, reported.terminated, reported.truncated, *reported.info, *reported.observation}
    kept, size = {*layout.state_rows.tolist(), layout.lane("status")}, -1
    own = [program.of(()) for program in given]
    exposed = set[int]()
    while sum(len(program.stores) for program in own) + len(kept) > size:
        size = sum(len(program.stores) for program in own) + len(kept)
        own[4] = end.of(said | kept)
        after = own[4].reads | kept | exposed
        own[3] = leave.of(after)
        own[2] = _closed(stage, after | own[3].reads)
        own[1] = enter.of(after | own[3].reads | own[2].reads)
        entered, staged, left = (set(program.stores) for program in own[1:4])
        # Rows that the stages, and a simulation step, read before they store them.
        first, middle, last = (program.of(staged) for program in moving)
        of_stages = first.reads | ((middle.reads | last.reads) - set(first.stores))
        exposed = own[1].reads | (of_stages - entered) | (own[3].reads - entered - staged)
        own[0] = begin.of(exposed | own[4].reads | kept)
        begun = set(own[0].stores)
        moved = (entered | staged | left) & (exposed | own[4].reads | kept)
        kept |= own[0].reads | (exposed - begun) | (own[4].reads - begun - moved)
        kept -= outside
    kept_rows, moved_rows, staged_rows = (tuple(sorted(each)) for each in (kept, moved, staged))
    both = [Both(program, program.pulled()) for program in own]
    return Programs(
        begin=both[0],
        enter=both[1],
        stage=both[2],
        leave=both[3],
        end=both[4],
        inputs=inputs,
        reported=reported,
        stages=stages,
        network=tuple(network),
        kept=kept_rows,
        moved=moved_rows,
        staged=staged_rows,
    )


def _closed(program: Program, rows: set[int]) -> Program:
    """Return the program that stores some rows and those of its own that it reads."""
    found = program.of(rows)
    while len(more := program.of(rows | found.reads).stores) > len(found.stores):
        found = program.of(more)
    return found
