"""A group of equal wind turbine generators: rotor, pitch protection and grid-forming converter, on its own base.

    2H_m ω̇_m = p_w - p,    p_w = ρ π R² v³ C_p(λ, β) / (2 S_n),    λ = ω_tn R ω_m / v

Source: paper, equations (1)-(5). After a trip the states of a group keep their last values; it feeds in nothing. An
*extended* group has some of these: limits and voltage control (:mod:`~wtg_gym.physics.converter`), a rotor that keeps
its energy H_m ω_m²: 2H_m ω_m ω̇_m = p_w - max(p, p_min).
"""

import math
from typing import NamedTuple

from wtg_gym.physics import aerodynamics, parameters
from wtg_gym.physics import converter as gfm
from wtg_gym.physics.rotor_table import Grid
from wtg_gym.systems.elementary import clip, limited_rate
from wtg_gym.systems.systems import each


class Pitch(NamedTuple):
    power_limit: float  # p_max at ω_st [p.u.]
    power_limit_low: float  # at ω_min
    power_limit_high: float  # at ω_max
    rotor_speed_limit: float  # ω_m,max [p.u.]
    speed_weight: float  # K_ω [p.u./p.u.]
    proportional_gain: float  # K_βP [deg/p.u.]
    integral_gain: float  # K_βI [deg/(p.u. s)]
    inv_gain_schedule: float  # 1/β_K [1/deg]
    inv_actuator_time: float  # 1/T_β [1/s]
    rate_limit: float  # [deg/s]
    largest_angle: float  # [deg]


class PitchState(NamedTuple):
    pitch_integral: float  # I [deg]
    pitch: float  # β [deg]


def pitch_rates(s: PitchState, captured: float, rotor_speed: float, power_limit: float, c: Pitch) -> PitchState:
    """Return the rates [deg/s] at a captured power, a rotor speed and a limit p_max [p.u.].

    A PI controller on the larger of the power and the speed excess, with a lagging, slow drive:

        e = max(p_w - p_max, K_ω (ω_m - ω_m,max)) / (1 + β/β_K),    İ = K_βI e,    T_β β̇ = I + K_βP e - β

    with limits on I, on the demand and on β̇; I and β stay exactly at zero while there is no excess. In an extended
    group p_max depends on the frequency as the prescribed power does: its shares at ω_min, ω_st and ω_max are 1,
    1 - d_n and 1 - d_pr, so that a group holds its reserve above rated wind too. Like WECC's pitch
    controller WTGPT_A it acts on speed and power, but with one PI. Source of gain schedule and rate limit: J. Jonkman
    et al.: Definition of a 5-MW Reference Wind Turbine, NREL/TP-500-38060.
    """
    excess = max(captured - power_limit, c.speed_weight * (rotor_speed - c.rotor_speed_limit))
    scheduled = excess / (1.0 + s.pitch * c.inv_gain_schedule)
    demand = clip(s.pitch_integral + c.proportional_gain * scheduled, 0.0, c.largest_angle)
    return PitchState(
        pitch_integral=limited_rate(c.integral_gain * scheduled, s.pitch_integral, 0.0, c.largest_angle),
        pitch=clip((demand - s.pitch) * c.inv_actuator_time, -c.rate_limit, c.rate_limit),
    )


class Rotor(NamedTuple):
    curve: aerodynamics.CurveConstants
    grid: Grid
    tip_speed: float  # ω_tn R [m/s]
    wind_power: float  # ρ π R² / (2 S_n) [p.u. s³/m³]
    inv_two_h: float  # 1/(2 H_m) [1/s]
    tip_speed_ratio_opt: float  # λ_opt
    tip_speed_ratio_limit: float  # λ_pr
    available_per_cubic_wind: float  # available power / v³ at β = 0 [p.u. s³/m³]


def tip_speed_ratio(rotor_speed: float, wind: float, c: Rotor) -> float:
    """Return λ = ω_m ω_tn R / v of a rotor speed ω_m [p.u.] in a wind v [m/s]."""
    return c.tip_speed * rotor_speed / wind


class Limits(NamedTuple):
    """Limits of the protections."""

    stall_tip_speed_ratio: float
    stall_pitch: float  # [deg]
    over_speed: float  # [p.u.]
    rotor_speed_min: float  # [p.u.]
    frequency_min: float  # frequency of the centre of inertia [p.u.]
    frequency_max: float
    angle_spread: float  # largest difference of the units' angles [rad]
    low_voltage: float  # [p.u.]
    low_voltage_time: float  # [s]


class Turbine(NamedTuple):
    rotor: Rotor
    pitch: Pitch
    converter: gfm.Converter
    limits: Limits


class Extension(NamedTuple):
    """Constants of an extended group."""

    limits: gfm.ConverterLimits
    voltage: gfm.VoltageControl
    conserves_energy: float  # 1 for the rotor that keeps its energy, else 0


class WtgState(NamedTuple):
    converter: gfm.ConverterState
    rotor_speed: float  # ω_m [p.u.]
    pitch: PitchState
    energy_captured: float  # ∫ p_w dt [p.u. s]
    energy_delivered: float  # ∫ p dt [p.u. s]


class WtgInput(NamedTuple):
    """Constant over a control interval."""

    emf: float  # voltage behind the reactance [p.u.]
    law: gfm.Law
    connected: float  # 1, or 0 after a trip
    wind_start: float  # at the ends of the interval [m/s]
    wind_end: float


class WtgOutput(NamedTuple):
    wind: float  # v [m/s]
    power: float  # p into the grid [p.u.]
    captured: float  # p_w [p.u.]
    coefficient: float  # k in use [p.u.]
    shift: float  # Δω that the power limiter adds to the frequency; 0 without one [p.u.]


class WtgExtremes(NamedTuple):
    """Extremes since the start of a run."""

    peak_power: float  # [p.u.]
    least_tsr: float
    largest_tsr: float
    overload_time: float  # [s]


class ExtensionState(NamedTuple):
    """States of an extended group, besides its others."""

    limits: gfm.LimitState
    internal_voltage: float  # E, instead of the constant `emf` [p.u.]


class ExtensionOutput(NamedTuple):
    """Outputs of an extended group, on its own base except X_v."""

    limiting_reactance: float  # X_v [p.u. of the system]
    terminal_voltage: float  # V [p.u.]
    reactive: float  # q at the terminal [p.u.]
    current: float  # |I| [p.u.]
    cut: float  # X_v |I|, what the current limiter takes from E [p.u.]


def wind_at(u: WtgInput, fraction: float) -> float:
    """Return the wind [m/s] when a fraction 0 … 1 of the control interval has passed: linear between its ends."""
    return u.wind_start + fraction * (u.wind_end - u.wind_start)


def wtg_rates(
    s: WtgState,
    power: float,
    captured: float,
    wind: float,
    u: WtgInput,
    c: Turbine,
    reference_speed: float,
    omega_n: float,
    limiter: tuple[float, float] | None = None,
) -> tuple[WtgState, WtgOutput]:
    """Return rates and outputs, at powers p into the grid and p_w from the wind, and a speed of the first unit [p.u.].

    `limiter` of an extended group is Δω, and the most that k ω_m³ can be [p.u.].
    """
    converter, k = gfm.converter_rates(
        s.converter, s.rotor_speed, power, u.law, c.converter, reference_speed, omega_n, limiter
    )
    power_limit = c.pitch.power_limit
    if limiter is not None:
        at_corners = c.pitch.power_limit_low, power_limit, c.pitch.power_limit_high
        power_limit = gfm.tracking_coefficient(s.converter.speed + limiter[0], *at_corners, c.converter.corners)
    pitch = pitch_rates(s.pitch, captured, s.rotor_speed, power_limit, c.pitch)
    free = WtgState(converter, c.rotor.inv_two_h * (captured - power), pitch, captured, power)
    rates = each(lambda rate: u.connected * rate, free)
    shift = 0.0 if limiter is None else u.connected * limiter[0]
    return rates, WtgOutput(wind, power, u.connected * captured, k, shift)


def frequency_of(s: WtgState, output: WtgOutput) -> float:
    """Return the frequency of a group's voltage, ω + Δω [p.u.]."""
    return s.converter.speed + output.shift


def extension_limited(x: ExtensionState, e: Extension) -> ExtensionState:
    """Return the further states of an extended group, held within their limits."""
    low, high = e.voltage.internal_voltage_min, e.voltage.internal_voltage_max
    limits = x.limits._replace(over_power=min(x.limits.over_power, 0.0), under_power=max(x.limits.under_power, 0.0))
    return ExtensionState(limits, clip(x.internal_voltage, low, high))


def wtg_limited(s: WtgState, c: Turbine) -> WtgState:
    most = c.pitch.largest_angle
    return s._replace(pitch=PitchState(clip(s.pitch.pitch_integral, 0.0, most), clip(s.pitch.pitch, 0.0, most)))


def turbine_constants(
    turbine: parameters.TurbineParameters,
    pitch: parameters.PitchParameters,
    control: parameters.GridFormingParameters,
    protection: parameters.ProtectionParameters,
    extended: bool,
) -> Turbine:
    """Return the constants of a turbine, extended or not, its controls and its protections."""
    reserve = (1.0, 1.0 - control.deloading_nominal, 1.0 - control.deloading_limit) if extended else (1.0, 1.0, 1.0)
    low, nominal, high = (pitch.captured_power_limit_pu * share for share in reserve)
    best = aerodynamics.tracking_point(0.0, turbine)
    rotor = Rotor(
        curve=aerodynamics.curve_constants(turbine.power_coefficient),
        grid=aerodynamics.surface_of(turbine.power_coefficient)[0],
        tip_speed=turbine.tip_speed_ratio_per_speed_m_s,
        wind_power=turbine.wind_power_pu_per_cubic_wind,
        inv_two_h=0.5 / turbine.inertia_constant_s,
        tip_speed_ratio_opt=best.tip_speed_ratio,
        tip_speed_ratio_limit=aerodynamics.tracking_point(control.deloading_limit, turbine).tip_speed_ratio,
        available_per_cubic_wind=turbine.wind_power_pu_per_cubic_wind * best.power_coefficient,
    )
    return Turbine(
        rotor,
        parameters.constants_of(Pitch, pitch, power_limit=nominal, power_limit_low=low, power_limit_high=high),
        gfm.converter_constants(control),
        parameters.constants_of(Limits, protection, angle_spread=math.radians(protection.angle_spread_max_deg)),
    )
