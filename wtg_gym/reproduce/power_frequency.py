"""Power-frequency characteristics of a strategy: branches, critical frequency, and the points that the paper names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.ranges import require_range
from wtg_gym.reproduce.steady_states import (
    FREQUENCY_RANGE,
    Balance,
    OperatingPoint,
    equilibria,
    power_margin_pu,
    stable_equilibrium,
)


@dataclass(frozen=True)
class Characteristic:
    """The power-frequency characteristic of a law at a wind speed.

    `frequency_pu` (n,); the other arrays (n,) belong to the stable branch and to the unstable one, not a number where
    there is none [p.u.].
    """

    frequency_pu: Floats
    rotor_speed_pu: Floats
    power_pu: Floats
    unstable_rotor_speed_pu: Floats
    unstable_power_pu: Floats


def characteristic(
    law: TrackingLaw, wind_m_s: float, frequency_pu: npt.ArrayLike, *, fine_pitch: bool = False
) -> Characteristic:
    """Return the power-frequency characteristic of a law: the stable and the unstable branch over frequency.

    Source: paper, figures `MPPTDroop` … `Proposed`.

    Args:
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 [m/s].
        frequency_pu: frequencies, shape (n,), 0.5 … 1.5 [p.u.].
        fine_pitch: hold β = 0, without pitch protection.

    Raises:
        ValueError: a frequency or the wind is out of range.
    """
    frequencies = np.atleast_1d(np.asarray(frequency_pu, dtype=np.float64))
    table = np.full((4, frequencies.size), np.nan)
    for i, frequency in enumerate(frequencies):
        for point in equilibria(float(frequency), law, wind_m_s, fine_pitch=fine_pitch):
            row = 0 if point.stable else 2
            table[row : row + 2, i] = point.rotor_speed_pu, point.power_pu
    return Characteristic(frequencies, *table)


def critical_frequency_pu(
    law: TrackingLaw,
    wind_m_s: float,
    *,
    lowest_pu: float = 0.9,
    fine_pitch: bool = False,
    turbine: TurbineParameters | None = None,
) -> float | None:
    """Return the frequency below which a strategy has no equilibrium at a wind speed [p.u.].

    From the set-point downwards it is the first frequency at which the equilibrium is lost. Where a law has none at the
    set-point either, it is the lowest frequency above at which it has one.

    Args:
        law: the strategy.
        wind_m_s: wind speed, 3 … 25 [m/s].
        lowest_pu: lowest frequency tried, 0.5 p.u. … the set-point [p.u.].
        fine_pitch: hold β = 0, without pitch protection.
        turbine: parameters; the paper's by default.

    Returns:
        the critical frequency, or None where there is an equilibrium down to `lowest_pu`.

    Raises:
        ValueError: a value is out of range, or there is no equilibrium from the set-point up to 1.5 p.u.
    """
    control = GridFormingParameters()
    setpoint = control.frequency_setpoint_pu
    require_range("lowest frequency", lowest_pu, FREQUENCY_RANGE[0], setpoint, "p.u.")

    def margin(frequency: float) -> float:
        return power_margin_pu(frequency, law, wind_m_s, fine_pitch=fine_pitch, turbine=turbine)

    if margin(setpoint) < 0.0:
        for low, high in ((setpoint, control.frequency_max_pu), (control.frequency_max_pu, FREQUENCY_RANGE[1])):
            if margin(high) >= 0.0:
                return float(brentq(margin, low, high, xtol=1e-13))
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s from the set-point on upwards")
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
    """Return the points that the paper names on a power-frequency characteristic, blades at fine pitch.

    A: at ω_st. B: at ω_min, or where the equilibrium is lost if that comes first. C: at ω_max. M: where the stable
    branch passes the maximum power point on the way from A to B. A point that does not exist is left out.

    Args, Raises: as for :func:`critical_frequency_pu`.
    """
    turbine, control = TurbineParameters(), GridFormingParameters()
    lowest, nominal = control.frequency_min_pu, control.frequency_setpoint_pu

    def balance(frequency: float) -> Balance:
        return Balance(frequency, law, wind_m_s, fine_pitch=True)

    points = {
        name: stable_equilibrium(frequency, law, wind_m_s, fine_pitch=True)
        for name, frequency in (("A", nominal), ("B", lowest), ("C", control.frequency_max_pu))
    }
    critical = critical_frequency_pu(law, wind_m_s, lowest_pu=lowest, fine_pitch=True)
    if critical is not None and critical <= nominal:
        # The two branches meet there, so that neither has a root; the surplus has its maximum at that speed.
        lost = balance(critical)
        points["B"] = lost.operating_point(lost.best_speed(), stable=True)
    best_speed = tracking_point().tip_speed_ratio * wind_m_s / turbine.tip_speed_ratio_per_speed_m_s

    def surplus(frequency: float) -> float:
        return float(balance(frequency)(best_speed))

    # A rotor with a surplus at λ_opt stands above it, one with a deficit below.
    if surplus(nominal) > 1e-12 and surplus(lowest) <= -1e-12:
        crossing = float(brentq(surplus, lowest, nominal, xtol=1e-14))
        points["M"] = balance(crossing).operating_point(best_speed, stable=True)
    return {name: point for name, point in points.items() if point is not None}
