"""One grid-forming WTG on an infinite bus: the paper's open-loop transfer functions and their margins.

    G(s) = ω_n K_p (2H_m s + B1 - A) / (s [2H s - B2 + D(s)] (2H_m s - A)),    D(s) = D_p τ s/(τ s + 1)

with D = D_p for τ = ∞ and D = 0 for τ = 0. Every strategy of the paper is this loop with other numbers; on the ideal DC
source A = B1 = B2 = 0. Source: paper, section on stability (equations (31)-(34)).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.modes import Side
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.ranges import require_range
from wtg_gym.reproduce.steady_states import stable_equilibrium

#: The synchronising coefficient at which the paper's margins come out [p.u./rad].
PAPER_SYNCHRONISING_COEFFICIENT = 1.45
#: Nominal angular frequency of the paper, 50 Hz [rad/s].
_ANGULAR_FREQUENCY = 100.0 * math.pi
#: Relative step of the numerical slope of C_p; its error is about the square of it.
_STEP = 1e-5


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Stability margins of an open loop; not a number where the closed loop is unstable."""

    phase_margin_deg: float  # smallest distance to -180° over all gain crossovers [deg]
    crossover_rad_s: float  # the gain crossover at which it is found [rad/s]
    gain_margin_db: float  # smallest increase of the gain that makes the loop unstable; infinite where none does [dB]
    stable: bool  # all poles of the closed loop lie in the left half plane


@dataclass(frozen=True, kw_only=True)
class SingleMachine:
    """The linearised WTG at an operating point, and its loop."""

    law: str  # name of the strategy
    wind_m_s: float = math.nan  # [m/s]
    #: rotor_speed_pu, power_pu: ω_m and p of the operating point [p.u.].
    rotor_speed_pu: float = math.nan
    power_pu: float = math.nan
    #: β of the operating point. It counts as constant: above 0 the loop leaves the pitch control out [deg].
    pitch_deg: float = 0.0
    aerodynamic_slope: float = 0.0  # A = ∂p_w/∂ω_m at constant pitch [p.u./p.u.]
    rotor_slope: float = 0.0  # B1 = ∂P_st/∂ω_m = 3 k ω_m² [p.u./p.u.]
    frequency_slope: float = 0.0  # B2 = ω_m³ dg/dω [p.u./p.u.]
    synchronising_coefficient: float  # K_p = V V_g cos δ_0/X_g [p.u./rad]
    #: numerator, denominator: G(s), coefficients of rising powers of s.
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def response(self, angular_frequency: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        """Return G(jΩ) at angular frequencies Ω of any shape [rad/s]."""
        s = 1j * np.asarray(angular_frequency, dtype=np.float64)
        return np.asarray(Polynomial(self.numerator)(s) / Polynomial(self.denominator)(s))

    def closed_loop_poles(self) -> npt.NDArray[np.complex128]:
        """Return the zeros of 1 + G(s) [1/s], by rising real part."""
        roots = np.asarray((Polynomial(self.numerator) + Polynomial(self.denominator)).roots(), dtype=np.complex128)
        return roots[np.argsort(roots.real)]

    def margins(self) -> Margins:
        """Return the stability margins; crossovers are roots of polynomials, so that none is missed."""
        on_axis = [
            Polynomial([c * 1j**power for power, c in enumerate(coefficients)])
            for coefficients in (self.numerator, self.denominator)
        ]
        squares = [Polynomial((p * _conjugate(p)).coef.real) for p in on_axis]
        phase_margin, crossover = math.inf, math.nan
        for w in _positive_real_roots(squares[0] - squares[1]):
            value = complex(self.response(w))
            # The loop's phase lies between -90° and -270° there: measured from -180°, upwards.
            margin = math.degrees(math.remainder(math.atan2(value.imag, value.real) + math.pi, 2.0 * math.pi))
            if margin < phase_margin:
                phase_margin, crossover = margin, w
        if not (self.closed_loop_poles().real < 0.0).all():
            return Margins(phase_margin_deg=math.nan, crossover_rad_s=crossover, gain_margin_db=math.nan, stable=False)
        # G is real where the imaginary part of N conj(D), which is odd in Ω, is zero.
        real_at = _positive_real_roots(Polynomial((on_axis[0] * _conjugate(on_axis[1])).coef.imag))
        responses = [complex(self.response(w)) for w in real_at]
        gains = [20.0 * math.log10(1.0 / abs(value)) for value in responses if value.real < 0.0]
        return Margins(
            phase_margin_deg=phase_margin,
            crossover_rad_s=crossover,
            gain_margin_db=min((gain for gain in gains if gain > 0.0), default=math.inf),
            stable=True,
        )


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
        wind_m_s: wind speed, 3 … 25 [m/s]. Where the pitch protection holds the rotor, its angle counts as constant.
        synchronising_coefficient: K_p, 0.01 … 100 [p.u./rad].
        side: the slope of g(ω) that counts at ω_st.
        control, turbine: parameters; the paper's by default.

    Raises:
        ValueError: a value is out of range, or there is no equilibrium.
    """
    turbine, control = turbine or TurbineParameters(), control or GridFormingParameters()
    require_range("synchronising coefficient", synchronising_coefficient, 0.01, 100.0, "p.u./rad")
    if side not in ("under", "over"):
        raise ValueError(f"side must be 'under' or 'over', got {side!r}")
    point = stable_equilibrium(control.frequency_setpoint_pu, law, wind_m_s, control=control, turbine=turbine)
    if point is None:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s")
    rotor = point.rotor_speed_pu
    ratio = point.tip_speed_ratio * np.array([1.0 - _STEP, 1.0 + _STEP])
    low, high = power_coefficient(ratio, point.pitch_deg, turbine.power_coefficient)
    if side == "under":
        span = control.frequency_setpoint_pu - control.frequency_min_pu
        slope = (law.k_nominal - law.k_min) / span
    else:
        span = control.frequency_max_pu - control.frequency_setpoint_pu
        slope = (law.k_max - law.k_nominal) / span
    a = turbine.wind_power_pu_per_cubic_wind * wind_m_s**3 * float(high - low) / (2.0 * _STEP * rotor)
    b1, b2 = 3.0 * law.k_nominal * rotor**2, slope * rotor**3
    s, tau = Polynomial([0.0, 1.0]), law.damping_time_constant_s
    inertia_s = turbine.inertia_constant_s * (rotor if turbine.conserves_energy else 1.0)
    rotor_dynamics = 2.0 * inertia_s * s - a
    swing = 2.0 * control.inertia_constant_s * s - b2
    if math.isinf(tau):
        swing, filtered = swing + control.droop_gain_pu, Polynomial([1.0])
    else:
        filtered = tau * s + 1.0
        swing = swing * filtered + control.droop_gain_pu * tau * s
    numerator = _ANGULAR_FREQUENCY * synchronising_coefficient * (rotor_dynamics + b1) * filtered
    return SingleMachine(
        law=law.name,
        wind_m_s=wind_m_s,
        rotor_speed_pu=rotor,
        power_pu=point.power_pu,
        pitch_deg=point.pitch_deg,
        aerodynamic_slope=a,
        rotor_slope=b1,
        frequency_slope=b2,
        synchronising_coefficient=synchronising_coefficient,
        numerator=tuple(float(c) for c in numerator.trim().coef),
        denominator=tuple(float(c) for c in (s * swing * rotor_dynamics).trim().coef),
    )


def with_moving_voltage(loop: SingleMachine, effect: float, decay_1_s: float) -> SingleMachine:
    """Return a loop whose voltage behind X_g follows the angle: K_p + K_1/(s + a) in the place of K_p.

    Args:
        loop: with the voltage held.
        effect: K_1 = ∂p/∂E ∂Ė/∂δ [p.u./(rad s)].
        decay_1_s: a = -∂Ė/∂E [1/s].
    """
    k_p = loop.synchronising_coefficient
    ratio = Polynomial([decay_1_s + effect / k_p, 1.0])
    return dataclasses.replace(
        loop,
        numerator=tuple(float(c) for c in (Polynomial(loop.numerator) * ratio).coef),
        denominator=tuple(float(c) for c in (Polynomial(loop.denominator) * Polynomial([decay_1_s, 1.0])).coef),
    )


def ideal_source_loop(
    synchronising_coefficient: float = PAPER_SYNCHRONISING_COEFFICIENT, *, control: GridFormingParameters | None = None
) -> SingleMachine:
    """Return the loop of grid-forming control on an ideal DC source (paper, equation for G_GFM).

    Args, Raises: as for :func:`single_machine`; no rotor and no wind take part.
    """
    require_range("synchronising coefficient", synchronising_coefficient, 0.01, 100.0, "p.u./rad")
    control = control or GridFormingParameters()
    return SingleMachine(
        law="ideal-source",
        synchronising_coefficient=synchronising_coefficient,
        numerator=(_ANGULAR_FREQUENCY * synchronising_coefficient,),
        denominator=(0.0, control.droop_gain_pu, 2.0 * control.inertia_constant_s),
    )


def _conjugate(polynomial: Polynomial) -> Polynomial:
    return Polynomial(polynomial.coef.conjugate())


def _positive_real_roots(polynomial: Polynomial) -> list[float]:
    roots = np.asarray(polynomial.trim().roots(), dtype=np.complex128)
    real = np.abs(roots.imag) < 1e-7 * np.maximum(np.abs(roots), 1e-12)
    return sorted(float(root.real) for root in roots[real] if root.real > 1e-9)
