"""Steady states of one WTG: the static side of primary frequency regulation.

In steady state the rotor captures what the law delivers, p_w(ω_m) = g(ω) ω_m³ - D_p (ω - ω_st), the last term only
where the law keeps its droop (τ = ∞). Blades are at fine pitch, as in the paper; above 11.5 m/s, where the pitch
protection acts, a real rotor turns slower.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.converter import converter_constants, tracking_coefficient
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.scenario import WIND_SPEED_RANGE
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.ranges import require_range

#: Lowest and highest frequency of a question, and the step of the search for a critical one [p.u.].
_FREQUENCY_RANGE, _FREQUENCY_STEP = (0.5, 1.5), 1e-4
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
        self.slowest = _LEAST_RATIO / self.ratio_per_speed
        self.fastest = max(self.slowest, 1.01 * most ** (1.0 / 3.0))

    def surplus(self, speed: Floats | float) -> Floats:
        captured = self.in_wind * power_coefficient(self.ratio_per_speed * np.asarray(speed), 0.0, self.curve)
        return captured - (self.k * np.asarray(speed) ** 3 - self.droop)

    def samples(self) -> Floats:
        """Return rotor speeds that tell all equilibria apart, that of the largest surplus among them (n,) [p.u.]."""
        n = 2 + int((self.fastest - self.slowest) * self.ratio_per_speed / _RATIO_STEP)
        speeds = np.linspace(self.slowest, self.fastest, n)
        peak = int(np.argmax(self.surplus(speeds)))
        around = speeds[max(peak - 1, 0)], speeds[min(peak + 1, n - 1)]
        found = minimize_scalar(
            lambda x: -float(self.surplus(x)), bounds=around, method="bounded", options={"xatol": 1e-11}
        )
        return np.unique(np.append(speeds, found.x))

    def at(self, speed: float, *, stable: bool = True) -> OperatingPoint:
        power = self.k * speed**3 - self.droop
        return OperatingPoint(self.frequency_pu, speed, self.ratio_per_speed * speed, power, stable)


def equilibria(
    frequency_pu: float,
    law: TrackingLaw,
    wind_m_s: float,
    *,
    turbine: TurbineParameters | None = None,
    control: GridFormingParameters | None = None,
) -> tuple[OperatingPoint, ...]:
    """Return every steady state of a WTG at a grid frequency, by rising rotor speed; that of a running WTG is the last.

    Args:
        frequency_pu: grid frequency ω, 0.5 … 1.5 [p.u.].
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 [m/s].
        turbine, control: parameters; the paper's by default.

    Raises:
        ValueError: frequency or wind is out of range.
    """
    balance = _Balance(frequency_pu, law, wind_m_s, turbine, control)
    speeds = balance.samples()
    positive = balance.surplus(speeds) > 0.0
    points = []
    for i in np.flatnonzero(positive[:-1] != positive[1:]):
        root = brentq(lambda x: float(balance.surplus(x)), speeds[i], speeds[i + 1], xtol=1e-14, rtol=1e-14)
        points.append(balance.at(float(root), stable=bool(positive[i])))
    return tuple(points)


def critical_frequency_pu(law: TrackingLaw, wind_m_s: float, *, lowest_pu: float = 0.9) -> float | None:
    """Return the frequency below which a strategy has no equilibrium at a wind speed [p.u.] (paper, section on MPPT).

    From the set-point downwards it is the first one at which the equilibrium is lost; None where none is down to
    `lowest_pu` [p.u.]. Without an equilibrium at the set-point there is a ValueError.
    """
    setpoint = GridFormingParameters().frequency_setpoint_pu
    require_range("lowest frequency", lowest_pu, _FREQUENCY_RANGE[0], setpoint, "p.u.")

    def margin(frequency: float) -> float:
        balance = _Balance(frequency, law, wind_m_s)
        return float(balance.surplus(balance.samples()).max())

    frequencies = np.linspace(setpoint, lowest_pu, 2 + int((setpoint - lowest_pu) / _FREQUENCY_STEP)).tolist()
    lost = next((place for place, frequency in enumerate(frequencies) if margin(frequency) < 0.0), None)
    if lost == 0:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s at the set-point either")
    return None if lost is None else float(brentq(margin, frequencies[lost], frequencies[lost - 1], xtol=1e-13))


def named_points(law: TrackingLaw, wind_m_s: float) -> dict[str, OperatingPoint]:
    """Return the points that the paper names on a power-frequency characteristic.

    A: at ω_st. B: at ω_min, or where the equilibrium is lost if that comes first. C: at ω_max. M: where the stable
    branch passes the maximum power point on the way from A to B. A point that does not exist is left out.

    Raises:
        ValueError: as for :func:`critical_frequency_pu`.
    """
    control = GridFormingParameters()
    lowest, nominal = control.frequency_min_pu, control.frequency_setpoint_pu
    corners = {"A": nominal, "B": lowest, "C": control.frequency_max_pu}
    points = {name: found[-1] for name, f in corners.items() if (found := equilibria(f, law, wind_m_s))}
    critical = critical_frequency_pu(law, wind_m_s, lowest_pu=lowest)
    if critical is not None:
        # The two branches meet there, so that neither has a root; the surplus has its maximum at that speed.
        lost = _Balance(critical, law, wind_m_s)
        points["B"] = lost.at(float(max(lost.samples(), key=lost.surplus)))
    best_speed = tracking_point().tip_speed_ratio * wind_m_s / TurbineParameters().tip_speed_ratio_per_speed_m_s

    def surplus(frequency: float) -> float:
        return float(_Balance(frequency, law, wind_m_s).surplus(best_speed))

    # A rotor with a surplus at λ_opt stands above it, one with a deficit below.
    if surplus(nominal) > 1e-12 and surplus(lowest) <= -1e-12:
        crossing = float(brentq(surplus, lowest, nominal, xtol=1e-14))
        points["M"] = _Balance(crossing, law, wind_m_s).at(best_speed)
    return points
