"""One step of the task over the lanes of a block: actions, physics, cost, observation, information.

One compiled call does it all: act → the physics' step → charge → measure → observe → end. The systems are in
:mod:`wtg_gym.envs.actions`, :mod:`wtg_gym.envs.cost`, :mod:`wtg_gym.envs.measuring` and
:mod:`wtg_gym.envs.observation`; the kinds of unit in :mod:`wtg_gym.envs.task_units`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from numba.experimental import structref

from wtg_gym.envs.actions import ACT
from wtg_gym.envs.cost import CHARGE
from wtg_gym.envs.measuring import MEASURE, START_SENSORS
from wtg_gym.envs.observation import OBSERVE, end_episode
from wtg_gym.envs.settings import ACTION_MODES, EnvSettings
from wtg_gym.envs.task_records import Info, LocalInfo, Reach, Task, Weights, n_delayed, rocof_window
from wtg_gym.envs.task_units import ACTING, HISTORY, RING, SENSED, SENSORS, SHIFTS, TASK, WATCHED, WINDOW
from wtg_gym.physics import integration
from wtg_gym.physics.grid import DEFAULT_GRID
from wtg_gym.physics.integration import advance_interval
from wtg_gym.physics.kernel_data import LaneData, Network
from wtg_gym.physics.layout import Floats, Layout, Whole
from wtg_gym.physics.plant import Further
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, group_laws
from wtg_gym.systems.compiled import compiled, internal
from wtg_gym.systems.programs import NONE, in_one_table
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import Kind, count

#: Share of the load that the torque of the machines is counted in on other grids than the IEEE 14-bus system, where it
#: is 100 MVA.
_TORQUE_SHARE = 0.39
Observations = npt.NDArray[np.float32]
N_INFO = len(Info._fields) + len(LocalInfo._fields)
PROGRAMS = in_one_table(
    *integration.PROGRAMS,
    ACT=ACT,
    CHARGE=CHARGE,
    START_SENSORS=START_SENSORS,
    MEASURE=MEASURE,
    OBSERVE=OBSERVE,
    END=(end_episode,),
)
_ACT, _CHARGE, _START_SENSORS, _MEASURE, _OBSERVE, _END = map(Routine, PROGRAMS)
_act, _charge, _measure, _observe, _end, _start_sensors = (
    routine.call for routine in (_ACT, _CHARGE, _MEASURE, _OBSERVE, _END, _START_SENSORS)
)


class Outputs(NamedTuple):
    """Outputs of a step, one row per lane."""

    observations: Observations  # (n_lanes, n_observation)
    rewards: Floats  # (n_lanes,), 0 for a lane that had ended
    infos: Floats  # (n_lanes, N_INFO)
    terminated: npt.NDArray[np.bool_]  # (n_lanes,)
    truncated: npt.NDArray[np.bool_]  # (n_lanes,)


def new_outputs(n_lanes: int, n_observation: int) -> Outputs:
    """Return outputs of zeros."""
    flags = (np.zeros(n_lanes, dtype=np.bool_) for _ in range(2))
    observations = np.zeros((n_lanes, n_observation), dtype=np.float32)
    return Outputs(observations, np.zeros(n_lanes), np.zeros((n_lanes, N_INFO)), *flags)


def build_task(settings: EnvSettings) -> Task:
    """Return the constants of the task."""
    plant = settings.resolved_plant
    benchmark = settings.benchmark
    weights = settings.cost_weights()
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    n_wtg, of_ieee14 = len(plant.groups), settings.resolved_suite.grid == DEFAULT_GRID
    return Task(
        modulates_k=modulates_k,
        modulates_tau=modulates_tau,
        share_min=1.0,
        share_nominal=1.0 - plant.control.deloading_nominal,
        share_max=1.0 - plant.control.deloading_limit,
        weights=Weights(*(getattr(weights, name) for name in Weights._fields)),
        control_dt=settings.control_dt,
        nominal_hz=plant.case.frequency_hz,
        inv_load=plant.case.base_mva / max(plant.case.load_mw, 1e-6),
        inv_torque=1.0 if of_ieee14 else plant.case.base_mva / max(_TORQUE_SHARE * plant.case.load_mw, 1e-6),
        n_window=rocof_window(settings.control_dt),
        n_groups=n_wtg,
        n_actions=n_wtg * (modulates_k + modulates_tau),
        n_substeps=round(settings.control_dt / plant.simulation_dt),
        duty_gain=-math.expm1(-settings.control_dt / benchmark.duty_time_s) if benchmark.duty_time_s > 0.0 else 1.0,
    )


def reaches_of(settings: EnvSettings) -> list[Reach]:
    """Return what each group's turbine decides."""
    plant, authority = settings.resolved_plant, settings.benchmark.k_authority
    laws = group_laws(REFERENCE_STRATEGY, plant.turbines, plant.control)
    return [Reach(authority * (law.k_min - law.k_max), law.k_max, law.k_min - law.k_max) for law in laws]


def task_of(settings: EnvSettings) -> Further:
    """Return the task's kinds of unit and programs, as a simulator takes them."""
    plant, sensed = settings.resolved_plant, settings.benchmark.sensed
    n_wtg, n_window = len(plant.groups), rocof_window(settings.control_dt)
    privileged = settings.observation_mode == "privileged"
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    has = {
        "modulates k": modulates_k,
        "modulates tau": modulates_tau,
        "exact observation": not sensed or privileged,
        "privileged": privileged,
        "charges worst": settings.benchmark.charges_worst,
        "charges capped": not settings.benchmark.charges_worst,
    }
    return Further(
        n_units={
            TASK: 1,
            HISTORY: n_window + 1,
            SHIFTS: n_window,
            WINDOW: 1,
            ACTING: n_wtg,
            WATCHED: len(plant.case.machines),
            SENSORS: int(sensed),
            SENSED: n_wtg * sensed,
            RING: n_wtg * n_delayed(settings.control_dt) * sensed,
        },
        links={
            (SHIFTS, "this_"): np.arange(n_window),
            (SHIFTS, "next_"): 1 + np.arange(n_window),
            (WINDOW, "oldest_"): np.array([0]),
            (WINDOW, "newest_"): np.array([n_window]),
        },
        programs=PROGRAMS,
        stepping=(_ACT, _CHARGE, _MEASURE, _OBSERVE, _END),
        starting=(_START_SENSORS, _OBSERVE),
        constants={
            (TASK, "task"): [build_task(settings)],
            (ACTING, "reach"): reaches_of(settings),
            (SENSED, "group_number"): range(n_wtg),
        },
        has=[name for name, given in has.items() if given],
    )


class TaskData(NamedTuple):
    """Where the loops of the task find rows: in scratch, but for the last three."""

    wanted: Whole  # actions (n_action,)
    observed: Whole  # entries of the observation (n_observation,)
    info: int  # the first of N_INFO
    was_active: int
    cost: int
    active: int
    status: int


def task_data(settings: EnvSettings, layout: Layout) -> TaskData:
    """Return where the loops of the task find rows."""

    def rows(kind: Kind, part: str) -> Whole:
        """Return all rows of a part of every unit (n_units, n)."""
        return layout.first_rows(kind, part)[:, np.newaxis] + np.arange(count({**kind.rows, **kind.scratch}[part]))

    def first(kind: Kind, part: str) -> int:
        """Return the first row of a part of the first unit; 0 where there is none."""
        return int(layout.first_rows(kind, part)[:1].sum())

    sensed = settings.benchmark.sensed
    modulated = np.array(ACTION_MODES[settings.action_mode])
    exact, shown, actions = rows(ACTING, "observed"), rows(SENSED, "shown"), rows(ACTING, "shown_actions")[:, modulated]
    # In the order of their names: see observation_names.
    parts = [own for j in range(layout.n_wtg) for own in ((shown if sensed else exact)[j], actions[j])]
    if settings.observation_mode == "privileged":
        if sensed:
            parts += [own for j in range(layout.n_wtg) for own in (exact[j], rows(SENSED, "shown_duty")[j])]
        parts += [rows(WATCHED, "machine_observed").ravel(), rows(TASK, "grid_observed")[0]]
    for own in settings.resolved_plant.further:
        parts += [] if own.shown is None else [rows(own.kind, own.shown).ravel()]
    return TaskData(
        wanted=rows(ACTING, "wanted")[:, modulated].ravel(),
        observed=np.concatenate([np.zeros(0, dtype=np.int64), *parts]),
        info=first(TASK, "info"),
        was_active=first(TASK, "was_active"),
        cost=first(TASK, "cost"),
        active=layout.lane("active"),
        status=layout.lane("status"),
    )


@internal
def read_actions(scratch: Floats, actions: Floats, first: int, task: TaskData) -> int:
    """Copy the actions of a block's lanes, from row `first` of (n_lanes, n_action) on; padding lanes have none.

    Returns:
        the first lane with an action that is not finite, or -1.
    """
    invalid = -1
    for a in range(task.wanted.shape[0]):
        for x in range(scratch.shape[1]):
            action = actions[first + x, a] if first + x < actions.shape[0] else 0.0
            if not math.isfinite(action) and (invalid < 0 or first + x < invalid):
                invalid = first + x
            scratch[task.wanted[a], x] = action
    return invalid


@internal
def _report(block: Floats, scratch: Floats, first: int, task: TaskData, outputs: Outputs) -> None:
    """Copy what the lanes of a block, from `first` on, have observed, and say whether their episodes are over."""
    for x in range(min(block.shape[1], outputs.rewards.shape[0] - first)):
        lane = first + x
        outputs.rewards[lane] = 0.0
        if scratch[task.was_active, x] > 0.5:
            outputs.rewards[lane] = -block[task.cost, x]
            for k in range(task.observed.shape[0]):
                outputs.observations[lane, k] = scratch[task.observed[k], x]
            for k in range(N_INFO):
                outputs.infos[lane, k] = scratch[task.info + k, x]
            failed = block[task.status, x] != 0.0
            outputs.terminated[lane] = failed
            outputs.truncated[lane] = not failed and block[task.active, x] < 0.5


# A call into compiled code unpacks every array that it is given, which takes a third as long as the step of one
# environment. Bound to one object, they are unpacked once.


@structref.register
class _BoundType(numba.types.StructRef):  # type: ignore[misc]
    """The compiler's type of :class:`Bound`."""

    def preprocess_fields(self, fields: Any) -> Any:
        return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)


class Bound(structref.StructRefProxy):  # type: ignore[misc]
    """The arguments of :func:`step_blocks` that last, in one object; :func:`bind` makes it."""


structref.define_proxy(Bound, _BoundType, ["blocks", "scratches", "network", "data", "task", "outputs"])


# The constructor that numba makes for `Bound` is not kept on disk: each process would compile it anew.
@compiled
def bind(blocks: Floats, scratches: Floats, network: Network, data: LaneData, task: TaskData, outputs: Outputs) -> Any:
    """Return the arguments of :func:`step_blocks` that last.

    Args:
        blocks: (n_blocks, n_rows, width).
        scratches: of each worker (n_workers, n_scratch, width).
        network, data: as for :func:`~wtg_gym.physics.integration.advance_interval`.
        task: see :func:`task_data`.
        outputs: written for running lanes; the reward is 0 for those that had ended.
    """
    return Bound(blocks, scratches, network, data, task, outputs)


@compiled
def step_blocks(bound: Any, actions: Floats, first: int, last: int, worker: int, starts: bool) -> int:
    """Apply actions, advance one control interval, observe and charge, for the lanes of blocks first … last - 1.

    Args:
        bound: see :func:`bind`.
        actions: (n_lanes, n_action), clipped to [-1, 1] here.
        first, last: range of blocks.
        worker: whose scratch is used.
        starts: take the first measurements and observations of prepared episodes instead.

    Returns:
        -1, or the first lane with an action that is not finite: its block and those after it have not been stepped.
    """
    blocks, scratch, network, task = bound.blocks, bound.scratches[worker], bound.network, bound.task
    width, tables = blocks.shape[2], network.tables
    for b in range(first, last):
        block, arrays = blocks[b], (blocks[b], scratch)
        if starts:
            for x in range(width):
                scratch[task.was_active, x] = 1.0
        else:
            invalid = read_actions(scratch, actions, b * width, task)
            if invalid >= 0:
                return invalid
            _act(arrays, tables, NONE)
            advance_interval(block, scratch, b * width, network, bound.data)
            _charge(arrays, tables, NONE)
        if starts:
            _start_sensors(arrays, tables, NONE)
        else:
            _measure(arrays, tables, NONE)
        _observe(arrays, tables, NONE)
        if not starts:
            _end(arrays, tables, NONE)
        _report(block, scratch, b * width, task, bound.outputs)
    return -1
