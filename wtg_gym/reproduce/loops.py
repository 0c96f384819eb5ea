"""One grid-forming WTG on an infinite bus: the paper's open-loop transfer functions and their margins.

    G(s) = ω_n K_p (2H_m s + B1 - A) / (s [2H s - B2 + D(s)] (2H_m s - A)),    D(s) = D_p τ s/(τ s + 1)

with D = D_p for τ = ∞ and D = 0 for τ = 0. Every strategy of the paper is this loop with other numbers; on the ideal DC
source A = B1 = B2 = 0. Source: paper, section on stability (equations (31)-(34)).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, TurbineParameters
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.ranges import require_range
from wtg_gym.reproduce.steady_states import equilibria

#: The slope of g(ω) that counts at ω_st: that of under-frequency, or that of over-frequency.
Side = Literal["under", "over"]
SIDES: tuple[Side, ...] = ("under", "over")
#: The synchronising coefficient K_p at which the paper's margins come out [p.u./rad].
PAPER_SYNCHRONISING_COEFFICIENT = 1.45
#: The straight g(ω) with the droop cancelled: the loop whose margin the paper gives as about 28°.
LINEAR_UNDAMPED = dataclasses.replace(
    STRATEGIES["coordinated-linear"], name="coordinated-linear-undamped", damping_time_constant_s=0.0
)
#: Nominal angular frequency of the paper, 50 Hz [rad/s].
_ANGULAR_FREQUENCY = 100.0 * math.pi
#: Relative step of the numerical slope of C_p; its error is about the square of it.
_STEP = 1e-5


class Margins(NamedTuple):
    """Stability of a closed loop."""

    phase_margin_deg: float  # smallest over all gain crossovers; not a number where the loop is unstable [deg]
    crossover_rad_s: float  # the gain crossover at which it is found [rad/s]
    stable: bool  # all poles of the closed loop lie in the left half plane


@dataclass(frozen=True)
class SingleMachine:
    """An open loop G(s): coefficients of rising powers of s."""

    synchronising_coefficient: float  # K_p = V V_g cos δ_0/X_g [p.u./rad]
    numerator: Polynomial
    denominator: Polynomial

    def response(self, angular_frequency: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        """Return G(jΩ) at angular frequencies Ω of any shape [rad/s]."""
        s = 1j * np.asarray(angular_frequency, dtype=np.float64)
        return np.asarray(self.numerator(s) / self.denominator(s))

    def closed_loop_poles(self) -> npt.NDArray[np.complex128]:
        """Return the zeros of 1 + G(s) [1/s], by rising real part."""
        roots = np.asarray((self.numerator + self.denominator).roots(), dtype=np.complex128)
        return roots[np.argsort(roots.real)]

    def margins(self) -> Margins:
        """Return the stability margins; crossovers are roots of a polynomial, so that none is missed."""
        roots = (_squared(self.numerator) - _squared(self.denominator)).trim().roots().astype(np.complex128)
        real = (np.abs(roots.imag) < 1e-7 * np.maximum(np.abs(roots), 1e-12)) & (roots.real > 1e-9)
        crossovers = np.sort(roots.real[real])
        # The loop's phase lies between -90° and -270° there: measured from -180°, upwards.
        found = np.degrees(np.angle(-self.response(crossovers)))
        least = int(np.argmin(found)) if found.size else None
        margin, crossover = (math.inf, math.nan) if least is None else (float(found[least]), float(crossovers[least]))
        stable = bool((self.closed_loop_poles().real < 0.0).all())
        return Margins(margin if stable else math.nan, crossover, stable)


def _squared(part: Polynomial) -> Polynomial:
    """Return |P(jΩ)|² of a polynomial P(s), as a polynomial in Ω."""
    on_axis = np.asarray(part.coef, dtype=np.complex128) * 1j ** np.arange(part.coef.size)
    return Polynomial((Polynomial(on_axis) * Polynomial(on_axis.conj())).coef.real)


def single_machine(
    law: TrackingLaw,
    wind_m_s: float,
    synchronising_coefficient: float = PAPER_SYNCHRONISING_COEFFICIENT,
    *,
    side: Side = "under",
    control: GridFormingParameters | None = None,
    turbine: TurbineParameters | None = None,
) -> SingleMachine:
    """Return the linearised loop of a strategy at nominal frequency, 50 Hz.

    A rotor that keeps its energy has 2H_m ω_m in the place of 2H_m.

    Args:
        law: the strategy.
        wind_m_s: wind speed, from 3 m/s to where the pitch protection holds the rotor [m/s].
        synchronising_coefficient: K_p, 0.01 … 100 [p.u./rad].
        side: the slope of g(ω) that counts at ω_st.
        control, turbine: parameters; the paper's by default.

    Raises:
        ValueError: a value is out of range, or there is no equilibrium with the blades at fine pitch.
    """
    turbine, control = turbine or TurbineParameters(), control or GridFormingParameters()
    require_range("synchronising coefficient", synchronising_coefficient, 0.01, 100.0, "p.u./rad")
    setpoint = control.frequency_setpoint_pu
    points, pitch = equilibria(setpoint, law, wind_m_s, control=control, turbine=turbine), PitchParameters()
    if not points:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s")
    point = points[-1]
    if point.rotor_speed_pu > pitch.rotor_speed_limit_pu or point.power_pu > pitch.captured_power_limit_pu:
        raise ValueError(f"the pitch protection holds the rotor at {wind_m_s:g} m/s; the paper's loop does not know it")
    rotor = point.rotor_speed_pu
    low, high = power_coefficient(
        point.tip_speed_ratio * np.array([1.0 - _STEP, 1.0 + _STEP]), 0.0, turbine.power_coefficient
    )
    slopes = {
        "under": (law.k_nominal - law.k_min) / (setpoint - control.frequency_min_pu),
        "over": (law.k_max - law.k_nominal) / (control.frequency_max_pu - setpoint),
    }
    # A = ∂p_w/∂ω_m, B1 = ∂P_st/∂ω_m and B2 = ∂P_st/∂ω [p.u./p.u.].
    a = turbine.wind_power_pu_per_cubic_wind * wind_m_s**3 * float(high - low) / (2.0 * _STEP * rotor)
    b1, b2 = 3.0 * law.k_nominal * rotor**2, slopes[side] * rotor**3
    s, tau = Polynomial([0.0, 1.0]), law.damping_time_constant_s
    rotor_dynamics = 2.0 * turbine.inertia_constant_s * (rotor if turbine.conserves_energy else 1.0) * s - a
    swing = 2.0 * control.inertia_constant_s * s - b2
    if math.isinf(tau):
        swing, filtered = swing + control.droop_gain_pu, Polynomial([1.0])
    else:
        filtered = tau * s + 1.0
        swing = swing * filtered + control.droop_gain_pu * tau * s
    numerator = _ANGULAR_FREQUENCY * synchronising_coefficient * (rotor_dynamics + b1) * filtered
    return SingleMachine(synchronising_coefficient, numerator.trim(), (s * swing * rotor_dynamics).trim())


def ideal_source_loop(control: GridFormingParameters | None = None) -> SingleMachine:
    """Return the loop of grid-forming control on an ideal DC source, without rotor and wind (paper, G_GFM)."""
    control = control or GridFormingParameters()
    numerator = Polynomial([_ANGULAR_FREQUENCY * PAPER_SYNCHRONISING_COEFFICIENT])
    denominator = Polynomial([0.0, control.droop_gain_pu, 2.0 * control.inertia_constant_s])
    return SingleMachine(PAPER_SYNCHRONISING_COEFFICIENT, numerator, denominator)
