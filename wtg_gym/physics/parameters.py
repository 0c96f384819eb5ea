"""Every number of the model, once, with its unit and its source.

Derived values are properties, never free fields. Sources are short keys; SOURCES spells them out. Ranges are wide: they
exclude meaningless values, not unusual ones.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from wtg_gym.physics.checked import Checked, describe, parameter
from wtg_gym.physics.rotor_table import RotorTable
from wtg_gym.ranges import is_whole


@dataclass(frozen=True, kw_only=True)
class PowerCoefficientParameters(Checked):
    """Constants of C_p(λ, β) = c1 (c2/λi - c3 β - c5) e^(-c6/λi), 1/λi = 1/(λ + c7 β) - c8/(β³ + 1).

    Source: paper, equations (2) and (3). Their c4 is 0 here, so its exponent x is left out; c7 = 0.08 and c8 = 0.035
    stand as numbers there.
    """

    c1: float = parameter(0.5, "-", "inferred", "scale of C_p", 1e-3, 1e3)
    c2: float = parameter(100.0, "-", "inferred", "weight of 1/λi", 0.0, 1e5)
    c3: float = parameter(0.4, "1/deg", "Heier", "linear effect of the pitch angle", -1e3, 1e3)
    c5: float = parameter(5.0, "-", "inferred", "constant term", -1e4, 1e4)
    c6: float = parameter(17.3, "-", "inferred", "decay of the exponential", 0.0, 1e4)
    c7: float = parameter(0.08, "1/deg", "paper", "pitch term in the denominator of 1/λi", -10.0, 10.0)
    c8: float = parameter(0.035, "-", "paper", "offset of 1/λi", -10.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class TurbineParameters(Checked):
    """One wind turbine: rotor, aerodynamics and mechanical inertia."""

    rated_power_mw: float = parameter(5.0, "MW", "paper", "nominal power S_n", 1e-4, 1e3)
    blade_radius_m: float = parameter(63.0, "m", "paper", "blade radius R", 0.1, 1e3)
    air_density_kg_m3: float = parameter(1.23, "kg/m³", "paper", "air density ρ", 0.1, 10.0)
    nominal_rotor_speed_rad_s: float = parameter(1.27, "rad/s", "paper", "nominal rotor speed ω_tn", 1e-3, 1e3)
    inertia_constant_s: float = parameter(6.5, "s", "paper", "mechanical inertia constant H_m", 0.01, 1e4)
    conserves_energy: bool = parameter(
        False,
        "-",
        "design",
        "rotor equation 2H_m ω_m dω_m/dt = p_w - p, whose energy is H_m ω_m², instead of the paper's without ω_m",
    )
    power_coefficient: PowerCoefficientParameters | RotorTable = dataclasses.field(
        default_factory=PowerCoefficientParameters,
        metadata=describe("-", "paper", "constants of the C_p curve, or a table instead of it"),
    )

    @property
    def tip_speed_ratio_per_speed_m_s(self) -> float:
        """Return ω_tn R: λ = (ω_tn R) ω_m / v_w [m/s]."""
        return self.nominal_rotor_speed_rad_s * self.blade_radius_m

    @property
    def wind_power_pu_per_cubic_wind(self) -> float:
        """Return ρ π R² / (2 S_n): the power in the wind per v_w³ [p.u. s³/m³]."""
        swept = math.pi * self.blade_radius_m**2
        return 0.5 * self.air_density_kg_m3 * swept / (self.rated_power_mw * 1e6)


@dataclass(frozen=True, kw_only=True)
class PitchParameters(Checked):
    """Pitch protection: a PI on the larger of the captured-power and the rotor-speed excess.

    Like the pitch controller of WECC's generic wind turbine models (WTGPT_A) it acts on speed and power, but with one
    PI on the larger excess, and on captured power. Gain schedule and rate limit follow the NREL 5 MW design.
    Both limits lie above everything the paper's cases reach (captured power at most the available 1.0172 p.u. at
    11.4 m/s, rotor at most 1.23 p.u.), so that the blades stay at rest there.
    """

    captured_power_limit_pu: float = parameter(1.05, "p.u.", "design", "captured power held above rated", 0.01, 100.0)
    rotor_speed_limit_pu: float = parameter(
        1.27,
        "p.u.",
        "design",
        "rotor speed the pitch defends, 1.6 rad/s; the like number of ω_tn is chance",
        0.01,
        100.0,
    )
    speed_weight: float = parameter(
        4.0, "p.u./p.u.", "design", "p.u. of power excess that 1 p.u. of speed excess counts as", 0.0, 1e4
    )
    proportional_gain_deg: float = parameter(6.0, "deg/p.u.", "design", "gain on the excess", 0.0, 1e5)
    integral_gain_deg_s: float = parameter(10.0, "deg/(p.u. s)", "design", "integral gain on the excess", 0.0, 1e5)
    gain_schedule_deg: float = parameter(6.302336, "deg", "NREL 5 MW", "pitch at which the gains halve", 1e-3, 1e6)
    actuator_time_s: float = parameter(0.1, "s", "design", "lag of the pitch drive", 1e-3, 1e3)
    rate_limit_deg_s: float = parameter(8.0, "deg/s", "NREL 5 MW", "largest pitch rate", 1e-3, 1e4)
    largest_angle_deg: float = parameter(30.0, "deg", "design", "largest pitch angle", 0.0, 90.0)


@dataclass(frozen=True, kw_only=True)
class GridFormingParameters(Checked):
    """Grid-forming control of one WTG on its own base, and the paper's regulation range."""

    RISING = ("frequency_min_pu", "frequency_setpoint_pu", "frequency_max_pu")

    inertia_constant_s: float = parameter(5.0, "s", "paper", "virtual inertia constant H", 1e-3, 1e4)
    droop_gain_pu: float = parameter(62.5, "p.u./p.u.", "paper", "active power-frequency droop gain D_p", 0.0, 1e5)
    frequency_setpoint_pu: float = parameter(1.0, "p.u.", "paper", "frequency set-point ω_st", 0.5, 1.5)
    frequency_min_pu: float = parameter(0.992, "p.u.", "paper", "lower end of the regulation range ω_min", 0.5, 1.5)
    frequency_max_pu: float = parameter(1.008, "p.u.", "paper", "upper end of the regulation range ω_max", 0.5, 1.5)
    reactance_pu: float = parameter(
        0.55,
        "p.u.",
        "design",
        "X_g behind the voltage; with 0.1 p.u. more to a stiff bus K_p ≈ 1.5 (the paper's margins need 1.45), at a "
        "stiff bus 1.8, in this system 2.2",
        1e-4,
        100.0,
    )
    damping_time_constant_s: float = parameter(0.8, "s", "paper", "transient damping time constant τ", 0.0, 1e5)
    deloading_nominal: float = parameter(0.05, "-", "paper", "deloading d_n at ω_st", 0.0, 0.9)
    deloading_limit: float = parameter(0.10, "-", "paper", "deloading limit d_pr at ω_max", 0.0, 0.9)
    overload_limit_pu: float = parameter(
        1.1, "p.u.", "design", "power above which the converter counts as overloaded", 0.01, 100.0
    )


@dataclass(frozen=True, kw_only=True)
class ConverterLimitParameters(Checked):
    """What a converter and its turbine can give, on its own base: REGFM_A1's current and power limiters, a chopper."""

    current_max_pu: float = parameter(
        1.2, "p.u.", "REGFM_A1", "largest current; its size is cut, its angle kept", 0.05, 10.0
    )
    power_max_pu: float = parameter(1.1, "p.u.", "design", "power that the converter stands for long", 0.05, 10.0)
    power_min_pu: float = parameter(
        0.0,
        "p.u.",
        "design",
        "least power; what the grid presses in beyond it the chopper burns, not the rotor",
        -10.0,
        0.0,
    )
    power_gain: float = parameter(
        0.01, "p.u./p.u.", "REGFM_A1", "proportional gain k_ppmax of the power limiter, frequency per power", 0.0, 10.0
    )
    power_integral_gain: float = parameter(
        0.1, "p.u./(p.u. s)", "REGFM_A1", "integral gain k_ipmax of the power limiter", 0.0, 100.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.power_max_pu > self.current_max_pu:
            raise ValueError(
                f"power_max_pu = {self.power_max_pu:g} p.u. exceeds current_max_pu = {self.current_max_pu:g} p.u.: no "
                "converter gives it at nominal voltage"
            )


@dataclass(frozen=True, kw_only=True)
class VoltageControlParameters(Checked):
    """Voltage control of a converter with reactive droop, on its own base: REGFM_A1's with one integrator."""

    integral_gain: float = parameter(
        5.86, "p.u./(p.u. s)", "REGFM_A1", "integral gain k_iv of the voltage error", 1e-3, 1e3
    )
    droop_pu: float = parameter(
        0.05, "p.u./p.u.", "REGFM_A1", "reactive droop m_q: voltage per reactive power", 0.0, 1.0
    )
    reactive_max_pu: float = parameter(
        0.33, "p.u.", "FERC 827", "largest reactive power either way: a power factor of 0.95 at rated power", 0.0, 10.0
    )
    takeover_gain: float = parameter(
        1.0,
        "p.u./p.u.",
        "design",
        "weight of the reactive excess where it takes over from the voltage error",
        0.0,
        100.0,
    )
    internal_voltage_min_pu: float = parameter(0.5, "p.u.", "design", "least voltage behind X_g", 0.0, 1.0)
    internal_voltage_max_pu: float = parameter(
        1.4,
        "p.u.",
        "design",
        "largest voltage behind X_g, most of which is virtual: behind a filter of 0.15 p.u. (REGFM_A1) the bridge then "
        "gives at most 1.13 p.u.",
        1.0,
        10.0,
    )


@dataclass(frozen=True, kw_only=True)
class SheddingStage(Checked):
    """A stage of under-frequency load shedding: a share of every load is disconnected for the rest of the run."""

    frequency_pu: float = parameter(
        0.98, "p.u.", "ENTSO-E defence", "frequency of the centre of inertia at which it acts", 0.5, 1.0
    )
    share: float = parameter(
        0.05,
        "-",
        "ENTSO-E defence",
        "share of every load that it disconnects, of loads switched on by events too",
        0.0,
        1.0,
    )
    delay_s: float = parameter(0.2, "s", "design", "time below that frequency before it acts", 0.0, 60.0)


def european_shedding() -> tuple[SheddingStage, ...]:
    """Return the stages that continental Europe asks for: 5 % of the load at 49 Hz, then 8 % every 0.2 Hz to 48 Hz."""
    levels = ((49.0, 0.05), (48.8, 0.08), (48.6, 0.08), (48.4, 0.08), (48.2, 0.08), (48.0, 0.08))
    return tuple(SheddingStage(frequency_pu=level / 50.0, share=share) for level, share in levels)


@dataclass(frozen=True, kw_only=True)
class ProtectionParameters(Checked):
    """What refuses a start, ends a run, or trips a group."""

    stall_tip_speed_ratio: float = parameter(
        3.5, "-", "design", "a rotor at fine pitch and below this tip-speed ratio has stalled", 0.0, 100.0
    )
    stall_pitch_deg: float = parameter(
        0.5, "deg", "design", "pitch up to which a low tip-speed ratio counts as a stall", 0.0, 90.0
    )
    over_speed_pu: float = parameter(1.4, "p.u.", "design", "rotor over-speed trip", 0.1, 1e6)
    rotor_speed_min_pu: float = parameter(
        0.0,
        "p.u.",
        "design",
        "rotor under-speed trip; 0 for none. The NREL 5 MW turbine operates from 6.9 rpm on, 0.57 p.u.",
        0.0,
        1.0,
    )
    frequency_min_pu: float = parameter(
        0.95, "p.u.", "ENTSO-E", "lower end of the range units must ride through, 47.5 Hz", 0.0, 1.0
    )
    frequency_max_pu: float = parameter(
        1.03, "p.u.", "ENTSO-E", "upper end of the range units must ride through, 51.5 Hz", 1.0, 10.0
    )
    angle_spread_max_deg: float = parameter(
        180.0,
        "deg",
        "design",
        "largest difference of two units' angles; beyond, nothing pulls them together again: synchronism is lost",
        1.0,
        1e9,
    )
    low_voltage_pu: float = parameter(
        0.85,
        "p.u.",
        "ENTSO-E",
        "terminal voltage below which a unit must stay connected for low_voltage_time_s only",
        0.0,
        2.0,
    )
    low_voltage_time_s: float = parameter(
        3.0,
        "s",
        "ENTSO-E",
        "time below low_voltage_pu after which the voltage has collapsed: upper end of 1.5 … 3.0 s for power park "
        "modules at their connection point; taken at the terminals here",
        0.0,
        1e9,
    )
    internal_voltage_max_pu: float = parameter(
        2.0,
        "p.u.",
        "design",
        "largest voltage behind the internal reactance that a unit may start with: through X_g = 0.55 p.u. it drives "
        "1.6 p.u. of reactive current at 1.1 p.u. of terminal voltage, and converters end at about 1.2",
        0.1,
        1e9,
    )


@dataclass(frozen=True, kw_only=True)
class WtgGroup(Checked):
    """Identical grid-forming WTGs at one bus, as one aggregate.

    Args:
        bus: bus number of the network.
        n_turbines: how many turbines of `turbine.rated_power_mw` it stands for.
    """

    bus: int = parameter(2, "-", "paper", "bus number")
    n_turbines: float = parameter(10.0, "-", "paper", "number of turbines in the group", 1e-3, 1e4)


def default_groups(n_groups: int = 2, bus: int = 2) -> tuple[WtgGroup, ...]:
    """Return `n_groups` equal groups at a bus that share the paper's twenty turbines (100 MW)."""
    if not is_whole(n_groups) or not 1 <= n_groups <= 1024:
        raise ValueError(f"the number of WTG groups must be 1 … 1024, got {n_groups!r}")
    return tuple(WtgGroup(bus=bus, n_turbines=20.0 / n_groups) for _ in range(n_groups))
