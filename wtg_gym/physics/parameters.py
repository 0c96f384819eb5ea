"""Parameters of turbines, converters, protections and load shedding, each with its unit and its source.

Derived values are properties, never free fields. Sources are short keys; SOURCES spells them out. Ranges are wide: they
exclude meaningless values, not unusual ones.
"""

import dataclasses
import functools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from wtg_gym.physics.rotor_table import RotorTable, read_rotor_table
from wtg_gym.ranges import Checked, describe, design, is_whole, parameter, require_whole

R = TypeVar("R", bound=tuple[Any, ...])
_UNIT = re.compile(r"(_(pu|deg|s))+$")
#: What the short keys in each field's `source` stand for.
SOURCES = {
    "paper": "Chen, Xi, Cheng, Dörfler, Lestas: Coordinated Primary Frequency Regulation and Grid-Forming Control "
    "for Wind Turbine Generators (2026)",
    "inferred": "the only round set found that meets λ_opt, C_popt, λ_n and λ_pr of the paper's table to every digit",
    "Heier": "S. Heier: Grid Integration of Wind Energy",
    "Milano": "F. Milano: IEEE 14-bus dynamic data as distributed with PSAT (d_014_dyn_l14)",
    "IEEE 14": "IEEE 14-bus power-flow test case, University of Washington archive; the same numbers as MATPOWER's "
    "case14. Voltages of machine buses are its scheduled ones",
    "NREL 5 MW": "J. Jonkman et al.: Definition of a 5-MW Reference Wind Turbine, NREL/TP-500-38060 (2009)",
    "calibrated": "chosen for the paper's settled frequency (0.996 p.u.) and final power of WTG 2 (below 0.3 p.u.)",
    "ENTSO-E": "Commission Regulation (EU) 2016/631, articles 13 and 16, continental Europe",
    "REGFM_A1": "W. Du et al.: Model Specification of Droop-Controlled, Grid-Forming Inverters (REGFM_A1), "
    "PNNL-32278 (2021)",
    "ENTSO-E defence": "Commission Regulation (EU) 2017/2196, annex, continental Europe",
    "FERC 827": "Federal Energy Regulatory Commission, Order 827 (2016)",
    "Kundur": "P. Kundur: Power System Stability and Control: F_HP = 0.3, T_RH = 7 s",
    "ANDES": "default of the model of the same name in ANDES 2.0.0; H. Cui et al.: Hybrid Symbolic-Numeric Framework "
    "for Power System Modeling and Analysis, IEEE Transactions on Power Systems, 2021",
    "HYGOV": "typical data of the hydro governor HYGOV of PSS/E; P. Kundur: Power System Stability and Control, 9.1",
    "design": "a design value of this benchmark",
}


def constants_of(record: type[R], parameters: Any, **others: Any) -> R:
    """Return constants as a record (NamedTuple): each is the parameter of its name, which has its unit behind that.

    "inv_gate_time" is the inverse of `gate_time_s`. `others` are given, and what is neither is a KeyError.
    """
    values = {_UNIT.sub("", field.name): getattr(parameters, field.name) for field in dataclasses.fields(parameters)}
    for name in record._fields:  # type: ignore[attr-defined]
        if name not in others:
            value = values[name.removeprefix("inv_")]
            others[name] = 1.0 / value if name.startswith("inv_") else value
    return record(**others)


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
    conserves_energy: bool = design(
        False, "-", "rotor keeps H_m ω_m²: ω_m in the rotor equation, which the paper's lacks"
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


#: C_p(λ, β); source and licence stand in the file.
ROTOR_TABLE = Path(__file__).with_name("tables") / "Cp.NREL5MW.txt"
#: Rotor with its hub and, on the low-speed side, generator: 38 759 228 + 97² · 534.116 kg m². The rotor's is that of
#: its blades about the shaft, 3 cos² 2.5° (11 776 047 + 2 · 1.5 · 363 231 + 1.5² · 17 740), and of the hub, 115 926.
#: Source: J. Jonkman et al., NREL/TP-500-38060, tables 1-1, 2-2, 4-1 and 5-1.
_INERTIA_KG_M2 = 38_759_228.0 + 97.0**2 * 534.116
_RATED_SPEED_RAD_S = 12.1 * 2.0 * 3.141592653589793 / 60.0


@functools.cache
def nrel_5mw(*, conserves_energy: bool = True) -> TurbineParameters:
    """Return the NREL 5 MW reference turbine: R = 63 m, 12.1 rpm, with its C_p table. Source: NREL/TP-500-38060."""
    return TurbineParameters(
        rated_power_mw=5.0,
        blade_radius_m=63.0,
        air_density_kg_m3=1.225,
        nominal_rotor_speed_rad_s=_RATED_SPEED_RAD_S,
        inertia_constant_s=0.5 * _INERTIA_KG_M2 * _RATED_SPEED_RAD_S**2 / 5e6,
        conserves_energy=conserves_energy,
        power_coefficient=read_rotor_table(ROTOR_TABLE),
    )


@dataclass(frozen=True, kw_only=True)
class PitchParameters(Checked):
    """Pitch protection: a PI on the larger of the captured-power and the rotor-speed excess.

    Like the pitch controller of WECC's generic wind turbine models (WTGPT_A) it acts on speed and power, but with one
    PI on the larger excess, and on captured power. Gain schedule and rate limit follow the NREL 5 MW design.
    Both limits lie above everything the paper's cases reach (captured power at most the available 1.0172 p.u. at
    11.4 m/s, rotor at most 1.23 p.u.), so that the blades stay at rest there.
    """

    captured_power_limit_pu: float = design(1.05, "p.u.", "highest captured power", 0.01, 100.0)
    rotor_speed_limit_pu: float = design(1.27, "p.u.", "highest rotor speed, 1.6 rad/s", 0.01, 100.0)
    speed_weight: float = design(4.0, "p.u./p.u.", "weight of speed against power excess", 0.0, 1e4)
    proportional_gain_deg: float = design(6.0, "deg/p.u.", "gain on the excess", 0.0, 1e5)
    integral_gain_deg_s: float = design(10.0, "deg/(p.u. s)", "integral gain on the excess", 0.0, 1e5)
    gain_schedule_deg: float = parameter(6.302336, "deg", "NREL 5 MW", "pitch at which the gains halve", 1e-3, 1e6)
    actuator_time_s: float = design(0.1, "s", "lag of the pitch drive", 1e-3, 1e3)
    rate_limit_deg_s: float = parameter(8.0, "deg/s", "NREL 5 MW", "largest pitch rate", 1e-3, 1e4)
    largest_angle_deg: float = design(30.0, "deg", "largest pitch angle", 0.0, 90.0)


@dataclass(frozen=True, kw_only=True)
class GridFormingParameters(Checked):
    """Grid-forming control of one WTG on its own base, and the paper's regulation range."""

    RISING = ("frequency_min_pu", "frequency_setpoint_pu", "frequency_max_pu")

    inertia_constant_s: float = parameter(5.0, "s", "paper", "virtual inertia constant H", 1e-3, 1e4)
    droop_gain_pu: float = parameter(62.5, "p.u./p.u.", "paper", "active power-frequency droop gain D_p", 0.0, 1e5)
    frequency_setpoint_pu: float = parameter(1.0, "p.u.", "paper", "frequency set-point ω_st", 0.5, 1.5)
    frequency_min_pu: float = parameter(0.992, "p.u.", "paper", "lower end of the regulation range ω_min", 0.5, 1.5)
    frequency_max_pu: float = parameter(1.008, "p.u.", "paper", "upper end of the regulation range ω_max", 0.5, 1.5)
    reactance_pu: float = design(
        0.55, "p.u.", "X_g: K_p ≈ 1.5 with 0.1 p.u. more to a stiff bus (the paper's margins need 1.45)", 1e-4, 100.0
    )
    damping_time_constant_s: float = parameter(0.8, "s", "paper", "transient damping time constant τ", 0.0, 1e5)
    deloading_nominal: float = parameter(0.05, "-", "paper", "deloading d_n at ω_st", 0.0, 0.9)
    deloading_limit: float = parameter(0.10, "-", "paper", "deloading limit d_pr at ω_max", 0.0, 0.9)
    overload_limit_pu: float = design(1.1, "p.u.", "power above which it is overloaded", 0.01, 100.0)


@dataclass(frozen=True, kw_only=True)
class ConverterLimitParameters(Checked):
    """What a converter and its turbine can give, on its own base: REGFM_A1's current and power limiters, a chopper."""

    current_max_pu: float = parameter(1.2, "p.u.", "REGFM_A1", "largest current", 0.05, 10.0)
    power_max_pu: float = design(1.1, "p.u.", "lasting power", 0.05, 10.0)
    torque_max_pu: float = parameter(1.1, "p.u.", "NREL 5 MW", "lasting torque: 47 402.91 of 43 093.55 N m", 0.05, 10.0)
    power_min_pu: float = design(0.0, "p.u.", "least power; a chopper burns less", -10.0, 0.0)
    power_gain: float = parameter(
        0.01, "p.u./p.u.", "REGFM_A1", "proportional gain k_ppmax of the power limiter", 0.0, 10.0
    )
    power_integral_gain: float = parameter(0.1, "p.u./(p.u. s)", "REGFM_A1", "its integral gain k_ipmax", 0.0, 100.0)
    chopper_energy_pu_s: float = design(2.0, "p.u. s", "chopper heat that disconnects the group", 1e-3, 1e6)
    chopper_cooling_s: float = design(60.0, "s", "its cooling time constant", 1e-2, 1e6)

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

    integral_gain: float = parameter(5.86, "p.u./(p.u. s)", "REGFM_A1", "integral gain k_iv", 1e-3, 1e3)
    droop_pu: float = parameter(0.05, "p.u./p.u.", "REGFM_A1", "reactive droop m_q, voltage per power", 0.0, 1.0)
    reactive_max_pu: float = parameter(
        0.33, "p.u.", "FERC 827", "largest reactive power: a power factor of 0.95", 0.0, 10.0
    )
    takeover_gain: float = design(1.0, "p.u./p.u.", "weight of reactive excess against voltage error", 0.0, 100.0)
    internal_voltage_min_pu: float = design(0.5, "p.u.", "least voltage behind X_g", 0.0, 1.0)
    internal_voltage_max_pu: float = design(1.4, "p.u.", "largest voltage behind X_g", 1.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class SheddingStage(Checked):
    """A stage of under-frequency load shedding: a share of every load is disconnected for the rest of the run."""

    frequency_pu: float = parameter(0.98, "p.u.", "ENTSO-E defence", "frequency at which it acts", 0.5, 1.0)
    share: float = parameter(0.05, "-", "ENTSO-E defence", "share of every load that it sheds", 0.0, 1.0)
    delay_s: float = design(0.2, "s", "time below that frequency before it acts", 0.0, 60.0)


def european_shedding() -> tuple[SheddingStage, ...]:
    """Return the stages that continental Europe asks for: 5 % of the load at 49 Hz, then 8 % every 0.2 Hz to 48 Hz."""
    levels = ((49.0, 0.05), (48.8, 0.08), (48.6, 0.08), (48.4, 0.08), (48.2, 0.08), (48.0, 0.08))
    return tuple(SheddingStage(frequency_pu=level / 50.0, share=share) for level, share in levels)


@dataclass(frozen=True, kw_only=True)
class ProtectionParameters(Checked):
    """What refuses a start, ends a run, or trips a group."""

    stall_tip_speed_ratio: float = design(3.5, "-", "tip-speed ratio below which a rotor stalls", 0.0, 100.0)
    stall_pitch_deg: float = design(0.5, "deg", "pitch up to which it does", 0.0, 90.0)
    over_speed_pu: float = design(1.4, "p.u.", "rotor over-speed trip", 0.1, 1e6)
    rotor_speed_min_pu: float = design(0.0, "p.u.", "rotor under-speed trip; 0 for none", 0.0, 1.0)
    frequency_min_pu: float = parameter(0.95, "p.u.", "ENTSO-E", "lower end of the range to ride through", 0.0, 1.0)
    frequency_max_pu: float = parameter(1.03, "p.u.", "ENTSO-E", "upper end of the range to ride through", 1.0, 10.0)
    angle_spread_max_deg: float = design(180.0, "deg", "angle of two units at which synchronism is lost", 1.0, 1e9)
    low_voltage_pu: float = parameter(0.85, "p.u.", "ENTSO-E", "terminal voltage to ride through for a time", 0.0, 2.0)
    low_voltage_time_s: float = parameter(
        3.0, "s", "ENTSO-E", "that time, of 1.5 … 3.0 s for power park modules", 0.0, 1e9
    )
    internal_voltage_max_pu: float = design(
        2.0, "p.u.", "largest voltage behind a unit's reactance at the start", 0.1, 1e9
    )


#: WTG groups of a plant at most: memory grows with their square.
MOST_GROUPS = 100


@dataclass(frozen=True, kw_only=True)
class WtgGroup(Checked):
    """Identical grid-forming WTGs at one bus, as one aggregate."""

    bus: int = parameter(2, "-", "paper", "bus number")
    n_turbines: float = parameter(10.0, "-", "paper", "number of turbines in the group", 1e-3, 1e4)
    turbine: TurbineParameters | None = dataclasses.field(
        default=None, metadata=describe("-", "design", "its turbines, None for the plant's")
    )

    def to_dict(self) -> dict[str, Any]:
        """Return the group as JSON-ready data, with its turbine if it has one of its own."""
        turbine = {} if self.turbine is None else {"turbine": dataclasses.asdict(self.turbine)}
        return {"bus": int(self.bus), "n_turbines": float(self.n_turbines), **turbine}


def default_groups(n_groups: int = 2, bus: int = 2) -> tuple[WtgGroup, ...]:
    """Return `n_groups` equal groups at a bus that share the paper's twenty turbines (100 MW)."""
    n_groups = require_whole("the number of WTG groups", n_groups, 1, MOST_GROUPS)
    return tuple(WtgGroup(bus=bus, n_turbines=20.0 / n_groups) for _ in range(n_groups))


def groups_of(description: int | Sequence[WtgGroup | Mapping[str, Any]], bus: int = 2) -> tuple[WtgGroup, ...]:
    """Return WTG groups from a number of equal ones at a bus, or from a list of them or of their data.

    A ValueError says that the description is of another form.
    """
    if is_whole(description):
        return default_groups(int(description), bus)  # type: ignore[arg-type]
    form = '{"bus": …, "n_turbines": …}'
    if isinstance(description, (str, Mapping)) or not isinstance(description, Sequence):
        raise ValueError(f"groups must be a number of groups or a list of {form}, got {description!r:.80}")
    for entry in description:
        if not isinstance(entry, WtgGroup | Mapping) or entry == {}:
            raise ValueError(f"a WTG group must be {form}, got {entry!r:.80}")
    return tuple(entry if isinstance(entry, WtgGroup) else WtgGroup(**entry) for entry in description)
