"""One WTG by itself, as the paper analyses it: its steady states, and its loop on an infinite bus.

In steady state the rotor captures what the law delivers, p_w(ω_m) = g(ω) ω_m³ - D_p (ω - ω_st), the last term only
where the law keeps its droop (τ = ∞). Blades are at fine pitch; above 11.5 m/s the pitch protection slows a real rotor.
On an infinite bus the open loop is (paper, section on stability, equations (31)-(34))

    G(s) = ω_n K_p (2H_m s + B1 - A) / (s [2H s - B2 + D(s)] (2H_m s - A)),    D(s) = D_p τ s/(τ s + 1)

with D = D_p for τ = ∞, D = 0 for τ = 0, and A = B1 = B2 = 0 on an ideal DC source. Every strategy of the paper is this
loop with other numbers.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.converter import converter_constants, tracking_coefficient
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, TurbineParameters
from wtg_gym.physics.scenario import WIND_SPEED_RANGE
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.ranges import require_range

#: The paper's parameters.
TURBINE, CONTROL = TurbineParameters(), GridFormingParameters()
#: Winds of the two groups of its case studies [m/s].
WINDS = (11.4, 8.0)
#: The synchronising coefficient K_p at which the paper's margins come out [p.u./rad].
PAPER_SYNCHRONISING_COEFFICIENT = 1.45
#: The straight g(ω) with the droop cancelled: the loop whose margin the paper gives as about 28°.
LINEAR_UNDAMPED = dataclasses.replace(
    STRATEGIES["coordinated-linear"], name="coordinated-linear-undamped", damping_time_constant_s=0.0
)
#: The slope of g(ω) that counts at ω_st: that of under-frequency, or that of over-frequency.
Side = Literal["under", "over"]
SIDES: tuple[Side, ...] = ("under", "over")
#: Lowest and highest frequency of a question, and the step of the search for a critical one [p.u.].
_FREQUENCY_RANGE, _FREQUENCY_STEP = (0.5, 1.5), 1e-4
#: Least tip-speed ratio of the search for equilibria, below which the C_p curve is not valid, and its step [-].
_LEAST_RATIO, _RATIO_STEP = 1.0, 0.1
#: Nominal angular frequency [rad/s], and relative step of the slope of C_p, whose error is about the square of it.
_ANGULAR_FREQUENCY, _STEP = 100.0 * math.pi, 1e-5


# --- steady states ---------------------------------------------------------------------------------------------------


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
        turbine: TurbineParameters = TURBINE,
        control: GridFormingParameters = CONTROL,
    ) -> None:
        require_range("frequency", frequency_pu, *_FREQUENCY_RANGE, "p.u.")
        require_range("wind", wind_m_s, *WIND_SPEED_RANGE, "m/s")
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
        bounds = speeds[max(peak - 1, 0)], speeds[min(peak + 1, n - 1)]
        best = minimize_scalar(
            lambda x: -float(self.surplus(x)), bounds=bounds, method="bounded", options={"xatol": 1e-11}
        )
        return np.unique(np.append(speeds, best.x))

    def at(self, speed: float, *, stable: bool = True) -> OperatingPoint:
        power = self.k * speed**3 - self.droop
        return OperatingPoint(self.frequency_pu, speed, self.ratio_per_speed * speed, power, stable)


def equilibria(
    frequency_pu: float,
    law: TrackingLaw,
    wind_m_s: float,
    *,
    turbine: TurbineParameters = TURBINE,
    control: GridFormingParameters = CONTROL,
) -> tuple[OperatingPoint, ...]:
    """Return every steady state of a WTG by rising rotor speed; that of a running WTG is the last.

    Turbine and control are the paper's by default. A ValueError names a frequency outside 0.5 … 1.5 p.u., or a wind
    outside 3 … 25 m/s.
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
    """Return the frequency at which a WTG loses its equilibrium, from the set-point downwards [p.u.].

    None where it keeps one down to `lowest_pu` [p.u.]. A ValueError says so where there is none at the set-point.
    """
    setpoint = CONTROL.frequency_setpoint_pu
    require_range("lowest frequency", lowest_pu, _FREQUENCY_RANGE[0], setpoint, "p.u.")

    def margin(frequency: float) -> float:
        balance = _Balance(frequency, law, wind_m_s)
        return float(balance.surplus(balance.samples()).max())

    frequencies = np.linspace(setpoint, lowest_pu, 2 + int((setpoint - lowest_pu) / _FREQUENCY_STEP)).tolist()
    lost = next((i for i, frequency in enumerate(frequencies) if margin(frequency) < 0.0), None)
    if lost == 0:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s at the set-point either")
    return None if lost is None else float(brentq(margin, frequencies[lost], frequencies[lost - 1], xtol=1e-13))


def named_points(law: TrackingLaw, wind_m_s: float) -> dict[str, OperatingPoint]:
    """Return the points that the paper names on a power-frequency characteristic; errors as in the function above.

    A: at ω_st. B: at ω_min, or where the equilibrium is lost if that comes first. C: at ω_max. M: where the stable
    branch passes the maximum power point on the way from A to B. A point that does not exist is left out.
    """
    lowest, nominal = CONTROL.frequency_min_pu, CONTROL.frequency_setpoint_pu
    corners = {"A": nominal, "B": lowest, "C": CONTROL.frequency_max_pu}
    points = {name: states[-1] for name, f in corners.items() if (states := equilibria(f, law, wind_m_s))}
    critical = critical_frequency_pu(law, wind_m_s, lowest_pu=lowest)
    if critical is not None:
        # The two branches meet there, so that neither has a root; the surplus has its maximum at that speed.
        lost = _Balance(critical, law, wind_m_s)
        points["B"] = lost.at(float(max(lost.samples(), key=lost.surplus)))
    best_speed = tracking_point().tip_speed_ratio * wind_m_s / TURBINE.tip_speed_ratio_per_speed_m_s

    def surplus(frequency: float) -> float:
        return float(_Balance(frequency, law, wind_m_s).surplus(best_speed))

    # A rotor with a surplus at λ_opt stands above it, one with a deficit below.
    if surplus(nominal) > 1e-12 and surplus(lowest) <= -1e-12:
        crossing = float(brentq(surplus, lowest, nominal, xtol=1e-14))
        points["M"] = _Balance(crossing, law, wind_m_s).at(best_speed)
    return points


# --- single-machine loops --------------------------------------------------------------------------------------------


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
        return np.array(sorted((self.numerator + self.denominator).roots(), key=np.real), dtype=np.complex128)

    def margins(self) -> Margins:
        """Return the stability margins; crossovers are roots of a polynomial, so that none is missed."""
        roots = (_squared(self.numerator) - _squared(self.denominator)).trim().roots().astype(np.complex128)
        real = (np.abs(roots.imag) < 1e-7 * np.maximum(np.abs(roots), 1e-12)) & (roots.real > 1e-9)
        crossovers = np.sort(roots.real[real])
        # The loop's phase lies between -90° and -270° there: measured from -180°, upwards.
        phases = np.degrees(np.angle(-self.response(crossovers)))
        margin, crossover = min(zip(phases.tolist(), crossovers.tolist(), strict=True), default=(math.inf, math.nan))
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
    control: GridFormingParameters = CONTROL,
    turbine: TurbineParameters = TURBINE,
) -> SingleMachine:
    """Return the linearised loop of a strategy at 50 Hz; a rotor that keeps its energy has 2H_m ω_m in place of 2H_m.

    Turbine and control are the paper's by default. A ValueError names a K_p outside 0.01 … 100 p.u./rad, and a wind
    [m/s] without an equilibrium or at which the pitch protection acts.
    """
    require_range("synchronising coefficient", synchronising_coefficient, 0.01, 100.0, "p.u./rad")
    setpoint, pitch = control.frequency_setpoint_pu, PitchParameters()
    points = equilibria(setpoint, law, wind_m_s, control=control, turbine=turbine)
    if not points:
        raise ValueError(f"law {law.name!r} has no equilibrium at {wind_m_s:g} m/s")
    point = points[-1]
    if point.rotor_speed_pu > pitch.rotor_speed_limit_pu or point.power_pu > pitch.captured_power_limit_pu:
        raise ValueError(f"the pitch protection holds the rotor at {wind_m_s:g} m/s; the paper's loop does not know it")
    rotor, ratios = point.rotor_speed_pu, point.tip_speed_ratio * np.array([1.0 - _STEP, 1.0 + _STEP])
    low, high = power_coefficient(ratios, 0.0, turbine.power_coefficient)
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


def ideal_source_loop(control: GridFormingParameters = CONTROL) -> SingleMachine:
    """Return the loop of grid-forming control on an ideal DC source, without rotor and wind (paper, G_GFM)."""
    numerator = Polynomial([_ANGULAR_FREQUENCY * PAPER_SYNCHRONISING_COEFFICIENT])
    denominator = Polynomial([0.0, control.droop_gain_pu, 2.0 * control.inertia_constant_s])
    return SingleMachine(PAPER_SYNCHRONISING_COEFFICIENT, numerator, denominator)
