"""Saturation of iron, by a parabola.

    E S(E) = B (E - A)²  for E > A,  else 0

through two given points (E_1, S_1) and (E_2, S_2): with a = √(E_1 S_1 / (E_2 S_2)),

    A = (E_1 - a E_2) / (1 - a),    B = E_2 S_2 / (E_2 - A)²

Source: PSS/E and ANDES, for GENROU as for exciters. Where S_1 is 0, A is E_1, and saturation begins there; ANDES has
none then.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Saturation(NamedTuple):
    """Constants."""

    threshold: float  # A [p.u.]
    gain: float  # B [1/p.u.]; 0 for no saturation


def saturation_constants(what: str, first: tuple[float, float], second: tuple[float, float]) -> Saturation:
    """Return the parabola through two points (E, S); none where both S, or the second, are 0.

    Raises:
        ValueError: E, or E S, does not rise from the first point to the second; the message names `what` it is of.
    """
    (e_1, s_1), (e_2, s_2) = first, second
    if s_1 == 0.0 and s_2 == 0.0:
        return Saturation(0.0, 0.0)
    if not (e_1 < e_2 and e_1 * s_1 < e_2 * s_2):
        raise ValueError(
            f"{what}: saturation must rise from S({e_1:g} p.u.) = {s_1:g} to S({e_2:g} p.u.) = {s_2:g}, times the "
            "voltage too"
        )
    ratio = math.sqrt(e_1 * s_1 / (e_2 * s_2))
    threshold = (e_1 - ratio * e_2) / (1.0 - ratio)
    return Saturation(threshold, e_2 * s_2 / (e_2 - threshold) ** 2)


def saturated(value: float, c: Saturation) -> float:
    """Return E S(E) [p.u.] at a value E [p.u.]."""
    excess = max(value - c.threshold, 0.0)
    return c.gain * (excess * excess)
