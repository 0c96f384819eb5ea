"""One step of the task over the lanes of a block: actions, physics, cost, observation, information.

One compiled call does it all: act → the physics' step → charge → measure → observe → end. The systems are in
:mod:`wtg_gym.envs.actions`, :mod:`wtg_gym.envs.charging`, :mod:`wtg_gym.envs.measuring` and
:mod:`wtg_gym.envs.observing`; the kinds of unit in :mod:`wtg_gym.envs.task_units`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from numba.experimental import structref

from wtg_gym.envs.actions import ACT, first_invalid_action
from wtg_gym.envs.charging import CHARGE
from wtg_gym.envs.measuring import MEASURE, START_SENSORS
from wtg_gym.envs.observation import N_MEASURED
from wtg_gym.envs.observing import OBSERVE, end_episode
from wtg_gym.envs.settings import ACTION_MODES, EnvSettings
from wtg_gym.envs.task_records import Info, Task, Weights, n_delayed, rocof_window
from wtg_gym.envs.task_units import ACTING, HISTORY, RING, SENSED, SENSORS, SHIFTS, TASK, WATCHED, WINDOW
from wtg_gym.physics import integration
from wtg_gym.physics.integration import advance_interval
from wtg_gym.physics.kernel_data import LaneData, Plant, structured
from wtg_gym.physics.layout import Floats, Lanes, Layout, Whole
from wtg_gym.physics.plant import Further
from wtg_gym.physics.sensors import N_CHANNELS, noise_key, normal
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law
from wtg_gym.systems.compiled import compiled, inlined
from wtg_gym.systems.programs import NONE, in_one_table
from wtg_gym.systems.systems import count

Observations = npt.NDArray[np.float32]
N_INFO = len(Info._fields)
PROGRAMS = in_one_table(
    *integration.PROGRAMS,
    ACT=ACT,
    CHARGE=CHARGE,
    START_SENSORS=START_SENSORS,
    MEASURE=MEASURE,
    OBSERVE=OBSERVE,
    END=(end_episode,),
)
_act, _charge, _start_sensors, _measure, _observe, _end = (program.function() for program in PROGRAMS)


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
    plant = settings.plant()
    benchmark = settings.benchmark()
    reference = get_law(REFERENCE_STRATEGY, plant.turbine, plant.control)
    weights = settings.cost_weights()
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    n_wtg = len(plant.groups)
    return Task(
        modulates_k=modulates_k,
        modulates_tau=modulates_tau,
        k_authority=benchmark.k_authority * (reference.k_min - reference.k_max),
        k_low=reference.k_max,
        k_span=reference.k_min - reference.k_max,
        share_min=1.0,
        share_nominal=1.0 - plant.control.deloading_nominal,
        share_max=1.0 - plant.control.deloading_limit,
        weights=Weights(*(getattr(weights, name) for name in Weights._fields)),
        control_dt=settings.control_dt,
        nominal_hz=plant.case.frequency_hz,
        n_window=rocof_window(settings.control_dt),
        n_groups=n_wtg,
        n_actions=n_wtg * (modulates_k + modulates_tau),
        n_substeps=round(settings.control_dt / settings.simulation_dt),
        duty_gain=-math.expm1(-settings.control_dt / benchmark.duty_time_s) if benchmark.duty_time_s > 0.0 else 1.0,
    )


def task_of(settings: EnvSettings) -> Further:
    """Return the task's kinds of unit and programs, as a simulator takes them."""
    plant, sensed = settings.plant(), settings.benchmark().sensed
    n_wtg, n_window = len(plant.groups), rocof_window(settings.control_dt)
    privileged = settings.observation_mode == "privileged"
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    has = {
        "modulates k": modulates_k,
        "modulates tau": modulates_tau,
        "exact": not sensed,
        "exact observation": not sensed or privileged,
        "privileged": privileged,
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
            (SHIFTS, "own"): np.arange(n_window),
            (SHIFTS, "next_"): 1 + np.arange(n_window),
            (WINDOW, "oldest_"): np.array([0]),
            (WINDOW, "newest_"): np.array([n_window]),
        },
        programs=PROGRAMS,
        constants={(TASK, "task"): [build_task(settings)]},
        has=[name for name, given in has.items() if given],
    )


class Places(NamedTuple):
    """Where the loops of the task find rows: first ones, and distances from unit to unit; `_s` for those in scratch."""

    modulates_k: bool
    modulates_tau: bool
    n_delayed: int  # measurements that a lane keeps of each group, 0 without sensors
    interval: int
    cost: int
    active: int
    status: int
    was_active_s: int
    info_s: int
    wanted_s: int
    wanted_step: int
    seed: int
    delay: int
    ring: int
    noise_s: int
    noise_step: int
    seen_s: int
    seen_step: int
    shown_s: int
    shown_step: int


class TaskData(NamedTuple):
    """What the loops of the task read."""

    places: npt.NDArray[np.void]  # (1,), of Places
    observed: Whole  # rows of the observation's entries in scratch (n_observation,)


def task_data(settings: EnvSettings, layout: Layout) -> TaskData:
    """Return where the loops of the task find rows."""

    def first(kind: Any, part: str) -> int:
        rows = layout.first_rows(kind, part)
        return int(rows[0]) if rows.size else 0

    def step(kind: Any, part: str) -> int:
        rows = layout.first_rows(kind, part)
        return int(rows[1] - rows[0]) if rows.size > 1 else 0

    sensed = settings.benchmark().sensed
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    places = Places(
        modulates_k=modulates_k,
        modulates_tau=modulates_tau,
        n_delayed=n_delayed(settings.control_dt) if sensed else 0,
        interval=first(TASK, "interval"),
        cost=first(TASK, "cost"),
        active=layout.lane("active"),
        status=layout.lane("status"),
        was_active_s=first(TASK, "was_active"),
        info_s=first(TASK, "info"),
        wanted_s=first(ACTING, "wanted"),
        wanted_step=step(ACTING, "wanted"),
        seed=first(SENSORS, "sensor_input"),
        delay=first(SENSORS, "sensor_input") + 1,
        ring=first(RING, "measurement"),
        noise_s=first(SENSED, "noise"),
        noise_step=step(SENSED, "noise"),
        seen_s=first(SENSED, "seen"),
        seen_step=step(SENSED, "seen"),
        shown_s=first(SENSED, "shown"),
        shown_step=step(SENSED, "shown"),
    )
    return TaskData(structured(Places, [places]), observed_rows(settings, layout))


def observed_rows(settings: EnvSettings, layout: Layout) -> Whole:
    """Return the rows of the observation's entries in scratch, in the order of their names."""
    sensed, privileged = settings.benchmark().sensed, settings.observation_mode == "privileged"
    rows: list[int] = []

    def add(kind: Any, part: str, unit: int) -> None:
        first = int(layout.first_rows(kind, part)[unit])
        rows.extend(range(first, first + count(kind.scratch[part])))

    for j in range(layout.n_wtg):
        add(SENSED, "shown", j) if sensed else add(ACTING, "observed", j)
        actions = int(layout.first_rows(ACTING, "shown_actions")[j])
        rows += [actions + i for i, used in enumerate(ACTION_MODES[settings.action_mode]) if used]
    if privileged:
        for j in range(layout.n_wtg if sensed else 0):
            add(ACTING, "observed", j)
            add(SENSED, "shown_duty", j)
        for i in range(layout.n_sync):
            add(WATCHED, "machine_observed", i)
        add(TASK, "grid_observed", 0)
    return np.array(rows, dtype=np.int64)


@inlined
def read_actions(scratch: Floats, actions: Floats, first: int, task: TaskData, lanes: Lanes) -> None:
    """Copy the actions of a block's lanes, from row `first` of (n_lanes, n_action) on; padding lanes have none."""
    places, width = task.places[0], len(lanes)
    n_action = int(places["modulates_k"]) + int(places["modulates_tau"])
    for j in range(actions.shape[1] // max(n_action, 1)):
        row = places["wanted_s"] + j * places["wanted_step"]
        for x in range(width):
            known = first + x < actions.shape[0]
            if places["modulates_k"]:
                scratch[row * width + x] = actions[first + x, j * n_action] if known else 0.0
            if places["modulates_tau"]:
                scratch[(row + 1) * width + x] = actions[first + x, (j + 1) * n_action - 1] if known else 0.0


@inlined
def draw_noise(block: Floats, scratch: Floats, task: TaskData, n_wtg: int, lanes: Lanes) -> None:
    """Draw the random numbers of the present interval's measurements."""
    places, width = task.places[0], len(lanes)
    for x in range(width):
        key = noise_key(int(block[places["seed"] * width + x]), int(block[places["interval"] * width + x]))
        for j in range(n_wtg):
            for channel in range(N_CHANNELS):
                row = places["noise_s"] + j * places["noise_step"] + channel
                scratch[row * width + x] = normal(key, j * N_CHANNELS + channel)


@inlined
def pass_ring(block: Floats, scratch: Floats, task: TaskData, n_wtg: int, lanes: Lanes) -> None:
    """Keep what is measured now, and show the newest measurement that has arrived.

    The ring turns by a place per interval; lanes stand at different intervals.
    """
    places, width, n_delayed = task.places[0], len(lanes), task.places[0]["n_delayed"]
    for x in range(width):
        interval = block[places["interval"] * width + x]
        newest = int(interval) % n_delayed * n_wtg
        arrived = int(max(interval - block[places["delay"] * width + x], 0.0)) % n_delayed * n_wtg
        for j in range(n_wtg):
            for k in range(N_MEASURED):
                seen, shown = places["seen_s"] + j * places["seen_step"], places["shown_s"] + j * places["shown_step"]
                kept = (places["ring"] + (newest + j) * N_MEASURED + k) * width + x
                block[kept] = scratch[(seen + k) * width + x]
                old = (places["ring"] + (arrived + j) * N_MEASURED + k) * width + x
                scratch[(shown + k) * width + x] = block[old]


@compiled
def start_tasks(
    rows: Floats,
    scratch: Floats,
    plant: Plant,
    task: TaskData,
    observations: Observations,
    infos: Floats,
    lanes: Lanes,
) -> None:
    """Take the first measurements, observations and information of prepared episodes.

    Args:
        rows: of the episodes, one lane each (n, n_rows).
        scratch: (n_scratch,).
        plant, task: constants.
        observations, infos: take what each episode begins with (n, n_observation), (n, N_INFO).
        lanes: of length one.
    """
    n_wtg = plant.share.shape[0]
    for start in range(rows.shape[0]):
        block = rows[start]
        if task.places[0]["n_delayed"] > 0:
            draw_noise(block, scratch, task, n_wtg, lanes)
            _start_sensors(block, scratch, plant.tables, NONE, lanes)
            pass_ring(block, scratch, task, n_wtg, lanes)
        _observe(block, scratch, plant.tables, NONE, lanes)
        for k in range(task.observed.shape[0]):
            observations[start, k] = scratch[task.observed[k]]
        for k in range(N_INFO):
            infos[start, k] = scratch[task.places[0]["info_s"] + k]


@inlined
def _step(
    blocks: Floats,
    scratch: Floats,
    first: int,
    last: int,
    plant: Plant,
    data: LaneData,
    task: TaskData,
    actions: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Step blocks: see :func:`step_blocks`."""
    n_wtg, tables = plant.share.shape[0], plant.tables
    for b in range(first, last):
        block = blocks[b]
        read_actions(scratch, actions, b * len(lanes), task, lanes)
        _act(block, scratch, tables, NONE, lanes)
        advance_interval(block, scratch, b * len(lanes), plant, data, lanes)
        _charge(block, scratch, tables, NONE, lanes)
        if task.places[0]["n_delayed"] > 0:
            draw_noise(block, scratch, task, n_wtg, lanes)
            _measure(block, scratch, tables, NONE, lanes)
            pass_ring(block, scratch, task, n_wtg, lanes)
        _observe(block, scratch, tables, NONE, lanes)
        _end(block, scratch, tables, NONE, lanes)
        _report(block, scratch, b * len(lanes), task, outputs, lanes)


@compiled
def step_blocks(
    blocks: Floats,
    scratch: Floats,
    first: int,
    last: int,
    plant: Plant,
    data: LaneData,
    task: TaskData,
    actions: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Apply actions, advance one control interval, observe and charge, for the lanes of blocks first … last - 1.

    Args:
        blocks: (n_blocks, n_rows · width).
        scratch: (n_scratch · width), of the caller's thread.
        plant, data: as for :func:`~wtg_gym.physics.integration.advance_interval`.
        task: see :func:`task_data`.
        actions: (n_lanes, n_action), finite; clipped to [-1, 1] here.
        outputs: written for running lanes; the reward is 0 for those that had ended.
        lanes: a tuple as long as a block is wide.
    """
    _step(blocks, scratch, first, last, plant, data, task, actions, outputs, lanes)


@inlined
def _report(block: Floats, scratch: Floats, first: int, task: TaskData, outputs: Outputs, lanes: Lanes) -> None:
    """Copy what the lanes of a block, from `first` on, have observed, and say whether their episodes are over."""
    places, width = task.places[0], len(lanes)
    for x in range(min(width, outputs.rewards.shape[0] - first)):
        lane = first + x
        outputs.rewards[lane] = 0.0
        if scratch[places["was_active_s"] * width + x] > 0.5:
            outputs.rewards[lane] = -block[places["cost"] * width + x]
            for k in range(task.observed.shape[0]):
                outputs.observations[lane, k] = scratch[task.observed[k] * width + x]
            for k in range(N_INFO):
                outputs.infos[lane, k] = scratch[(places["info_s"] + k) * width + x]
            failed = block[places["status"] * width + x] != 0.0
            outputs.terminated[lane] = failed
            outputs.truncated[lane] = not failed and block[places["active"] * width + x] < 0.5


# A call into compiled code unpacks every array that it is given, which takes a third as long as the step of one
# environment. Bound to one object, they are unpacked once.


@structref.register
class _BoundType(numba.types.StructRef):  # type: ignore[misc]
    """The compiler's type of :class:`Bound`."""

    def preprocess_fields(self, fields: Any) -> Any:
        return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)


class Bound(structref.StructRefProxy):  # type: ignore[misc]
    """The arguments of :func:`step_blocks` for one lane, in one object; :func:`bind` makes it."""


structref.define_proxy(Bound, _BoundType, ["blocks", "scratch", "plant", "data", "task", "outputs"])


# The constructor that numba makes for `Bound` is not kept on disk: each process would compile it anew.
@compiled
def bind(blocks: Floats, scratch: Floats, plant: Plant, data: LaneData, task: TaskData, outputs: Outputs) -> Any:
    """Return the arguments of :func:`step_blocks` for one lane in one object."""
    return Bound(blocks, scratch, plant, data, task, outputs)


def can_bind() -> bool:
    """Return whether arguments can be bound: not where numba is switched off."""
    return not numba.config.DISABLE_JIT


@compiled
def step_bound(bound: Any, actions: Floats, lanes: Lanes) -> int:
    """Step with actions (1, n_action); return -1, or the lane of an action that is not finite and does nothing."""
    invalid = first_invalid_action(actions)
    if invalid < 0:
        _step(bound.blocks, bound.scratch, 0, 1, bound.plant, bound.data, bound.task, actions, bound.outputs, lanes)
    return invalid
