"""Power coefficient, captured power and the operating points derived from them."""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.parameters import PowerCoefficientParameters, TurbineParameters, constants_of
from wtg_gym.physics.rotor_table import Cells, Grid, RotorTable, tabulated_power_coefficient
from wtg_gym.systems.elementary import exponential, fma
from wtg_gym.systems.programs import Floats


class CurveConstants(NamedTuple):
    """Constants of C_p(λ, β); see :class:`~wtg_gym.physics.parameters.PowerCoefficientParameters`."""

    c1: float
    c2: float
    c3: float
    c5: float
    c6: float
    c7: float
    c8: float


def curve_constants(parameters: PowerCoefficientParameters | RotorTable) -> CurveConstants:
    """Return the constants of a C_p curve; zeros where a table takes its place."""
    if isinstance(parameters, RotorTable):
        return CurveConstants(*[0.0] * len(CurveConstants._fields))
    return constants_of(CurveConstants, parameters)


def power_coefficient_at(tip_speed: float, wind: float, pitch_deg: float, c: CurveConstants) -> float:
    """Return C_p, given the speed of the blade tip and the wind [m/s] and the pitch angle β [deg]; λ is at least 0.2.

    1/λ_i = 1/(λ + c7 β) - c8/(β³ + 1), with λ = tip speed / wind, is brought to a common denominator: one division
    instead of three. Source: paper, equations (2) and (3).
    """
    speed = fma(c.c7 * pitch_deg, wind, max(tip_speed, 0.2 * wind))
    cubic = fma(pitch_deg * pitch_deg, pitch_deg, 1.0)
    inverse_i = fma(wind, cubic, -c.c8 * speed) / (speed * cubic)
    return c.c1 * (fma(c.c2, inverse_i, -c.c3 * pitch_deg) - c.c5) * exponential(-c.c6 * inverse_i)


def surface_of(parameters: PowerCoefficientParameters | RotorTable) -> tuple[Grid, Cells]:
    """Return grid and cells of a C_p table; of a curve a grid without cells."""
    if isinstance(parameters, RotorTable):
        return parameters.surface()
    return Grid(0.0, 0.0, 0.0, 0.0), np.zeros((0, 0, 16))


def power_coefficient(
    tip_speed_ratio: float | Floats,
    pitch_deg: float = 0.0,
    parameters: PowerCoefficientParameters | RotorTable | None = None,
) -> Floats:
    """Return C_p(λ, β) of a curve or a table, by default of the paper's curve, at λ > 0 of any shape and β ≥ 0 [deg].

    A λ below 0.2 counts as 0.2. A ValueError says that λ is not positive, β is negative, or one of them is not finite.
    """
    parameters = parameters or PowerCoefficientParameters()
    ratio = np.asarray(tip_speed_ratio, dtype=np.float64)
    if (wrong := ratio[~((ratio > 0.0) & np.isfinite(ratio))]).size:
        raise ValueError(f"tip-speed ratio must be positive, got {wrong[0]:g}")
    if not 0.0 <= pitch_deg < np.inf:
        raise ValueError(f"pitch angle must be 0 deg or more, got {pitch_deg:g} deg")
    pitch, (grid, cells), curve = float(pitch_deg), surface_of(parameters), curve_constants(parameters)
    flat = [
        tabulated_power_coefficient(x, pitch, cells, grid) if cells.size else power_coefficient_at(x, 1.0, pitch, curve)
        for x in ratio.ravel().tolist()
    ]
    return np.array(flat).reshape(ratio.shape)


@dataclass(frozen=True)
class TrackingPoint:
    """An operating point on the over-speed side of the C_p curve at β = 0.

    `tip_speed_ratio` λ_d [-], `power_coefficient` C_pd [-] and the `coefficient` K_d [p.u.] whose curve K_d ω_m³ meets
    the captured power there at every wind speed.
    """

    tip_speed_ratio: float
    power_coefficient: float
    coefficient: float


def tracking_point(deloading: float = 0.0, turbine: TurbineParameters | None = None) -> TrackingPoint:
    """Return the point at which a share d of the available power, 0 … 0.9, is given up by over-speeding [-].

    K_d = ρ π R⁵ C_pd ω_tn³ / (2 λ_d³ S_n), which is K_opt (λ_opt/λ_d)³ (1 - d); the turbine is the paper's by default.
    Source: paper, equations (10), (13), (15) and (38). A ValueError says that the deloading is outside 0 … 0.9, or the
    curve has no such point.
    """
    if not 0.0 <= deloading <= 0.9:
        raise ValueError(f"deloading = {deloading:g} is outside the allowed range 0 … 0.9")
    return _tracking_point(float(deloading), turbine or TurbineParameters())


@functools.lru_cache(maxsize=256)
def _tracking_point(deloading: float, turbine: TurbineParameters) -> TrackingPoint:
    def cp(ratio: float) -> float:
        return float(power_coefficient(ratio, 0.0, turbine.power_coefficient))

    maximum = minimize_scalar(lambda x: -cp(x), bounds=(4.0, 12.0), method="bounded", options={"xatol": 1e-6})

    def slope(ratio: float) -> float:
        return cp(ratio + 1e-4) - cp(ratio - 1e-4)

    if not slope(maximum.x - 0.5) > 0.0 > slope(maximum.x + 0.5):
        raise ValueError("the C_p curve has no maximum at a tip-speed ratio in the allowed range 4 … 12")
    # The maximum is flat: its place is the root of the slope, not the smallest value found.
    optimum = float(brentq(slope, maximum.x - 0.5, maximum.x + 0.5, xtol=1e-12))
    ratio = optimum
    if deloading > 0.0:
        target = (1.0 - deloading) * cp(optimum)
        if cp(20.0) > target:
            raise ValueError(f"a deloading of {deloading:g} takes a tip-speed ratio beyond the allowed 20")
        ratio = float(brentq(lambda x: cp(x) - target, optimum, 20.0, xtol=1e-13))
    value = cp(ratio)
    speed = turbine.tip_speed_ratio_per_speed_m_s / ratio
    return TrackingPoint(ratio, value, turbine.wind_power_pu_per_cubic_wind * value * speed**3)


def available_power_pu(wind_m_s: float | Floats, turbine: TurbineParameters | None = None) -> Floats:
    """Return the largest power a rotor can capture at β = 0 [p.u. of its rating], for wind speeds from 0 m/s on."""
    turbine = turbine or TurbineParameters()
    wind = np.asarray(wind_m_s, dtype=np.float64)
    if (wrong := wind[~((wind >= 0.0) & np.isfinite(wind))]).size:
        raise ValueError(f"wind speed must be 0 m/s or more, got {wrong[0]:g} m/s")
    peak = tracking_point(0.0, turbine).power_coefficient
    return np.asarray(turbine.wind_power_pu_per_cubic_wind * peak * wind**3)
