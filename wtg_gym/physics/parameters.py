"""Every number of the model, once, with its unit and its source.

Derived values are properties, never free fields. Sources are short keys; SOURCES spells them out.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from wtg_gym.physics.rotor_table import RotorTable

#: What the short keys in each field's `source` stand for.
SOURCES = {
    "paper": "Chen, Xi, Cheng, Dörfler, Lestas: Coordinated Primary Frequency Regulation and Grid-Forming Control "
    "for Wind Turbine Generators (2026), table of parameters",
    "inferred": "the only round set found that meets λ_opt, C_popt, λ_n and λ_pr of the paper's table to every "
    "printed digit; the paper prints no c_1 … c_6",
    "Heier": "S. Heier: Grid Integration of Wind Energy, the exponential C_p form and its pitch term",
    "Milano": "F. Milano: IEEE 14-bus dynamic data as distributed with PSAT (d_014_dyn)",
    "IEEE 14": "IEEE 14-bus power-flow test case, University of Washington archive; the same numbers as MATPOWER's "
    "case14. Voltages of machine buses are its scheduled ones",
    "NREL 5 MW": "J. Jonkman et al.: Definition of a 5-MW Reference Wind Turbine, NREL/TP-500-38060 (2009)",
    "calibrated": "chosen so that the paper's settled frequency (0.996 p.u.) and the final power of WTG 2 below 0.3 "
    "p.u. both come out",
    "ENTSO-E": "Commission Regulation (EU) 2016/631 (requirements for generators), article 13, continental Europe; "
    "voltages: article 16",
    "REGFM_A1": "W. Du et al.: Model Specification of Droop-Controlled, Grid-Forming Inverters (REGFM_A1), Pacific "
    "Northwest National Laboratory, PNNL-32278 (2021), approved by WECC",
    "ENTSO-E defence": "Commission Regulation (EU) 2017/2196 (emergency and restoration), annex: automatic low "
    "frequency demand disconnection, continental Europe",
    "ENTSO-E operation": "Commission Regulation (EU) 2017/1485 (system operation), annex V: frequency containment "
    "reserves, continental Europe",
    "FERC 827": "Federal Energy Regulatory Commission, Order 827 (2016): reactive power requirements for "
    "non-synchronous generation",
    "HYGOV": "typical data of the hydro governor HYGOV of PSS/E; P. Kundur: Power System Stability and Control, 9.1",
    "design": "a design value of this benchmark",
}


def describe(unit: str, source: str, doc: str) -> dict[str, str]:
    """Return a field's metadata: its unit, the key of its source in SOURCES, and what it is."""
    return {"unit": unit, "source": source, "doc": doc}


def parameter(default: Any, unit: str, source: str, doc: str) -> Any:
    """Return a dataclass field with a default value and :func:`describe`'s metadata."""
    return dataclasses.field(default=default, metadata=describe(unit, source, doc))


def required(unit: str, source: str, doc: str) -> Any:
    """Return a dataclass field without a default and with :func:`describe`'s metadata."""
    return dataclasses.field(metadata=describe(unit, source, doc))


@dataclass(frozen=True, kw_only=True)
class PowerCoefficientParameters:
    """Constants of C_p(λ, β) = c1 (c2/λi - c3 β - c4 β^x - c5) e^(-c6/λi), 1/λi = 1/(λ + 0.08 β) - 0.035/(β³ + 1).

    Source: paper, equation `cp`. c4 = 0, so the exponent x has no effect and is left out.
    """

    c1: float = parameter(0.5, "-", "inferred", "scale of C_p")
    c2: float = parameter(100.0, "-", "inferred", "weight of 1/λi")
    c3: float = parameter(0.4, "1/deg", "Heier", "linear effect of the pitch angle")
    c5: float = parameter(5.0, "-", "inferred", "constant term")
    c6: float = parameter(17.3, "-", "inferred", "decay of the exponential")
    c7: float = parameter(0.08, "1/deg", "paper", "pitch term in the denominator of 1/λi")
    c8: float = parameter(0.035, "-", "paper", "offset of 1/λi")


@dataclass(frozen=True, kw_only=True)
class TurbineParameters:
    """One wind turbine: rotor, aerodynamics and mechanical inertia."""

    rated_power_mw: float = parameter(5.0, "MW", "paper", "nominal power S_n")
    blade_radius_m: float = parameter(63.0, "m", "paper", "blade radius R")
    air_density_kg_m3: float = parameter(1.23, "kg/m³", "paper", "air density ρ")
    nominal_rotor_speed_rad_s: float = parameter(1.27, "rad/s", "paper", "nominal rotor speed ω_tn")
    inertia_constant_s: float = parameter(6.5, "s", "paper", "mechanical inertia constant H_m")
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
class PitchParameters:
    """Pitch protection: a PI on the larger of the captured-power and the rotor-speed excess.

    The two paths, speed and power compensation, follow the pitch controller of WECC's generic wind turbine models
    (WTGPT_A); gain schedule and rate limit follow the NREL 5 MW design. Both limits lie above everything the paper's
    cases reach (captured power at most the available 1.0172 p.u. at 11.4 m/s, rotor at most 1.23 p.u.), so that the
    blades stay at rest there.
    """

    captured_power_limit_pu: float = parameter(1.05, "p.u.", "design", "captured power held above rated")
    rotor_speed_limit_pu: float = parameter(1.27, "p.u.", "design", "rotor speed the pitch defends")
    speed_weight: float = parameter(4.0, "p.u./p.u.", "design", "power excess one p.u. of speed counts as")
    proportional_gain_deg: float = parameter(6.0, "deg/p.u.", "design", "gain on the excess")
    integral_gain_deg_s: float = parameter(10.0, "deg/(p.u. s)", "design", "integral gain on the excess")
    gain_schedule_deg: float = parameter(6.302336, "deg", "NREL 5 MW", "pitch at which the gains halve")
    actuator_time_s: float = parameter(0.1, "s", "design", "lag of the pitch drive")
    rate_limit_deg_s: float = parameter(8.0, "deg/s", "NREL 5 MW", "largest pitch rate")
    largest_angle_deg: float = parameter(30.0, "deg", "design", "largest pitch angle")


@dataclass(frozen=True, kw_only=True)
class GridFormingParameters:
    """Grid-forming control of one WTG on its own base, and the paper's regulation range."""

    inertia_constant_s: float = parameter(5.0, "s", "paper", "virtual inertia constant H")
    droop_gain_pu: float = parameter(62.5, "p.u./p.u.", "paper", "active power-frequency droop gain D_p")
    frequency_setpoint_pu: float = parameter(1.0, "p.u.", "paper", "frequency set-point ω_st")
    frequency_min_pu: float = parameter(0.992, "p.u.", "paper", "lower end of the regulation range ω_min")
    frequency_max_pu: float = parameter(1.008, "p.u.", "paper", "upper end of the regulation range ω_max")
    reactance_pu: float = parameter(
        0.55,
        "p.u.",
        "design",
        "X_g behind the voltage; on a stiff bus at 1 p.u. K_p ≈ 1.5 as the paper's margins need, in this system 2.2",
    )
    damping_time_constant_s: float = parameter(0.8, "s", "paper", "transient damping time constant τ")
    deloading_nominal: float = parameter(0.05, "-", "paper", "deloading d_n at ω_st")
    deloading_limit: float = parameter(0.10, "-", "paper", "deloading limit d_pr at ω_max")
    overload_limit_pu: float = parameter(1.1, "p.u.", "design", "power above which the converter counts as overloaded")


@dataclass(frozen=True, kw_only=True)
class ConverterLimitParameters:
    """What a converter and its turbine can give, on its own base: REGFM_A1's current and power limiters, a chopper."""

    current_max_pu: float = parameter(1.2, "p.u.", "REGFM_A1", "largest current; its size is cut, its angle kept")
    power_max_pu: float = parameter(1.1, "p.u.", "design", "power that the converter stands for long")
    power_min_pu: float = parameter(
        0.0, "p.u.", "design", "least power; what the grid presses in beyond it the chopper burns, not the rotor"
    )
    power_gain: float = parameter(
        0.01, "p.u./p.u.", "REGFM_A1", "proportional gain k_ppmax of the power limiter, frequency per power"
    )
    power_integral_gain: float = parameter(
        0.1, "p.u./(p.u. s)", "REGFM_A1", "integral gain k_ipmax of the power limiter"
    )


@dataclass(frozen=True, kw_only=True)
class VoltageControlParameters:
    """Voltage control of a converter with reactive droop, on its own base: REGFM_A1's with one integrator."""

    integral_gain: float = parameter(5.86, "p.u./(p.u. s)", "REGFM_A1", "integral gain k_iv of the voltage error")
    droop_pu: float = parameter(0.05, "p.u./p.u.", "REGFM_A1", "reactive droop m_q: voltage per reactive power")
    reactive_max_pu: float = parameter(
        0.33, "p.u.", "FERC 827", "largest reactive power either way: a power factor of 0.95 at rated power"
    )
    takeover_gain: float = parameter(
        1.0, "p.u./p.u.", "design", "weight of the reactive excess where it takes over from the voltage error"
    )
    internal_voltage_min_pu: float = parameter(0.5, "p.u.", "design", "least voltage behind X_g")
    internal_voltage_max_pu: float = parameter(
        1.4,
        "p.u.",
        "design",
        "largest voltage behind X_g, most of which is virtual: behind a filter of 0.15 p.u. (REGFM_A1) the bridge then "
        "gives at most 1.13 p.u.",
    )


@dataclass(frozen=True, kw_only=True)
class SheddingStage:
    """A stage of under-frequency load shedding: a share of every load is disconnected for the rest of the run."""

    frequency_pu: float = parameter(
        0.98, "p.u.", "ENTSO-E defence", "frequency of the centre of inertia at which it acts"
    )
    share: float = parameter(
        0.05, "-", "ENTSO-E defence", "share of the load connected at the start that it disconnects"
    )
    delay_s: float = parameter(0.2, "s", "design", "time below that frequency before it acts")


def european_shedding(frequency_hz: float = 50.0) -> tuple[SheddingStage, ...]:
    """Return the stages that continental Europe asks for: 5 % at 49 Hz, 45 % by 48 Hz in steps of 8 %."""
    levels = ((49.0, 0.05), (48.8, 0.08), (48.6, 0.08), (48.4, 0.08), (48.2, 0.08), (48.0, 0.08))
    return tuple(SheddingStage(frequency_pu=level / frequency_hz, share=share) for level, share in levels)


@dataclass(frozen=True, kw_only=True)
class ProtectionParameters:
    """What refuses a start, ends a run, or trips a group."""

    stall_tip_speed_ratio: float = parameter(3.5, "-", "design", "below it, at fine pitch, a rotor has stalled")
    stall_pitch_deg: float = parameter(0.5, "deg", "design", "above it a low tip-speed ratio is the pitch's doing")
    over_speed_pu: float = parameter(1.4, "p.u.", "design", "rotor over-speed trip")
    rotor_speed_min_pu: float = parameter(
        0.0, "p.u.", "design", "rotor under-speed trip; 0 for none. The NREL 5 MW machine stops at 6.9 rpm, 0.569 p.u."
    )
    frequency_min_pu: float = parameter(
        0.95, "p.u.", "ENTSO-E", "lower end of the range units must ride through, 47.5 Hz"
    )
    frequency_max_pu: float = parameter(
        1.03, "p.u.", "ENTSO-E", "upper end of the range units must ride through, 51.5 Hz"
    )
    angle_spread_max_deg: float = parameter(
        180.0,
        "deg",
        "design",
        "largest difference of two units' angles; beyond, nothing pulls them together again: synchronism is lost",
    )
    low_voltage_pu: float = parameter(
        0.85, "p.u.", "ENTSO-E", "terminal voltage that a unit must ride through for low_voltage_time_s only"
    )
    low_voltage_time_s: float = parameter(
        3.0, "s", "ENTSO-E", "time below low_voltage_pu after which the voltage has collapsed (article 16, type D)"
    )
    internal_voltage_max_pu: float = parameter(
        2.0,
        "p.u.",
        "design",
        "largest voltage behind the internal reactance that a unit may start with: through X_g = 0.55 p.u. it drives "
        "1.6 p.u. of reactive current at 1.1 p.u. of terminal voltage, and converters end at about 1.2",
    )


@dataclass(frozen=True, kw_only=True)
class ExciterParameters:
    """SEXS: lead-lag, first-order exciter with a non-windup limit, on the terminal voltage."""

    gain: float = parameter(100.0, "p.u./p.u.", "design", "gain K")
    lead_lag_ratio: float = parameter(0.1, "-", "design", "T_A / T_B")
    lag_time_s: float = parameter(10.0, "s", "design", "T_B")
    exciter_time_s: float = parameter(0.05, "s", "design", "T_E")
    field_min_pu: float = parameter(-5.0, "p.u.", "design", "lower field voltage limit")
    field_max_pu: float = parameter(8.0, "p.u.", "design", "upper field voltage limit")


@dataclass(frozen=True, kw_only=True)
class GovernorParameters:
    """TGOV1: droop, gate with non-windup limits, reheat lead-lag."""

    droop_pu: float = parameter(
        0.018,
        "p.u.",
        "calibrated",
        "droop R on the machine base (Milano: 0.02); settles the paper's 0.996",
    )
    gate_time_s: float = parameter(0.1, "s", "Milano", "T_1")
    lead_time_s: float = parameter(2.1, "s", "design", "T_2")
    reheat_time_s: float = parameter(7.0, "s", "design", "T_3")
    gate_min_pu: float = parameter(0.0, "p.u.", "design", "lower gate limit")
    gate_max_pu: float = parameter(1.2, "p.u.", "Milano", "upper gate limit")
    turbine_damping_pu: float = parameter(0.0, "p.u./p.u.", "design", "D_t")
    dead_band_pu: float = parameter(
        0.0, "p.u.", "design", "speed deviation that the governor does not see, without a step at its edge"
    )


@dataclass(frozen=True, kw_only=True)
class HydroGovernorParameters:
    """HYGOV: a hydro governor with permanent and temporary droop, and a penstock with inelastic water."""

    droop_pu: float = parameter(0.05, "p.u.", "HYGOV", "permanent droop R on the machine base")
    temporary_droop_pu: float = parameter(0.4, "p.u.", "HYGOV", "temporary droop r")
    reset_time_s: float = parameter(8.0, "s", "HYGOV", "reset time T_r of the temporary droop")
    filter_time_s: float = parameter(0.05, "s", "HYGOV", "filter T_f of the speed error")
    gate_time_s: float = parameter(0.5, "s", "HYGOV", "gate servo T_g")
    gate_rate_limit_pu_s: float = parameter(0.2, "p.u./s", "HYGOV", "largest speed of the gate's set-point")
    gate_min_pu: float = parameter(0.0, "p.u.", "HYGOV", "lower gate limit")
    gate_max_pu: float = parameter(1.0, "p.u.", "HYGOV", "upper gate limit")
    water_time_s: float = parameter(1.3, "s", "HYGOV", "starting time T_w of the water at nominal flow")
    turbine_gain: float = parameter(1.1, "p.u./p.u.", "HYGOV", "turbine gain A_t")
    turbine_damping_pu: float = parameter(0.5, "p.u./p.u.", "HYGOV", "damping D_t of the turbine")
    no_load_flow_pu: float = parameter(0.08, "p.u.", "HYGOV", "flow q_nl without load")
    dead_band_pu: float = parameter(
        0.0, "p.u.", "design", "speed deviation that the governor does not see, without a step at its edge"
    )


@dataclass(frozen=True, kw_only=True)
class SynchronousMachineParameters:
    """A round-rotor machine (GENROU without saturation, x''_q = x''_d) on its own base, or a classical one."""

    bus: int = required("-", "Milano", "bus number")
    rating_mva: float = required("MVA", "Milano", "rating S_n")
    two_h_s: float = required("s", "Milano", "starting time 2H")
    x_d: float = required("p.u.", "Milano", "synchronous reactance, d axis")
    x_d_transient: float = required("p.u.", "Milano", "transient reactance, d axis")
    x_subtransient: float = required("p.u.", "Milano", "subtransient reactance of both axes")
    x_q: float = required("p.u.", "Milano", "synchronous reactance, q axis")
    x_q_transient: float = required("p.u.", "Milano", "transient reactance, q axis")
    t_d0_transient_s: float = required("s", "Milano", "open-circuit transient time constant, d axis")
    t_d0_subtransient_s: float = required("s", "Milano", "open-circuit subtransient time constant, d axis")
    t_q0_transient_s: float = parameter(
        1.0,
        "s",
        "Milano",
        "open-circuit transient time constant, q axis; without effect where x'_q = x_q",
    )
    t_q0_subtransient_s: float = required("s", "Milano", "open-circuit subtransient time constant, q axis")
    x_leakage: float = parameter(0.1, "p.u.", "design", "leakage reactance; Milano's at bus 1 exceeds x''_d")
    resistance: float = parameter(0.0, "p.u.", "design", "armature resistance")
    damping_pu: float = parameter(2.0, "p.u./p.u.", "Milano", "damping D")
    dispatch_mw: float = parameter(0.0, "MW", "design", "power in the initial power flow; slack machines balance")
    reactive_weight: float | None = parameter(
        None, "MVA", "design", "weight in sharing its bus's initial reactive power; None: its rating"
    )
    exciter: ExciterParameters | None = dataclasses.field(
        default_factory=ExciterParameters,
        metadata=describe("-", "design", "exciter, None for constant field"),
    )
    governor: GovernorParameters | HydroGovernorParameters | None = dataclasses.field(
        default=None, metadata=describe("-", "Milano", "governor, None for constant torque")
    )
    classical: bool = parameter(
        False,
        "-",
        "design",
        "constant voltage behind x'_d instead of GENROU and exciter (ANDES' GENCLS)",
    )


def classical_machine(**values: Any) -> SynchronousMachineParameters:
    """Return a constant voltage behind x'_d, without exciter.

    Args:
        values: of :class:`SynchronousMachineParameters`; those of a round rotor have no effect and need not be given.
    """
    unused = {
        "x_d": 1.0,
        "x_subtransient": 0.15,
        "x_q": 1.0,
        "x_q_transient": 1.0,
        "t_d0_transient_s": 1.0,
        "t_d0_subtransient_s": 1.0,
        "t_q0_subtransient_s": 1.0,
    }
    return SynchronousMachineParameters(**{**unused, "exciter": None, **values, "classical": True})


@dataclass(frozen=True, kw_only=True)
class WtgGroup:
    """Identical grid-forming WTGs at one bus, as one aggregate.

    Args:
        bus: bus number of the network.
        n_turbines: how many turbines of `turbine.rated_power_mw` it stands for.
    """

    bus: int = parameter(2, "-", "paper", "bus number")
    n_turbines: float = parameter(10.0, "-", "paper", "number of turbines in the group")


def default_groups(n_groups: int = 2, bus: int = 2) -> tuple[WtgGroup, ...]:
    """Return `n_groups` equal groups at a bus that share the paper's twenty turbines (100 MW)."""
    if isinstance(n_groups, bool) or not isinstance(n_groups, int) or not 1 <= n_groups <= 1024:
        raise ValueError(f"the number of WTG groups must be 1 … 1024, got {n_groups!r}")
    return tuple(WtgGroup(bus=bus, n_turbines=20.0 / n_groups) for _ in range(n_groups))
