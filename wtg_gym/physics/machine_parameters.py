"""Parameters of the synchronous machines, their exciters, stabilisers and governors.

A time constant of 0 s takes its block away, except where its range says otherwise.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

from wtg_gym.ranges import Checked, describe, design, parameter, required


@dataclass(frozen=True, kw_only=True)
class LeadLags(Checked):
    """Parameters of a control with lead-lags; a lead without a lag, which would differentiate, is refused."""

    #: Fields of each block: lead and lag.
    LEAD_LAGS: ClassVar[tuple[tuple[str, str], ...]] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for lead, lag in self.LEAD_LAGS:
            if getattr(self, lead) > 0.0 and getattr(self, lag) == 0.0:
                raise ValueError(
                    f"{type(self).__name__}: {lead} = {getattr(self, lead):g} s needs {lag} above 0 s: without a lag "
                    "the block would differentiate"
                )


def dead_band() -> Any:
    """Return the field that every governor has."""
    return design(0.0, "p.u.", "dead band of the speed, without a step at its edge", 0.0, 0.5)


@dataclass(frozen=True, kw_only=True)
class ExciterParameters(Checked):
    """SEXS: lead-lag, first-order exciter with a non-windup limit, on the terminal voltage."""

    MODEL = "SEXS"
    RISING = ("field_min_pu", "field_max_pu")

    gain: float = design(100.0, "p.u./p.u.", "gain K", 1e-3, 1e6)
    lead_lag_ratio: float = design(0.1, "-", "T_A / T_B", 0.0, 1e3)
    lag_time_s: float = design(10.0, "s", "T_B", 1e-4, 1e4)
    exciter_time_s: float = design(0.05, "s", "T_E", 1e-4, 1e4)
    field_min_pu: float = design(-5.0, "p.u.", "lower field voltage limit", -1e6, 1e6)
    field_max_pu: float = design(8.0, "p.u.", "upper field voltage limit", -1e6, 1e6)


@dataclass(frozen=True, kw_only=True)
class GovernorParameters(Checked):
    """TGOV1: droop, gate with non-windup limits, reheat lead-lag."""

    MODEL = "TGOV1"
    RISING = ("gate_min_pu", "gate_max_pu")

    droop_pu: float = parameter(0.018, "p.u.", "calibrated", "droop R on the machine base (Milano: 0.02)", 1e-4, 1e3)
    gate_time_s: float = parameter(0.1, "s", "Milano", "T_1", 1e-4, 1e4)
    lead_time_s: float = parameter(2.1, "s", "Kundur", "T_2", 0.0, 1e4)
    reheat_time_s: float = parameter(7.0, "s", "Kundur", "T_3", 1e-4, 1e4)
    gate_min_pu: float = design(0.0, "p.u.", "lower gate limit", -1e6, 1e6)
    gate_max_pu: float = parameter(1.2, "p.u.", "Milano", "upper gate limit", -1e6, 1e6)
    turbine_damping_pu: float = design(0.0, "p.u./p.u.", "D_t", 0.0, 1e4)
    dead_band_pu: float = dead_band()


@dataclass(frozen=True, kw_only=True)
class HydroGovernorParameters(Checked):
    """HYGOV: a hydro governor with permanent and temporary droop, and a penstock with inelastic water."""

    MODEL = "HYGOV"
    RISING = ("gate_min_pu", "gate_max_pu")

    droop_pu: float = parameter(0.05, "p.u.", "HYGOV", "permanent droop R on the machine base", 1e-4, 1e3)
    temporary_droop_pu: float = parameter(0.4, "p.u.", "HYGOV", "temporary droop r", 1e-3, 1e3)
    reset_time_s: float = parameter(8.0, "s", "HYGOV", "reset time T_r of the temporary droop", 1e-3, 1e4)
    filter_time_s: float = parameter(0.05, "s", "HYGOV", "filter T_f of the speed error", 1e-4, 1e4)
    gate_time_s: float = parameter(0.5, "s", "HYGOV", "gate servo T_g", 1e-4, 1e4)
    gate_rate_limit_pu_s: float = parameter(0.2, "p.u./s", "HYGOV", "largest speed of the gate's set-point", 1e-6, 1e6)
    gate_min_pu: float = parameter(0.0, "p.u.", "HYGOV", "lower gate limit", -1e6, 1e6)
    gate_max_pu: float = parameter(1.0, "p.u.", "HYGOV", "upper gate limit", -1e6, 1e6)
    water_time_s: float = parameter(1.3, "s", "HYGOV", "starting time T_w of the water at nominal flow", 1e-3, 1e4)
    turbine_gain: float = parameter(1.1, "p.u./p.u.", "HYGOV", "turbine gain A_t", 1e-2, 100.0)
    turbine_damping_pu: float = parameter(0.5, "p.u./p.u.", "HYGOV", "damping D_t of the turbine", 0.0, 1e4)
    no_load_flow_pu: float = parameter(0.08, "p.u.", "HYGOV", "flow q_nl without load", 0.0, 1.0)
    dead_band_pu: float = dead_band()


@dataclass(frozen=True, kw_only=True)
class SpeedStabiliserParameters(LeadLags):
    """STAB1: a washout of the speed deviation, two lead-lags, a limit."""

    MODEL = "STAB1"
    LEAD_LAGS = (("lead_time_1_s", "lag_time_1_s"), ("lead_time_2_s", "lag_time_2_s"))

    gain: float = design(20.0, "p.u./p.u.", "gain K; K/T in data of PSS/E", 0.0, 1e4)
    washout_time_s: float = design(10.0, "s", "T of the washout", 1e-3, 1e4)
    lead_time_1_s: float = design(0.05, "s", "T_1 of the first lead-lag", 0.0, 1e4)
    lag_time_1_s: float = design(0.02, "s", "T_3 of the first lead-lag", 0.0, 1e4)
    lead_time_2_s: float = design(3.0, "s", "T_2 of the second lead-lag", 0.0, 1e4)
    lag_time_2_s: float = design(5.4, "s", "T_4 of the second lead-lag", 0.0, 1e4)
    signal_limit_pu: float = design(0.03, "p.u.", "largest signal H_lim to either side", 1e-6, 1e3)


@dataclass(frozen=True, kw_only=True)
class FilterStabiliserParameters(LeadLags):
    """IEEEST with the speed deviation as its input: a filter, two lead-lags, a washout, limits."""

    MODEL = "IEEEST"
    LEAD_LAGS = (("lead_time_1_s", "lag_time_1_s"), ("lead_time_2_s", "lag_time_2_s"))
    RISING = ("signal_min_pu", "signal_max_pu")

    filter_a1_s: float = parameter(1.0, "s", "ANDES", "A_1 of the filter's first denominator", 0.0, 1e3)
    filter_a2_s2: float = parameter(1.0, "s²", "ANDES", "A_2 of the filter's first denominator", 0.0, 1e3)
    filter_a3_s: float = parameter(1.0, "s", "ANDES", "A_3 of the filter's second denominator", 0.0, 1e3)
    filter_a4_s2: float = parameter(1.0, "s²", "ANDES", "A_4 of the filter's second denominator", 0.0, 1e3)
    filter_a5_s: float = parameter(1.0, "s", "ANDES", "A_5 of the filter's numerator", -1e3, 1e3)
    filter_a6_s2: float = parameter(1.0, "s²", "ANDES", "A_6 of the filter's numerator", -1e3, 1e3)
    lead_time_1_s: float = parameter(1.0, "s", "ANDES", "T_1 of the first lead-lag", 0.0, 1e4)
    lag_time_1_s: float = parameter(1.0, "s", "ANDES", "T_2 of the first lead-lag", 0.0, 1e4)
    lead_time_2_s: float = parameter(1.0, "s", "ANDES", "T_3 of the second lead-lag", 0.0, 1e4)
    lag_time_2_s: float = parameter(1.0, "s", "ANDES", "T_4 of the second lead-lag", 0.0, 1e4)
    washout_gain_s: float = parameter(1.0, "s", "ANDES", "T_5 of the washout; 0 makes it a lag of T_6", 0.0, 1e4)
    washout_time_s: float = parameter(1.0, "s", "ANDES", "T_6 of the washout", 1e-3, 1e4)
    gain: float = parameter(1.0, "p.u./p.u.", "ANDES", "gain K_S", -1e4, 1e4)
    signal_min_pu: float = parameter(-0.3, "p.u.", "ANDES", "lower limit L_Smin of the signal", -1e3, 1e3)
    signal_max_pu: float = parameter(0.3, "p.u.", "ANDES", "upper limit L_Smax of the signal", -1e3, 1e3)
    voltage_min_pu: float = design(0.0, "p.u.", "terminal voltage V_CL below which it gives no signal", 0.0, 10.0)
    voltage_max_pu: float = design(0.0, "p.u.", "terminal voltage V_CU above which it gives none; 0: none", 0.0, 10.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        first, second, numerator = (
            2 if square != 0.0 else 1 if linear != 0.0 else 0
            for linear, square in (
                (self.filter_a1_s, self.filter_a2_s2),
                (self.filter_a3_s, self.filter_a4_s2),
                (self.filter_a5_s, self.filter_a6_s2),
            )
        )
        if numerator > (second or first):
            raise ValueError(
                f"{type(self).__name__}: the filter's numerator 1 + A_5 s + A_6 s² has degree {numerator}; its "
                f"denominator 1 + A_3 s + A_4 s², or without that 1 + A_1 s + A_2 s², has only {second or first}"
            )


@dataclass(frozen=True, kw_only=True)
class SaturatingExciterParameters(Checked):
    """IEEET1: a voltage regulator with a non-windup limit, a saturating dc exciter, rate feedback."""

    MODEL = "IEEET1"
    RISING = ("regulator_min_pu", "regulator_max_pu")

    sensing_time_s: float = parameter(0.02, "s", "ANDES", "T_R of the voltage measurement", 0.0, 1e4)
    regulator_gain: float = parameter(5.0, "p.u./p.u.", "ANDES", "gain K_A", 1e-3, 1e6)
    regulator_time_s: float = parameter(0.04, "s", "ANDES", "T_A of the regulator", 0.0, 1e4)
    regulator_min_pu: float = parameter(-7.3, "p.u.", "ANDES", "lower limit V_Rmin of the regulator", -1e6, 1e6)
    regulator_max_pu: float = parameter(7.3, "p.u.", "ANDES", "upper limit V_Rmax of the regulator", -1e6, 1e6)
    exciter_gain: float = parameter(1.0, "p.u./p.u.", "ANDES", "K_E, self-excitation; taken as it is, 0 too", -1e3, 1e3)
    exciter_time_s: float = parameter(0.8, "s", "ANDES", "T_E of the exciter", 1e-4, 1e4)
    feedback_gain_s: float = parameter(0.1, "s", "ANDES", "K_F of the rate feedback", 0.0, 1e4)
    feedback_time_s: float = parameter(1.0, "s", "ANDES", "T_F of the rate feedback", 1e-3, 1e4)
    saturation_voltage_1_pu: float = design(0.0, "p.u.", "E_1, a field voltage at which saturation is given", 0.0, 1e3)
    saturation_1: float = design(0.0, "-", "S_E(E_1)", 0.0, 1e3)
    saturation_voltage_2_pu: float = design(1.0, "p.u.", "E_2, another one", 0.0, 1e3)
    saturation_2: float = design(0.0, "-", "S_E(E_2); 0 for no saturation", 0.0, 1e3)


@dataclass(frozen=True, kw_only=True)
class LeadLagExciterParameters(LeadLags, SaturatingExciterParameters):
    """IEEEX1: IEEET1 with a lead-lag before the regulator."""

    MODEL = "IEEEX1"
    LEAD_LAGS = (("lead_time_s", "lag_time_s"),)

    lead_time_s: float = parameter(1.0, "s", "ANDES", "T_C of the lead-lag", 0.0, 1e4)
    lag_time_s: float = parameter(1.0, "s", "ANDES", "T_B of the lead-lag", 0.0, 1e4)


@dataclass(frozen=True, kw_only=True)
class BoilerGovernorParameters(LeadLags):
    """IEEEG1: a lead-lag, a valve with limits of speed and opening, four passes of steam; one shaft."""

    MODEL = "IEEEG1"
    LEAD_LAGS = (("lead_time_s", "lag_time_s"),)
    RISING = ("gate_min_pu", "gate_max_pu")

    droop_pu: float = parameter(0.05, "p.u.", "ANDES", "droop on the machine base, 1/K", 1e-4, 1e3)
    lag_time_s: float = parameter(1.0, "s", "ANDES", "T_1 of the lead-lag", 0.0, 1e4)
    lead_time_s: float = parameter(1.0, "s", "ANDES", "T_2 of the lead-lag", 0.0, 1e4)
    valve_time_s: float = parameter(0.1, "s", "ANDES", "T_3 of the valve's servo", 1e-4, 1e4)
    opening_rate_pu_s: float = parameter(0.1, "p.u./s", "ANDES", "fastest opening U_o", 1e-6, 1e6)
    closing_rate_pu_s: float = parameter(-0.1, "p.u./s", "ANDES", "fastest closing U_c", -1e6, -1e-6)
    gate_min_pu: float = parameter(0.0, "p.u.", "ANDES", "least valve opening P_min", -1e6, 1e6)
    gate_max_pu: float = parameter(5.0, "p.u.", "ANDES", "largest valve opening P_max", -1e6, 1e6)
    pass_time_1_s: float = parameter(0.4, "s", "ANDES", "T_4 of the steam bowl", 0.0, 1e4)
    pass_time_2_s: float = parameter(8.0, "s", "ANDES", "T_5 of the reheater", 0.0, 1e4)
    pass_time_3_s: float = parameter(0.5, "s", "ANDES", "T_6 of the third pass", 0.0, 1e4)
    pass_time_4_s: float = parameter(0.05, "s", "ANDES", "T_7 of the fourth pass", 0.0, 1e4)
    fraction_1: float = parameter(0.5, "-", "ANDES", "K_1, share of the torque after the first pass", 0.0, 10.0)
    fraction_2: float = parameter(0.5, "-", "ANDES", "K_3, after the second", 0.0, 10.0)
    fraction_3: float = parameter(0.0, "-", "ANDES", "K_5, after the third", 0.0, 10.0)
    fraction_4: float = parameter(0.0, "-", "ANDES", "K_7, after the fourth", 0.0, 10.0)
    dead_band_pu: float = dead_band()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.fraction_1 + self.fraction_2 + self.fraction_3 + self.fraction_4 > 0.0:
            raise ValueError("BoilerGovernorParameters: one of the fractions must be above 0")


@dataclass(frozen=True, kw_only=True)
class ReheatGovernorParameters(LeadLags):
    """IEESGO: a lag, a lead-lag, a limit, three stages of steam."""

    MODEL = "IEESGO"
    LEAD_LAGS = (("lead_time_s", "governor_time_s"),)
    RISING = ("gate_min_pu", "gate_max_pu")

    droop_pu: float = design(0.05, "p.u.", "droop on the machine base, 1/K_1", 1e-4, 1e3)
    lag_time_s: float = parameter(0.02, "s", "ANDES", "T_1 of the controller", 0.0, 1e4)
    lead_time_s: float = parameter(1.0, "s", "ANDES", "T_2 of the lead-lag", 0.0, 1e4)
    governor_time_s: float = parameter(1.0, "s", "ANDES", "T_3 of the lead-lag", 0.0, 1e4)
    inlet_time_s: float = parameter(0.5, "s", "ANDES", "T_4 of the steam inlet", 1e-4, 1e4)
    reheat_time_s: float = parameter(10.0, "s", "ANDES", "T_5 of the reheater", 0.0, 1e4)
    crossover_time_s: float = parameter(0.5, "s", "ANDES", "T_6 of the crossover", 0.0, 1e4)
    fraction_2: float = design(0.7, "-", "K_2, share of the torque behind the reheater", -10.0, 10.0)
    fraction_3: float = design(0.5, "-", "K_3, share of that behind the crossover", -10.0, 10.0)
    gate_min_pu: float = parameter(0.0, "p.u.", "ANDES", "least order P_min", -1e6, 1e6)
    gate_max_pu: float = parameter(5.0, "p.u.", "ANDES", "largest order P_max", -1e6, 1e6)
    dead_band_pu: float = dead_band()


@dataclass(frozen=True, kw_only=True)
class GasGovernorParameters(Checked):
    """GAST: a gas turbine whose valve has limits, with a limit of the exhaust temperature."""

    MODEL = "GAST"
    RISING = ("gate_min_pu", "gate_max_pu")

    droop_pu: float = parameter(0.05, "p.u.", "ANDES", "droop R on the machine base", 1e-4, 1e3)
    valve_time_s: float = parameter(0.1, "s", "ANDES", "T_1 of the valve", 1e-4, 1e4)
    turbine_time_s: float = parameter(0.2, "s", "ANDES", "T_2 of the combustion", 0.0, 1e4)
    exhaust_time_s: float = parameter(10.0, "s", "ANDES", "T_3 of the temperature's measurement", 1e-4, 1e4)
    load_limit_pu: float = parameter(1.0, "p.u.", "ANDES", "ambient temperature's load limit A_T", 1e-3, 1e3)
    temperature_gain: float = parameter(5.0, "p.u./p.u.", "ANDES", "gain K_T of the temperature's limit", 0.0, 1e4)
    gate_min_pu: float = parameter(0.0, "p.u.", "ANDES", "least valve opening V_min", -1e6, 1e6)
    gate_max_pu: float = parameter(1.2, "p.u.", "ANDES", "largest valve opening V_max", -1e6, 1e6)
    turbine_damping_pu: float = parameter(0.0, "p.u./p.u.", "ANDES", "damping D_t of the turbine", 0.0, 1e4)
    dead_band_pu: float = dead_band()


AnyExciter = ExciterParameters | SaturatingExciterParameters | LeadLagExciterParameters
AnyGovernor = (
    GovernorParameters
    | HydroGovernorParameters
    | BoilerGovernorParameters
    | ReheatGovernorParameters
    | GasGovernorParameters
)
AnyStabiliser = SpeedStabiliserParameters | FilterStabiliserParameters


@dataclass(frozen=True, kw_only=True)
class SynchronousMachineParameters(Checked):
    """A round-rotor machine (GENROU with x''_q = x''_d) on its own base, or a classical one.

    A ValueError says that a value is out of its range, or a stabiliser has no exciter to act on.
    """

    bus: int = required("-", "Milano", "bus number")
    rating_mva: float = required("MVA", "Milano", "rating S_n", 1e-6, 1e12)
    two_h_s: float = required("s", "Milano", "starting time 2H", 1e-3, 1e9)
    x_d: float = required("p.u.", "Milano", "synchronous reactance, d axis", 1e-6, 1e6)
    x_d_transient: float = required("p.u.", "Milano", "transient reactance, d axis", 1e-6, 1e6)
    x_subtransient: float = required(
        "p.u.", "Milano", "subtransient reactance of both axes (Milano at bus 1: x''_q = 0.4, T'_q0 = 0)", 1e-6, 1e6
    )
    x_q: float = required("p.u.", "Milano", "synchronous reactance, q axis", 1e-6, 1e6)
    x_q_transient: float = required("p.u.", "Milano", "transient reactance, q axis", 1e-6, 1e6)
    t_d0_transient_s: float = required("s", "Milano", "open-circuit transient time constant, d axis", 1e-4, 1e6)
    t_d0_subtransient_s: float = required("s", "Milano", "open-circuit subtransient time constant, d axis", 1e-4, 1e6)
    t_q0_transient_s: float = parameter(1.0, "s", "Milano", "open-circuit transient time constant, q axis", 1e-4, 1e6)
    t_q0_subtransient_s: float = required("s", "Milano", "open-circuit subtransient time constant, q axis", 1e-4, 1e6)
    x_leakage: float = design(0.1, "p.u.", "leakage reactance; Milano's exceeds x''_d or is 0", 0.0, 1e6)
    resistance: float = design(0.0, "p.u.", "armature resistance, neglected (Milano: at most 0.0041)", 0.0, 1e3)
    damping_pu: float = parameter(2.0, "p.u./p.u.", "Milano", "damping D", 0.0, 1e6)
    dispatch_mw: float = design(0.0, "MW", "power in the initial power flow; slack machines balance", -1e9, 1e9)
    reactive_weight: float | None = design(None, "MVA", "weight at its bus's reactive power; None: rating", 0.0, 1e12)
    saturation_1_0: float = design(0.0, "-", "saturation S(1.0)", 0.0, 10.0)
    saturation_1_2: float = design(0.0, "-", "saturation S(1.2); 0 for none", 0.0, 10.0)
    exciter: AnyExciter | None = dataclasses.field(
        default_factory=ExciterParameters, metadata=describe("-", "design", "exciter, None for constant field")
    )
    stabiliser: AnyStabiliser | None = dataclasses.field(
        default=None, metadata=describe("-", "design", "power system stabiliser, whose signal its exciter adds")
    )
    governor: AnyGovernor | None = dataclasses.field(
        default=None, metadata=describe("-", "Milano", "governor, None for constant torque")
    )
    classical: bool = design(False, "-", "constant voltage behind x'_d instead of GENROU and exciter (ANDES' GENCLS)")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stabiliser is not None and self.exciter is None and not self.classical:
            raise ValueError(f"machine at bus {self.bus}: a stabiliser needs an exciter, which adds its signal")


def classical_machine(**values: Any) -> SynchronousMachineParameters:
    """Return a constant voltage behind x'_d, without exciter, from values of :class:`SynchronousMachineParameters`.

    Those of a round rotor have no effect and need not be given.
    """
    transient = ("x_q_transient", "t_d0_transient_s", "t_d0_subtransient_s", "t_q0_subtransient_s")
    unused = {**dict.fromkeys(("x_d", "x_q", *transient), 1.0), "x_subtransient": 0.15}
    return SynchronousMachineParameters(**{**unused, "exciter": None, **values, "classical": True})
