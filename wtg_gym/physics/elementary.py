"""Sine, cosine, exponential and a limited rate as plain arithmetic.

Numba's wheels carry no vector mathematics library, so a call into libm keeps a loop over lanes scalar. These
are Taylor polynomials on a reduced argument: branch-free, the same bits in every lane on every platform, and
within a few units in the last place of libm (tested).
"""

from __future__ import annotations

import math

from wtg_gym.physics.compiled import compiled

_TURNS_PER_RADIAN = 0.15915494309189535
# 2π in two parts, the first of 33 bits, so that a product with a whole number of turns is exact (Cody and Waite).
_TWO_PI_HIGH = 6.28318530693650245668
_TWO_PI_LOW = 2.430840202602476899728e-10


@compiled
def sine_cosine(angle: float) -> tuple[float, float]:
    """Return (sin, cos) of an angle [rad], |angle| up to about 1e4 rad.

    The angle is reduced to one turn, quartered, expanded and doubled twice.
    """
    turns = math.floor(angle * _TURNS_PER_RADIAN + 0.5)
    x = 0.25 * ((angle - turns * _TWO_PI_HIGH) - turns * _TWO_PI_LOW)
    y = x * x
    s = 1.0 - y * (1.0 / 210.0)
    s = 1.0 - y * (1.0 / 156.0) * s
    s = 1.0 - y * (1.0 / 110.0) * s
    s = 1.0 - y * (1.0 / 72.0) * s
    s = 1.0 - y * (1.0 / 42.0) * s
    s = 1.0 - y * (1.0 / 20.0) * s
    s = x * (1.0 - y * (1.0 / 6.0) * s)
    # 1 - cos = 2 sin²: it keeps its digits through the doublings, the cosine itself would not. It is expanded
    # on its own because sqrt(1 - sin²) would lose the sign.
    v = 1.0 - y * (1.0 / 240.0)
    v = 1.0 - y * (1.0 / 182.0) * v
    v = 1.0 - y * (1.0 / 132.0) * v
    v = 1.0 - y * (1.0 / 90.0) * v
    v = 1.0 - y * (1.0 / 56.0) * v
    v = 1.0 - y * (1.0 / 30.0) * v
    v = 0.5 * y * (1.0 - y * (1.0 / 12.0) * v)
    v2 = 2.0 * s * s
    s2 = 2.0 * s * (1.0 - v)
    v4 = 2.0 * s2 * s2
    s4 = 2.0 * s2 * (1.0 - v2)
    return s4, 1.0 - v4


@compiled
def exponential(x: float) -> float:
    """Return e^x for -40 ≤ x ≤ 0; below -40 the result stays at e^-40 ≈ 4e-18.

    e^(x/128) by its series to degree 13, then squared seven times: no power of two has to be assembled from
    bits, and the relative error stays below 2e-14.
    """
    r = max(x, -40.0) * 0.0078125
    e = 1.0 + r * (1.0 / 13.0)
    e = 1.0 + r * (1.0 / 12.0) * e
    e = 1.0 + r * (1.0 / 11.0) * e
    e = 1.0 + r * (1.0 / 10.0) * e
    e = 1.0 + r * (1.0 / 9.0) * e
    e = 1.0 + r * (1.0 / 8.0) * e
    e = 1.0 + r * (1.0 / 7.0) * e
    e = 1.0 + r * (1.0 / 6.0) * e
    e = 1.0 + r * (1.0 / 5.0) * e
    e = 1.0 + r * (1.0 / 4.0) * e
    e = 1.0 + r * (1.0 / 3.0) * e
    e = 1.0 + r * (1.0 / 2.0) * e
    e = 1.0 + r * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    return e * e


@compiled
def limited_rate(rate: float, value: float, low: float, high: float) -> float:
    """Return the rate of a state with non-windup limits: zero where it would leave [low, high]."""
    upward = rate if value < high else min(rate, 0.0)
    return upward if value > low else max(upward, 0.0)
