"""One step of the task over the lanes of a block: actions, physics, cost, observation, information.

One compiled call does it all. The loops around the equations are in :mod:`wtg_gym.envs.actions`,
:mod:`wtg_gym.envs.charging`, :mod:`wtg_gym.envs.measuring` and :mod:`wtg_gym.envs.observing`; the records are in
:mod:`wtg_gym.envs.task_records`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from numba.experimental import structref

from wtg_gym.envs.actions import apply_actions, first_invalid_action
from wtg_gym.envs.charging import charge
from wtg_gym.envs.measuring import measure, start_sensors
from wtg_gym.envs.observing import observe
from wtg_gym.envs.settings import ACTION_MODES, EnvSettings
from wtg_gym.envs.task_records import (
    N_GROUP_ROWS,
    TASK,
    GroupRows,
    Info,
    Task,
    Weights,
    load_terms,
    n_delayed,
    parts_of,
    read_task,
    rocof_window,
    store_group,
    store_info,
)
from wtg_gym.systems.compiled import compiled, inlined
from wtg_gym.physics.integration import advance_interval
from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import LANE, WTG, Floats, Lanes, load_wtg_input, load_wtg_state, rows_of, wtg_row
from wtg_gym.systems.records import dtype, flatten
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law

Observations = npt.NDArray[np.float32]


N_INFO = len(Info._fields)


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


def build_task(settings: EnvSettings) -> npt.NDArray[np.void]:
    """Return the task's constants (1,): the numbers of :class:`~wtg_gym.envs.task_records.Task`, and "sensed".

    That part takes no space in a task without sensors, whose code then falls away where it is compiled.
    """
    plant = settings.plant()
    benchmark = settings.benchmark()
    sensed = benchmark.sensed
    reference = get_law(REFERENCE_STRATEGY, plant.turbine, plant.control)
    weights = settings.cost_weights()
    modulates_k, modulates_tau = ACTION_MODES[settings.action_mode]
    task = Task(
        modulates_k=modulates_k,
        modulates_tau=modulates_tau,
        privileged=settings.observation_mode == "privileged",
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
        n_delayed=n_delayed(settings.control_dt) if sensed else 0,
        duty_gain=-math.expm1(-settings.control_dt / benchmark.duty_time_s) if benchmark.duty_time_s > 0.0 else 1.0,
    )
    own = dtype(Task)
    parts = [(name, own[name]) for name in own.names or ()]
    constants = np.zeros(1, dtype=np.dtype([*parts, ("sensed", np.int64, (int(sensed),))], align=True))
    for name, value in zip(own.names or (), flatten(task), strict=True):
        constants[name] = value
    return constants


@compiled
def start_tasks(
    blocks: Floats,
    starting: npt.NDArray[np.int64],
    plant: Plant,
    task: npt.NDArray[np.void],
    end_steps: Floats,
    sensors: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Reset the task's rows of freshly started lanes and write their first observation and information.

    Args:
        blocks, plant, task, outputs, lanes: as for :func:`step_blocks`.
        starting: the lanes (n,).
        end_steps: simulation step at which each episode is over (n,).
        sensors: numbers of :class:`~wtg_gym.physics.sensors.SensorInput` of each episode, then the bias of the wind of
            each WTG group, then the step at which an event disconnects it (n, any number); unused without sensors.
    """
    c, t = plant.constants[0], read_task(task[0])
    sensed = task[0]["sensed"].shape[0] > 0
    width, parts = len(lanes), parts_of(c, t)
    for start in range(starting.shape[0]):
        lane = starting[start]
        block, x = blocks[lane // width], lane % width
        for row in range(parts.lane, block.shape[0] // width):
            block[row * width + x] = 0.0
        block[(parts.lane + TASK.end_step) * width + x] = end_steps[start]
        for row in range(parts.history, parts.groups):
            block[row * width + x] = 1.0
        for j in range(c["share"].shape[0]):
            o = wtg_row(c, j) * width + x
            inv_tau = load_wtg_input(block, o + WTG.input * width, width).law.inv_tau
            speed = load_wtg_state(block, o, width).converter.speed
            group = GroupRows(inv_tau, speed, 0.0, 0.0, 0.0, 0.0, 0.0)
            store_group(group, block, (parts.groups + j * N_GROUP_ROWS) * width + x, width)
        if sensed:
            start_sensors(block, x, c, t, sensors[start], lanes)
        outputs.rewards[lane] = 0.0
        observe(block, c, t, sensed, lanes)
        report(block, x, lane, c, t, outputs, width)


@compiled
def step_blocks(
    blocks: Floats,
    first: int,
    last: int,
    plant: Plant,
    data: LaneData,
    task: npt.NDArray[np.void],
    actions: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Apply actions, advance one control interval, observe and charge, for the lanes of blocks first … last - 1.

    Args:
        blocks: (n_blocks, n_rows · width).
        plant, data: as for :func:`~wtg_gym.physics.integration.advance_interval`.
        task: constants (1,), see :func:`build_task`.
        actions: (n_lanes, n_action), finite; clipped to [-1, 1] here.
        outputs: written for running lanes; the reward is 0 for those that had ended.
        lanes: a tuple as long as a block is wide.
    """
    c, t = plant.constants[0], read_task(task[0])
    sensed = task[0]["sensed"].shape[0] > 0
    width = len(lanes)
    noise_y, keys = np.empty(width), np.empty(width, dtype=np.int64)
    parts, own = parts_of(c, t), rows_of(c).lane
    n_lanes = actions.shape[0]
    for b in range(first, last):
        block = blocks[b]
        count = min(width, n_lanes - b * width)
        apply_actions(block, c, t, actions[b * width : b * width + count], lanes)
        for x in range(width):
            block[(parts.lane + TASK.was_active) * width + x] = block[(own + LANE.active) * width + x]
        advance_interval(block, b * width, plant, data, noise_y, lanes)
        charge(block, c, t, sensed, lanes)
        if sensed:
            measure(block, c, t, keys, lanes)
        observe(block, c, t, sensed, lanes)
        for x in range(count):
            lane = b * width + x
            outputs.rewards[lane] = 0.0
            if block[(parts.lane + TASK.was_active) * width + x] > 0.5:
                outputs.rewards[lane] = -block[(parts.lane + TASK.cost) * width + x]
                # A lane at its end stands still until it is started again.
                if block[(own + LANE.step) * width + x] >= block[(parts.lane + TASK.end_step) * width + x] - 0.5:
                    block[(own + LANE.active) * width + x] = 0.0
                report(block, x, lane, c, t, outputs, width)


@inlined
def report(block: Floats, x: int, lane: int, c: Any, task: Task, outputs: Outputs, width: int) -> None:
    """Copy a lane's observation and the numbers of its `info`, and say whether its episode is over."""
    parts = parts_of(c, task)
    own, of_task = rows_of(c).lane * width + x, parts.lane * width + x
    for k in range(outputs.observations.shape[1]):
        outputs.observations[lane, k] = block[(parts.observation + k) * width + x]
    terms = load_terms(block, of_task + TASK.terms * width, width)
    info = Info(
        time_s=block[own + LANE.step * width] * c["simulation_dt"],
        frequency_hz=task.nominal_hz * block[own + LANE.coi * width],
        rocof_hz_s=block[of_task + TASK.rocof * width],
        cost=block[of_task + TASK.constraint * width],
        cost_frequency=terms.frequency,
        cost_rocof=terms.rocof,
        cost_duty=terms.duty,
        cost_rotor=terms.rotor,
        cost_overload=terms.overload,
        cost_effort=terms.effort,
        cost_failure=terms.failure,
    )
    store_info(info, outputs.infos[lane], 0, 1)
    failed = block[own + LANE.status * width] != 0.0
    outputs.terminated[lane] = failed
    outputs.truncated[lane] = not failed and block[own + LANE.active * width] < 0.5


# A call into compiled code unpacks every array that it is given, which takes a third as long as the step of one
# environment. Bound to one object, they are unpacked once.


@structref.register
class _BoundType(numba.types.StructRef):  # type: ignore[misc]
    """The compiler's type of :class:`Bound`."""

    def preprocess_fields(self, fields: Any) -> Any:
        return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)


class Bound(structref.StructRefProxy):  # type: ignore[misc]
    """The arguments of :func:`step_blocks` for one lane, in one object; :func:`bind` makes it."""


structref.define_proxy(Bound, _BoundType, ["blocks", "plant", "data", "task", "outputs"])


# The constructor that numba makes for `Bound` is not kept on disk: each process would compile it anew.
@compiled
def bind(blocks: Floats, plant: Plant, data: LaneData, task: Any, outputs: Outputs) -> Any:
    """Return the arguments of :func:`step_blocks` for one lane in one object."""
    return Bound(blocks, plant, data, task, outputs)


def can_bind() -> bool:
    """Return whether arguments can be bound: not where numba is switched off."""
    return not numba.config.DISABLE_JIT


@compiled
def step_bound(bound: Any, actions: Floats, lanes: Lanes) -> int:
    """Step with actions (1, n_action); return -1, or the lane of an action that is not finite and does nothing."""
    invalid = first_invalid_action(actions)
    if invalid < 0:
        step_blocks(bound.blocks, 0, 1, bound.plant, bound.data, bound.task, actions, bound.outputs, lanes)
    return invalid
