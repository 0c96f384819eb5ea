"""Elementary functions without branches: multiply-add, select, sine, cosine, exponential, limits.

Libm would be called for one lane after the other. These are polynomials on a reduced argument: branch-free, the same
bits in every lane, and as close to libm as the tests say.
"""

import ctypes
import ctypes.util
import math
import sys
from typing import Any


def _fma_of_c() -> Any:
    # Python's own is of 3.13, and raises where C gives infinity or NaN. PyDLL keeps the interpreter's lock: whoever
    # releases it for one multiplication waits for other threads each time.
    library = ctypes.PyDLL("ucrtbase" if sys.platform == "win32" else None)
    if not hasattr(library, "fma"):  # in a program that embeds Python
        library = ctypes.PyDLL(ctypes.util.find_library("m"))
    library.fma.argtypes, library.fma.restype = [ctypes.c_double] * 3, ctypes.c_double
    return library.fma


_FMA = _fma_of_c()


def fma(a: float, b: float, c: float) -> float:
    """Return a·b + c, rounded once.

    Left to itself the compiler might fuse in a batch and not in a single environment, or on one processor alone.
    """
    result: float = _FMA(a, b, c)
    return result


def select(condition: bool, value: float, other: float) -> float:
    """Return one of two numbers, without a branch in what is traced."""
    return value if condition else other


_TWO_OVER_PI = 0.6366197723675814
# π/2 in two parts: the first product is exact before it is rounded once.
_HALF_PI_HIGH = 1.5707963267948966
_HALF_PI_LOW = 6.123233995736766e-17


def sine_cosine(angle: float) -> tuple[float, float]:
    """Return (sin, cos) of an angle [rad], |angle| up to about 1e4 rad, wrong by 4e-15 at most.

    The angle is reduced to ±π/4. The polynomials interpolate (sin r / r - 1)/r² and (cos r - 1 + r²/2)/r⁴ at the
    Chebyshev nodes of r² in 0 … (π/4)²: 1.8e-17 and 9e-19 off.
    """
    quarters = math.floor(fma(angle, _TWO_OVER_PI, 0.5))
    r = fma(-quarters, _HALF_PI_LOW, fma(-quarters, _HALF_PI_HIGH, angle))
    y = r * r
    s = fma(1.5918115263038246e-10, y, -2.5051131650231316e-08)
    s = fma(s, y, 2.7557316101617852e-06)
    s = fma(s, y, -0.00019841269836756774)
    s = fma(s, y, 0.008333333333330948)
    s = fma(s, y, -0.16666666666666666)
    s = fma(r * y, s, r)
    c = fma(-1.1382623647332156e-11, y, 2.0876146146556195e-09)
    c = fma(c, y, -2.755731727114513e-07)
    c = fma(c, y, 2.480158729876456e-05)
    c = fma(c, y, -0.0013888888888887398)
    c = fma(c, y, 0.041666666666666664)
    c = fma(fma(c, y, -0.5), y, 1.0)
    quadrant = fma(math.floor(0.25 * quarters), -4.0, quarters)
    swapped = (quadrant == 1.0) | (quadrant == 3.0)
    sine, cosine = select(swapped, c, s), select(swapped, s, c)
    negative = (quadrant == 1.0) | (quadrant == 2.0)
    return select(quadrant >= 2.0, -sine, sine), select(negative, -cosine, cosine)


def exponential(x: float) -> float:
    """Return e^x for -40 ≤ x ≤ 1; below -40 the result stays at e^-40 ≈ 4e-18. C_p needs x ≤ c6 c8 = 0.61.

    e^(x/32) by a polynomial, then squared five times: no power of two has to be assembled from bits, and the
    relative error stays below 3e-14. The polynomial interpolates (e^r - 1 - r)/r² at the Chebyshev nodes of
    -1.25 … 0.05, 1.9e-16 off; it is summed in pairs, because a single environment waits for its chain.
    """
    r = max(x, -40.0) * 0.03125
    r2 = r * r
    r4 = r2 * r2
    a = fma(0.16666666666666763, r, 0.5)
    b = fma(0.008333333333019834, r, 0.041666666666671875)
    c = fma(0.0001984126684525392, r, 0.0013888888841403707)
    d = fma(2.7554985979797258e-06, r, 2.4801481209265294e-05)
    e = fma(2.474406786744029e-08, r, 2.752411132261627e-07)
    f = fma(9.674091802894908e-11, r, 1.905854340714108e-09)
    a, c, e = fma(b, r2, a), fma(d, r2, c), fma(f, r2, e)
    p = fma(r2, fma(fma(e, r4, c), r4, a), r) + 1.0
    for _ in range(5):
        p = p * p
    return p


def limited_rate(rate: float, value: float, low: float, high: float) -> float:
    """Return the rate of a state with non-windup limits: zero where it would leave [low, high]."""
    upward = select(value < high, rate, min(rate, 0.0))
    return select(value > low, upward, max(upward, 0.0))


def clip(value: float, low: float, high: float) -> float:
    """Return the value, held within [low, high]."""
    return min(max(value, low), high)


_WORD = 0xFFFFFFFF
#: Numbers that differ by a whole number of golden sections of the words lie as far apart as they can.
GOLDEN = 0x1E3779B1
#: Mean and standard deviation of the sum of four uniform whole numbers 0 … 65535.
SUM_MEAN, SUM_DEVIATION = 131070.0, math.sqrt((65536.0**2 - 1.0) / 3.0)
#: Shifts and factors that scramble a word. Source of the factors: C. Wellons and T. Ellis, hash-prospector. Both have
#: 31 bits, so that a product of two numbers fits a signed word of 64 bits.
SCRAMBLING = ((16, 0x21F0AAAD), (15, 0x735A2D97), (15, 1))


def _scrambled(word: int) -> int:
    """Return a word of 32 bits that looks unrelated to the given one, a one-to-one function of it."""
    for shift, factor in SCRAMBLING:
        word = ((word ^ (word >> shift)) * factor) & _WORD
    return word


def noise(seed: float, step: float, channel: float) -> float:
    """Return a random number: mean 0, variance 1, nearly normal; whole numbers 0 … 2³¹ - 1 say which."""
    key = _scrambled(int(seed) ^ _scrambled(int(step) + 1))
    first, second = (_scrambled((key + (2 * int(channel) + i) * GOLDEN) & _WORD) for i in range(2))
    total = (first & 0xFFFF) + (first >> 16) + (second & 0xFFFF) + (second >> 16)
    return (total - SUM_MEAN) * (1.0 / SUM_DEVIATION)
