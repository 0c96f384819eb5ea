"""What an action may be."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np

from wtg_gym.physics.layout import Floats


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
