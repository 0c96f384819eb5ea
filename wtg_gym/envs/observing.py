"""The loops of the observation, over the lanes of a block.

The equations are in :mod:`wtg_gym.envs.observation`.
"""

from __future__ import annotations

from typing import Any

from wtg_gym.envs.measuring import show_delayed
from wtg_gym.envs.observation import (
    N_LOCAL,
    N_MACHINE,
    OBSERVATION_BOUND,
    bounded_grid,
    bounded_machine,
    bounded_wtg,
    observe_grid,
    observe_machine,
    observe_wtg,
    store_grid_observation,
    store_machine_observation,
    store_wtg_observation,
)
from wtg_gym.envs.task_records import (
    GROUP,
    N_GROUP_ROWS,
    N_MEASURED,
    N_SENSED_ROWS,
    SENSED,
    TASK,
    Task,
    load_group,
    parts_of,
)
from wtg_gym.systems.compiled import inlined
from wtg_gym.systems.elementary import clip
from wtg_gym.physics.layout import (
    LANE,
    MACHINE,
    N_MACHINE_ROWS,
    WTG,
    Floats,
    Lanes,
    load_machine_output,
    load_machine_state,
    load_wtg_output,
    load_wtg_state,
    read_machine,
    read_turbine,
    rows_of,
    wtg_row,
)


@inlined
def observe(block: Floats, c: Any, task: Task, sensed: bool, lanes: Lanes) -> None:
    """Write the observations of a block's lanes into its rows.

    :func:`~wtg_gym.envs.observation.observation_names` lists their entries.
    """
    width, parts = len(lanes), parts_of(c, task)
    row = parts.observation
    for j in range(c["share"].shape[0]):
        if sensed:
            show_delayed(block, j, c, task, row, lanes)
            row += N_MEASURED
        else:
            _observe_group(block, j, c, task, row, lanes)
            row += N_LOCAL
        g = (parts.groups + j * N_GROUP_ROWS) * width
        if task.modulates_k:
            _copy_row(block, g + GROUP.last_action_k * width, row * width, width)
            row += 1
        if task.modulates_tau:
            _copy_row(block, g + GROUP.last_action_tau * width, row * width, width)
            row += 1
    if task.privileged:
        if sensed:
            for j in range(c["share"].shape[0]):
                _observe_group(block, j, c, task, row, lanes)
                row += N_LOCAL
                for x in range(width):
                    duty = block[(parts.sensed + j * N_SENSED_ROWS + SENSED.mean_duty) * width + x]
                    block[row * width + x] = clip(duty, -OBSERVATION_BOUND, OBSERVATION_BOUND)
                row += 1
        _observe_grid(block, c, task, row, lanes)


@inlined
def _observe_group(block: Floats, j: int, c: Any, task: Task, row: int, lanes: Lanes) -> None:
    """Write the exact observation of WTG group j, which begins at a row."""
    width, parts = len(lanes), parts_of(c, task)
    turbine = read_turbine(c["turbine"])
    o, g = wtg_row(c, j) * width, (parts.groups + j * N_GROUP_ROWS) * width
    for x in range(width):
        output, group = load_wtg_output(block, o + WTG.output * width + x, width), load_group(block, g + x, width)
        seen = observe_wtg(load_wtg_state(block, o + x, width), output, group, turbine, task)
        store_wtg_observation(bounded_wtg(seen, OBSERVATION_BOUND), block, row * width + x, width)


@inlined
def _observe_grid(block: Floats, c: Any, task: Task, row: int, lanes: Lanes) -> None:
    """Write the privileged part of the observations, which begins at a row."""
    width, rows, parts = len(lanes), rows_of(c), parts_of(c, task)
    n_sync = c["machines"].shape[0]
    for i in range(n_sync):
        o, machine = i * N_MACHINE_ROWS * width, read_machine(c["machines"][i])
        for x in range(width):
            state = load_machine_state(block, o + x, width)
            output = load_machine_output(block, o + MACHINE.output * width + x, width)
            seen = observe_machine(state, output, machine, task)
            store_machine_observation(bounded_machine(seen, OBSERVATION_BOUND), block, row * width + x, width)
        row += N_MACHINE
    for x in range(width):
        torque = 0.0
        for i in range(n_sync):
            at = (i * N_MACHINE_ROWS + MACHINE.output) * width + x
            torque += load_machine_output(block, at, width).torque
        coi, rocof = block[(rows.lane + LANE.coi) * width + x], block[(parts.lane + TASK.rocof) * width + x]
        grid = observe_grid(coi, rocof, torque, task)
        store_grid_observation(bounded_grid(grid, OBSERVATION_BOUND), block, row * width + x, width)


@inlined
def _copy_row(block: Floats, source: int, target: int, width: int) -> None:
    for x in range(width):
        block[target + x] = block[source + x]
