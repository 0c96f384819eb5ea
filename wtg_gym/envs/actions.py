"""What an action may be, and how it moves k and τ."""

from __future__ import annotations

import math
import numbers
from typing import Any

import numpy as np

from wtg_gym.envs.task_records import GROUP, N_GROUP_ROWS, Task, parts_of
from wtg_gym.systems.compiled import compiled, inlined
from wtg_gym.systems.elementary import clip
from wtg_gym.physics.layout import WTG_INV_TAU, WTG_K_OFFSET, Floats, Lanes, wtg_row

#: Full action multiplies or divides the damping time constant by this.
TIME_CONSTANT_RATIO = 4.0


@compiled
def first_invalid_action(actions: Floats) -> int:
    """Return the index of the first row (lane) with an action that is not finite, or -1."""
    for lane in range(actions.shape[0]):
        for a in range(actions.shape[1]):
            if not math.isfinite(actions[lane, a]):
                return lane
    return -1


@inlined
def apply_actions(block: Floats, c: Any, task: Task, actions: Floats, lanes: Lanes) -> None:
    """Turn actions (count, n_action) into offsets on k and scales on τ; zero leaves the law to the last bit."""
    width, parts = len(lanes), parts_of(c, task)
    n_action = int(task.modulates_k) + int(task.modulates_tau)
    for x in range(actions.shape[0]):
        for j in range(c["share"].shape[0]):
            o = wtg_row(c, j) * width + x
            g = (parts.groups + j * N_GROUP_ROWS) * width + x
            if task.modulates_k:
                action = clip(actions[x, j * n_action], -1.0, 1.0)
                block[g + GROUP.action_k * width] = action
                block[o + WTG_K_OFFSET * width] = task.k_authority * action
            if task.modulates_tau:
                action = clip(actions[x, j * n_action + n_action - 1], -1.0, 1.0)
                block[g + GROUP.action_tau * width] = action
                scale = TIME_CONSTANT_RATIO**-action
                block[o + WTG_INV_TAU * width] = block[g + GROUP.base_inv_tau * width] * scale


def as_actions(given: Any, shape: tuple[int, ...]) -> Floats:
    """Return actions as floats of a shape; anything but that many real numbers raises a ValueError."""
    if type(given) is np.ndarray and given.dtype == np.float32 and given.shape == shape:
        return given.astype(np.float64, order="C")
    allowed = f"the action must be real numbers in -1 … 1 of shape {shape}"
    try:
        array = np.asarray(given)
        if array.dtype.kind == "O" and all(isinstance(value, numbers.Real) for value in array.flat):
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{allowed}: {error}") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{allowed}, got {array.dtype} values: {given!r:.60}")
    if array.shape != shape:
        raise ValueError(f"{allowed}, got shape {array.shape}")
    return np.ascontiguousarray(array, dtype=np.float64)
