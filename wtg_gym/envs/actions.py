"""What an action may be, and how it moves k and τ."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np

from wtg_gym.envs.task_records import Reach
from wtg_gym.envs.task_units import ACTING, TASK
from wtg_gym.physics.layout import Floats
from wtg_gym.systems.elementary import clip
from wtg_gym.systems.systems import system

#: Full action multiplies or divides the damping time constant by this.
TIME_CONSTANT_RATIO = 4.0


@system(ACTING, "action_k", "k_offset", when="modulates k")
def act_on_k(wanted_on_k: float, reach: Reach) -> tuple[float, float]:
    """Turn an action into an offset on k; zero leaves the law to the last bit."""
    action = clip(wanted_on_k, -1.0, 1.0)
    return action, reach.k_authority * action


@system(ACTING, "action_tau", "inv_tau", when="modulates tau")
def act_on_tau(wanted_on_tau: float, base_inv_tau: float) -> tuple[float, float]:
    """Turn an action into a scale on τ; zero leaves the law to the last bit."""
    action = clip(wanted_on_tau, -1.0, 1.0)
    return action, base_inv_tau * TIME_CONSTANT_RATIO**-action


@system(TASK, "was_active")
def note_active(active: float) -> float:
    """Remember whether a lane runs."""
    return active


ACT = (act_on_k, act_on_tau, note_active)


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
