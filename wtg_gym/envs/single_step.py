"""The step of a single environment with its arguments bound beforehand.

A call into compiled code unpacks every array that it is given, which takes a third as long as the step of one
environment. Bound to one object, they are unpacked once; the kernel is the same :func:`step_blocks`.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.experimental import structref

from wtg_gym.envs.actions import first_invalid_action
from wtg_gym.envs.task import Outputs, step_blocks
from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.lane_data import LaneData
from wtg_gym.physics.layout import Floats, Lanes
from wtg_gym.physics.plant_constants import Plant


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
