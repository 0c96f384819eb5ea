"""Steady states of one WTG: the static side of primary frequency regulation.

In steady state the rotor captures what the law delivers, p_w(ω_m) = g(ω) ω_m³ - D_p (ω - ω_st), the last term only
where the law keeps its droop (τ = ∞). Blades are at fine pitch, as in the paper; :func:`stable_equilibrium` alone
knows the pitch protection, which acts above 11.5 m/s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.converter import converter_constants, tracking_coefficient
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, TurbineParameters
from wtg_gym.physics.scenario import WIND_SPEED_RANGE
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.ranges import require_range

#: Lowest and highest frequency of a question [p.u.].
_FREQUENCY_RANGE = (0.5, 1.5)
#: Least tip-speed ratio of the search for equilibria, below which the C_p curve is not valid, and its step [-].
_LEAST_RATIO, _RATIO_STEP = 1.0, 0.1


class OperatingPoint(NamedTuple):
    """A steady state of one WTG at a grid frequency."""

    frequency_pu: float  # grid frequency ω [p.u.]
    rotor_speed_pu: float  # ω_m [p.u.]
    tip_speed_ratio: float  # λ [-]
    power_pu: float  # p, captured and delivered alike [p.u.]
    stable: bool  # a faster rotor captures less than it delivers, so that it comes back


class _Balance:
    """Captured minus delivered power over the rotor speed, at one frequency, law and wind."""

    def __init__(
        self,
        frequency_pu: float,
        law: TrackingLaw,
        wind_m_s: float,
        turbine: TurbineParameters | None = None,
        control: GridFormingParameters | None = None,
    ) -> None:
        require_range("frequency", frequency_pu, *_FREQUENCY_RANGE, "p.u.")
        require_range("wind", wind_m_s, *WIND_SPEED_RANGE, "m/s")
        turbine, control = turbine or TurbineParameters(), control or GridFormingParameters()
        corners = converter_constants(control).corners
        self.frequency_pu, self.curve = frequency_pu, turbine.power_coefficient
        self.k: float = tracking_coefficient(frequency_pu, law.k_min, law.k_nominal, law.k_max, corners)
        deviation = frequency_pu - control.frequency_setpoint_pu
        self.droop = control.droop_gain_pu * deviation if math.isinf(law.damping_time_constant_s) else 0.0
        self.in_wind = turbine.wind_power_pu_per_cubic_wind * wind_m_s**3
        self.ratio_per_speed = turbine.tip_speed_ratio_per_speed_m_s / wind_m_s
        # A rotor so fast that the law takes more than the wind holds leaves a deficit for certain.
        most = (max(self.droop, 0.0) + float(available_power_pu(wind_m_s, turbine))) / self.k
        low = _LEAST_RATIO / self.ratio_per_speed
        high = max(low, 1.01 * most ** (1.0 / 3.0))
        # Rotor speeds that are close enough together to tell all equilibria apart (n,) [p.u.].
        self.speeds = np.linspace(low, high, 2 + int((high - low) * self.ratio_per_speed / _RATIO_STEP))

    def delivered(self, speed: Floats | float) -> Floats:
        return np.asarray(self.k * np.asarray(speed) ** 3 - self.droop)

    def surplus(self, speed: Floats | float) -> Floats:
        return np.asarray(
            self.in_wind * power_coefficient(self.ratio_per_speed * np.asarray(speed), 0.0, self.curve)
            - self.delivered(speed)
        )

    def best_speed(self) -> float:
        """Return the rotor speed with the largest surplus [p.u.]; a coarse look brackets every peak."""
        speeds, surplus = self.speeds, np.pad(self.surplus(self.speeds), 1, constant_values=-np.inf)
        peaks = np.flatnonzero((surplus[1:-1] >= surplus[:-2]) & (surplus[1:-1] >= surplus[2:])).tolist()
        candidates = [speeds[at] for at in peaks]
        for at in peaks:
            around = speeds[max(at - 1, 0)], speeds[min(at + 1, speeds.size - 1)]
            found = minimize_scalar(
                lambda x: -float(self.surplus(x)), bounds=around, method="bounded", options={"xatol": 1e-11}
            )
            candidates.append(found.x)
        return float(candidates[int(np.argmax(self.surplus(np.array(candidates))))])

    def at(self, speed: float, *, stable: bool = True) -> OperatingPoint:
        power = float(self.delivered(speed))
        return OperatingPoint(self.frequency_pu, speed, self.ratio_per_speed * speed, power, stable)


def equilibria(
    frequency_pu: float,
    law: TrackingLaw,
    wind_m_s: float,
    *,
    turbine: TurbineParameters | None = None,
    control: GridFormingParameters | None = None,
) -> tuple[OperatingPoint, ...]:
    """Return every steady state of a WTG at a grid frequency, from the slowest rotor to the fastest.

    Args:
        frequency_pu: grid frequency ω, 0.5 … 1.5 [p.u.].
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 [m/s].
        turbine, control: parameters; the paper's by default.

    Raises:
        ValueError: frequency or wind is out of range.
    """
    balance = _Balance(frequency_pu, law, wind_m_s, turbine, control)
    # The maximum of the surplus lies between a close pair of roots, which the samples alone may miss.
    speeds = np.unique(np.append(balance.speeds, balance.best_speed()))
    positive = balance.surplus(speeds) > 0.0
    points = []
    for i in np.flatnonzero(positive[:-1] != positive[1:]):
        root = brentq(lambda x: float(balance.surplus(x)), speeds[i], speeds[i + 1], xtol=1e-14, rtol=1e-14)
        points.append(balance.at(float(root), stable=bool(positive[i])))
    return tuple(points)


def stable_equilibrium(
    frequency_pu: float,
    law: TrackingLaw,
    wind_m_s: float,
    *,
    turbine: TurbineParameters | None = None,
    control: GridFormingParameters | None = None,
) -> OperatingPoint | None:
    """Return the stable steady state with the fastest rotor, that of a running WTG; None if there is none.

    The pitch protection holds the rotor where captured power or rotor speed reaches its limit.

    Args, Raises: as for :func:`equilibria`.
    """
    found = equilibria(frequency_pu, law, wind_m_s, turbine=turbine, control=control)
    if not found or not found[-1].stable:
        return None
    balance, pitch = _Balance(frequency_pu, law, wind_m_s, turbine, control), PitchParameters()
    limit = (max(pitch.captured_power_limit_pu + balance.droop, 0.0) / balance.k) ** (1.0 / 3.0)
    return balance.at(min(found[-1].rotor_speed_pu, limit, pitch.rotor_speed_limit_pu))


def critical_frequency_pu(law: TrackingLaw, wind_m_s: float, *, lowest_pu: float = 0.9) -> float | None:
    """Return the frequency below which a strategy has no equilibrium at a wind speed [p.u.].

    From the set-point downwards it is the first frequency at which the equilibrium is lost. Source: paper, section on
    MPPT.

    Args:
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 [m/s].
        lowest_pu: lowest frequency tried, 0.5 p.u. … the set-point [p.u.].

    Returns:
        the critical frequency, or None where there is an equilibrium down to `lowest_pu`.

    Raises:
        ValueError: a value is out of range, or there is no equilibrium at the set-point either.
    """
    control = GridFormingParameters()
    setpoint = control.frequency_setpoint_pu
    require_range("lowest frequency", lowest_pu, _FREQUENCY_RANGE[0], setpoint, "p.u.")

    def margin(frequency: float) -> float:
        balance = _Balance(frequency, law, wind_m_s)
        return float(balance.surplus(balance.best_speed()))

    if margin(setpoint) < 0.0:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s at the set-point either")
    corner = max(control.frequency_min_pu, lowest_pu)
    return _first_loss(margin, corner, setpoint) or _first_loss(margin, lowest_pu, corner)


def _first_loss(margin: Callable[[float], float], low: float, high: float) -> float | None:
    """Return the highest frequency between two corners of g(ω) below which the margin is negative; None if none is.

    The margin is convex there, as the largest of functions that are linear in ω: it dips below zero at most once.
    """
    if not low < high:
        return None
    found = minimize_scalar(margin, bounds=(low, high), method="bounded", options={"xatol": 1e-13})
    lowest = min((float(found.x), low), key=margin)
    return float(brentq(margin, lowest, high, xtol=1e-13)) if margin(lowest) < 0.0 else None


def named_points(law: TrackingLaw, wind_m_s: float) -> dict[str, OperatingPoint]:
    """Return the points that the paper names on a power-frequency characteristic.

    A: at ω_st. B: at ω_min, or where the equilibrium is lost if that comes first. C: at ω_max. M: where the stable
    branch passes the maximum power point on the way from A to B. A point that does not exist is left out.

    Args, Raises: as for :func:`critical_frequency_pu`.
    """
    turbine, control = TurbineParameters(), GridFormingParameters()
    lowest, nominal = control.frequency_min_pu, control.frequency_setpoint_pu
    corners = {"A": nominal, "B": lowest, "C": control.frequency_max_pu}
    points = {name: found[-1] for name, f in corners.items() if (found := equilibria(f, law, wind_m_s))}
    critical = critical_frequency_pu(law, wind_m_s, lowest_pu=lowest)
    if critical is not None:
        # The two branches meet there, so that neither has a root; the surplus has its maximum at that speed.
        lost = _Balance(critical, law, wind_m_s)
        points["B"] = lost.at(lost.best_speed())
    best_speed = tracking_point().tip_speed_ratio * wind_m_s / turbine.tip_speed_ratio_per_speed_m_s

    def surplus(frequency: float) -> float:
        return float(_Balance(frequency, law, wind_m_s).surplus(best_speed))

    # A rotor with a surplus at λ_opt stands above it, one with a deficit below.
    if surplus(nominal) > 1e-12 and surplus(lowest) <= -1e-12:
        crossing = float(brentq(surplus, lowest, nominal, xtol=1e-14))
        points["M"] = _Balance(crossing, law, wind_m_s).at(best_speed)
    return points
