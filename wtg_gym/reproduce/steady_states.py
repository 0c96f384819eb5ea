"""Steady states of one WTG: the static side of primary frequency regulation.

In steady state the rotor captures what the law delivers, p_w(ω_m) = g(ω) ω_m³ - D_p (ω - ω_st), the last term only
where the law keeps its droop (τ = ∞). The pitch protection caps the left side at its power limit and the rotor at its
speed limit, exactly as its controller does once at rest; `fine_pitch` leaves it out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TypedDict, Unpack

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.aerodynamics import (
    available_power_pu,
    curve_constants,
    power_coefficient,
    power_coefficient_at,
)
from wtg_gym.physics.converter import converter_constants, tracking_coefficient
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, TurbineParameters
from wtg_gym.physics.rotor_table import RotorTable
from wtg_gym.physics.scenario import WIND_SPEED_RANGE
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.ranges import require_range

#: Least tip-speed ratio of the search for equilibria; the C_p curve is not valid far below [-].
LEAST_TIP_SPEED_RATIO = 1.0
#: Frequencies the functions accept [p.u.].
FREQUENCY_RANGE = (0.5, 1.5)
_SAMPLE_STEP = 0.1


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """A steady state of one WTG at a grid frequency."""

    frequency_pu: float  # grid frequency ω [p.u.]
    rotor_speed_pu: float  # ω_m [p.u.]
    tip_speed_ratio: float  # λ [-]
    power_pu: float  # p, captured and delivered alike [p.u.]
    pitch_deg: float  # β, above 0 where the pitch protection holds the rotor [deg]
    stable: bool  # a faster rotor captures less than it delivers, so that it comes back


class Options(TypedDict, total=False):
    """What steady states depend on besides frequency, law and wind."""

    #: turbine, control: parameters; the paper's by default.
    turbine: TurbineParameters | None
    control: GridFormingParameters | None
    fine_pitch: bool  # hold β = 0, without pitch protection


class Balance:
    """Captured minus delivered power over the rotor speed, at one frequency, law and wind.

    Raises:
        ValueError: frequency or wind is out of range.
    """

    def __init__(
        self,
        frequency_pu: float,
        law: TrackingLaw,
        wind_m_s: float,
        *,
        turbine: TurbineParameters | None = None,
        control: GridFormingParameters | None = None,
        fine_pitch: bool = False,
    ) -> None:
        require_range("frequency", frequency_pu, *FREQUENCY_RANGE, "p.u.")
        require_range("wind", wind_m_s, *WIND_SPEED_RANGE, "m/s")
        turbine, control = turbine or TurbineParameters(), control or GridFormingParameters()
        self.frequency_pu = frequency_pu
        self.k: float = tracking_coefficient(
            frequency_pu, law.k_min, law.k_nominal, law.k_max, converter_constants(control).corners
        )
        keeps_droop = math.isinf(law.damping_time_constant_s)
        deviation = frequency_pu - control.frequency_setpoint_pu
        self.droop = control.droop_gain_pu * deviation if keeps_droop else 0.0
        self.in_wind = turbine.wind_power_pu_per_cubic_wind * wind_m_s**3
        self.ratio_per_speed = turbine.tip_speed_ratio_per_speed_m_s / wind_m_s
        self.curve = turbine.power_coefficient
        self.constants = None if isinstance(self.curve, RotorTable) else curve_constants(self.curve)
        pitch = PitchParameters()
        self.speed_limit = math.inf if fine_pitch else pitch.rotor_speed_limit_pu
        self.power_limit = math.inf if fine_pitch else pitch.captured_power_limit_pu
        # A rotor so fast that the law takes more than the wind holds leaves a deficit for certain.
        most = (max(self.droop, 0.0) + float(available_power_pu(wind_m_s, turbine))) / self.k
        fastest = min(1.01 * most ** (1.0 / 3.0), self.speed_limit)
        slowest = LEAST_TIP_SPEED_RATIO / self.ratio_per_speed
        self.range = slowest, max(slowest, fastest)

    def samples(self) -> Floats:
        """Return rotor speeds that are close enough together to tell all equilibria apart (n,) [p.u.]."""
        low, high = self.range
        return np.linspace(low, high, 2 + int((high - low) * self.ratio_per_speed / _SAMPLE_STEP))

    def captured(self, speed: Floats | float, pitch_deg: float = 0.0) -> Floats | float:
        # Searches ask for one speed at a time, often: the curve without the checks of arrays is ten times as fast.
        if isinstance(speed, float) and self.constants is not None:
            return self.in_wind * power_coefficient_at(self.ratio_per_speed * speed, 1.0, pitch_deg, self.constants)
        ratio = self.ratio_per_speed * np.asarray(speed, dtype=np.float64)
        return self.in_wind * power_coefficient(ratio, pitch_deg, self.curve)

    def delivered(self, speed: Floats | float) -> Floats:
        return np.asarray(self.k * np.asarray(speed, dtype=np.float64) ** 3 - self.droop)

    def __call__(self, speed: Floats | float) -> Floats:
        return np.asarray(np.minimum(self.captured(speed), self.power_limit) - self.delivered(speed))

    def best_speed(self) -> float:
        """Return the rotor speed with the largest surplus [p.u.]; a coarse look brackets every peak.

        The highest peak may be so narrow, where the power limit begins, that another has the highest sample.
        """
        speeds = self.samples()
        surplus = np.pad(self(speeds), 1, constant_values=-np.inf)
        peaks = np.flatnonzero((surplus[1:-1] >= surplus[:-2]) & (surplus[1:-1] >= surplus[2:]))
        return max((speed for at in peaks for speed in self._at_peak(speeds, int(at))), key=lambda x: float(self(x)))

    def _at_peak(self, speeds: Floats, at: int) -> list[float]:
        """Return rotor speeds, one of which has the largest surplus near a sample [p.u.]."""
        around = speeds[max(at - 1, 0)], speeds[min(at + 1, speeds.size - 1)]
        found = minimize_scalar(lambda x: -float(self(x)), bounds=around, method="bounded", options={"xatol": 1e-11})
        candidates = [float(found.x), float(speeds[at])]
        # Where the power limit begins the surplus has a corner, which the search misses by a part in 10⁸.
        for low, high in pairwise((around[0], speeds[at], around[1])):
            if (self._over_limit(low) < 0.0) != (self._over_limit(high) < 0.0):
                candidates.append(float(brentq(self._over_limit, low, high, xtol=1e-15, rtol=1e-15)))
        return candidates

    def _over_limit(self, speed: float) -> float:
        return float(self.captured(speed)) - self.power_limit

    def holding_pitch(self, speed: float) -> float | None:
        """Return the smallest pitch angle at which the captured power is the delivered one; None if none does [deg]."""
        target = float(self.delivered(speed))

        def excess(pitch_deg: float) -> float:
            return float(self.captured(speed, pitch_deg)) - target

        angles = np.arange(0.0, PitchParameters().largest_angle_deg + 0.05, 0.05)
        below = [angle for angle in angles if excess(float(angle)) <= 0.0]
        if not below:
            return None
        return float(brentq(excess, max(below[0] - 0.05, 0.0), below[0])) if below[0] > 0.0 else 0.0

    def operating_point(self, speed: float, *, stable: bool) -> OperatingPoint | None:
        """Return the steady state at a rotor speed [p.u.]; None where no pitch angle holds the rotor there."""
        held = speed >= self.speed_limit or float(self.captured(speed)) > self.power_limit
        pitch_deg = self.holding_pitch(speed) if held else 0.0
        if pitch_deg is None:
            return None
        return OperatingPoint(
            frequency_pu=self.frequency_pu,
            rotor_speed_pu=speed,
            tip_speed_ratio=self.ratio_per_speed * speed,
            power_pu=float(self.delivered(speed)),
            pitch_deg=pitch_deg,
            stable=stable,
        )


def power_margin_pu(frequency_pu: float, law: TrackingLaw, wind_m_s: float, **options: Unpack[Options]) -> float:
    """Return the largest surplus of captured over demanded power that a steady rotor can have [p.u.].

    max over ω_m of p_w(ω_m) - g(ω) ω_m³ + D_p (ω - ω_st), the last term only where the law keeps its droop (τ = ∞).
    Negative: there is no equilibrium. Positive: there is one, unless the droop draws so much power from the grid that
    no pitch angle holds the rotor at its speed limit. Source: paper, section on MPPT.

    Args:
        frequency_pu: grid frequency ω, 0.5 … 1.5 [p.u.].
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 [m/s].
        options: see :class:`Options`.

    Raises:
        ValueError: frequency or wind is out of range.
    """
    balance = Balance(frequency_pu, law, wind_m_s, **options)
    return float(balance(balance.best_speed()))


def equilibria(
    frequency_pu: float, law: TrackingLaw, wind_m_s: float, **options: Unpack[Options]
) -> tuple[OperatingPoint, ...]:
    """Return every steady state of a WTG at a grid frequency, from the slowest rotor to the fastest.

    Stability is that of the rotor at constant frequency. Where the pitch protection holds the rotor, the smallest angle
    is given: C_p is not monotonic in β close to fine pitch, so that a second angle with the same rotor speed and power
    may exist.

    Args:
        frequency_pu, law, wind_m_s, options: as for :func:`power_margin_pu`.

    Raises:
        ValueError: frequency or wind is out of range.
    """
    balance = Balance(frequency_pu, law, wind_m_s, **options)
    # The maximum of the surplus lies between a close pair of roots, which the samples alone may miss.
    speeds = np.unique(np.append(balance.samples(), balance.best_speed()))
    surplus = balance(speeds)
    points = []
    for i in range(speeds.size - 1):
        if (surplus[i] > 0.0) == (surplus[i + 1] > 0.0):
            continue
        root = float(brentq(lambda x: float(balance(x)), speeds[i], speeds[i + 1], xtol=1e-14, rtol=1e-14))
        points.append(balance.operating_point(root, stable=bool(surplus[i] > 0.0)))
    if surplus[-1] > 0.0 and math.isfinite(balance.speed_limit) and balance.range[1] == balance.speed_limit:
        # The rotor would go on accelerating, but the blades turn and hold it at its limit.
        points.append(balance.operating_point(balance.speed_limit, stable=True))
    return tuple(point for point in points if point is not None)


def stable_equilibrium(
    frequency_pu: float, law: TrackingLaw, wind_m_s: float, **options: Unpack[Options]
) -> OperatingPoint | None:
    """Return the stable steady state with the fastest rotor, that of a running WTG; None if there is none.

    Args, Raises: as for :func:`equilibria`.
    """
    found = equilibria(frequency_pu, law, wind_m_s, **options)
    return next((point for point in reversed(found) if point.stable), None)
