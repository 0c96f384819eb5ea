"""Parameters of the synchronous machines, their exciters and governors."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from wtg_gym.physics.checked import Checked, describe, design, parameter, required
from wtg_gym.physics.control_parameters import (
    BoilerGovernorParameters,
    FilterStabiliserParameters,
    GasGovernorParameters,
    LeadLagExciterParameters,
    ReheatGovernorParameters,
    SaturatingExciterParameters,
    SpeedStabiliserParameters,
    dead_band,
)


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

    droop_pu: float = parameter(
        0.018, "p.u.", "calibrated", "droop R on the machine base (Milano: 0.02); settles the paper's 0.996", 1e-4, 1e3
    )
    gate_time_s: float = parameter(0.1, "s", "Milano", "T_1", 1e-4, 1e4)
    lead_time_s: float = parameter(2.1, "s", "Kundur", "T_2; T_2/T_3 is the share of the high-pressure part", 0.0, 1e4)
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

    Raises:
        ValueError: a value is out of its range, or a stabiliser has no exciter to act on.
    """

    bus: int = required("-", "Milano", "bus number")
    rating_mva: float = required("MVA", "Milano", "rating S_n", 1e-6, 1e12)
    two_h_s: float = required("s", "Milano", "starting time 2H", 1e-3, 1e9)
    x_d: float = required("p.u.", "Milano", "synchronous reactance, d axis", 1e-6, 1e6)
    x_d_transient: float = required("p.u.", "Milano", "transient reactance, d axis", 1e-6, 1e6)
    x_subtransient: float = required(
        "p.u.", "Milano", "subtransient reactance of both axes; Milano's x''_q at bus 1 is 0.4", 1e-6, 1e6
    )
    x_q: float = required("p.u.", "Milano", "synchronous reactance, q axis", 1e-6, 1e6)
    x_q_transient: float = required("p.u.", "Milano", "transient reactance, q axis", 1e-6, 1e6)
    t_d0_transient_s: float = required("s", "Milano", "open-circuit transient time constant, d axis", 1e-4, 1e6)
    t_d0_subtransient_s: float = required("s", "Milano", "open-circuit subtransient time constant, d axis", 1e-4, 1e6)
    t_q0_transient_s: float = parameter(
        1.0,
        "s",
        "Milano",
        "open-circuit transient time constant, q axis; Milano: 0 at bus 1, without effect there because x'_q = x_q",
        1e-4,
        1e6,
    )
    t_q0_subtransient_s: float = required("s", "Milano", "open-circuit subtransient time constant, q axis", 1e-4, 1e6)
    x_leakage: float = design(
        0.1, "p.u.", "leakage reactance; Milano's exceeds x''_d at buses 1, 6 and 8 and is 0 at bus 3", 0.0, 1e6
    )
    resistance: float = design(0.0, "p.u.", "armature resistance, neglected (Milano: at most 0.0031)", 0.0, 1e3)
    damping_pu: float = parameter(2.0, "p.u./p.u.", "Milano", "damping D", 0.0, 1e6)
    dispatch_mw: float = design(0.0, "MW", "power in the initial power flow; slack machines balance", -1e9, 1e9)
    reactive_weight: float | None = design(
        None, "MVA", "weight in sharing its bus's initial reactive power; None: its rating", 0.0, 1e12
    )
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
