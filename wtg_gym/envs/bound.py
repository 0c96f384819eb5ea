"""The step of a single environment with its arguments bound beforehand.

A call into compiled code unpacks every array that it is given. For one environment that takes a third as long as the
step itself, so its arrays are handed over once, as addresses; the kernel is the same :func:`step_blocks`.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic

from wtg_gym.envs.task import Outputs, Task, first_invalid_action, step_blocks
from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.layout import Floats, LaneData, Lanes, Plant


@intrinsic
def _pointer(typing_context: Any, address: Any) -> Any:
    """Turn an address into a pointer."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.int64), code


class BoundStep:
    """A step of one lane that only takes an action.

    Args:
        blocks, plant, data, task, outputs, lanes: as for :func:`step_blocks`, of a single lane.

    The arrays must stay where they are: whoever replaces one makes a new object. They are kept alive here.
    """

    def __init__(
        self, blocks: Floats, plant: Plant, data: LaneData, task: Task, outputs: Outputs, lanes: Lanes
    ) -> None:
        self._alive = (blocks, plant, data, task, outputs)
        arrays = [blocks, *plant[2:15], *data, task.weights, *outputs]
        for array in arrays:
            if not array.flags.c_contiguous or not array.flags.aligned:
                raise ValueError("a kernel's arrays must be contiguous")
        entries = [(array.__array_interface__["data"][0], *array.shape) for array in arrays]
        self._handles = np.array([value for entry in entries for value in entry], dtype=np.int64)
        constants = (plant.slack, plant.angular_frequency, plant.base_mva, plant.simulation_dt, plant.n_substeps)
        numbers = [*constants, plant.trips_groups, *(value for value in task if value is not task.weights)]
        self._numbers = np.array(numbers, dtype=np.float64)
        self._tuples = plant.syncs, plant.wtgs, lanes

    def __call__(self, actions: Floats) -> int:
        """Step with actions (1, n_action); return -1, or the lane of an action that is not finite and does nothing."""
        invalid: int = _step(self._handles, self._numbers, actions, *self._tuples)
        return invalid


def can_bind() -> bool:
    """Return whether addresses can be bound: not where numba is switched off."""
    return not numba.config.DISABLE_JIT


@compiled
def _step(
    handles: npt.NDArray[np.int64],
    numbers: Floats,
    actions: Floats,
    syncs: tuple[int, ...],
    wtgs: tuple[int, ...],
    lanes: Lanes,
) -> int:
    # In the order in which BoundStep writes them: address, then shape.
    h = handles
    blocks = carray(_pointer(h[0]), (h[1], h[2]), np.float64)
    plant = Plant(
        syncs,
        wtgs,
        carray(_pointer(h[3]), (h[4], h[5]), np.float64),
        carray(_pointer(h[6]), (h[7],), np.float64),
        carray(_pointer(h[8]), (h[9],), np.float64),
        carray(_pointer(h[10]), (h[11],), np.int64),
        carray(_pointer(h[12]), (h[13],), np.complex128),
        carray(_pointer(h[14]), (h[15],), np.int64),
        carray(_pointer(h[16]), (h[17],), np.int64),
        carray(_pointer(h[18]), (h[19], h[20]), np.complex128),
        carray(_pointer(h[21]), (h[22],), np.complex128),
        carray(_pointer(h[23]), (h[24],), np.complex128),
        carray(_pointer(h[25]), (h[26],), np.float64),
        carray(_pointer(h[27]), (h[28],), np.bool_),
        carray(_pointer(h[29]), (h[30],), np.float64),
        int(numbers[0]),
        numbers[1],
        numbers[2],
        numbers[3],
        int(numbers[4]),
        numbers[5] != 0.0,
    )
    data = LaneData(
        carray(_pointer(h[31]), (h[32], h[33], h[34]), np.float64),
        carray(_pointer(h[35]), (h[36], h[37]), np.float64),
        carray(_pointer(h[38]), (h[39],), np.int64),
        carray(_pointer(h[40]), (h[41], h[42]), np.complex128),
        carray(_pointer(h[43]), (h[44], h[45], h[46]), np.float64),
    )
    task = Task(
        numbers[6] != 0.0,
        numbers[7] != 0.0,
        numbers[8] != 0.0,
        numbers[9],
        numbers[10],
        numbers[11],
        numbers[12],
        numbers[13],
        numbers[14],
        carray(_pointer(h[47]), (h[48],), np.float64),
        numbers[15],
        numbers[16],
        int(numbers[17]),
        int(numbers[18]),
    )
    outputs = Outputs(
        carray(_pointer(h[49]), (h[50], h[51]), np.float32),
        carray(_pointer(h[52]), (h[53],), np.float64),
        carray(_pointer(h[54]), (h[55], h[56]), np.float64),
        carray(_pointer(h[57]), (h[58],), np.bool_),
        carray(_pointer(h[59]), (h[60],), np.bool_),
    )
    invalid = first_invalid_action(actions)
    if invalid < 0:
        step_blocks(blocks, 0, 1, plant, data, task, actions, outputs, lanes)
    return invalid


__all__ = ["BoundStep", "can_bind"]
