"""Models of stabilisers, exciters and governors that only some machines have, each with its equations and source.

A machine's parameters say which it has (:data:`CONTROLS`). SEXS and TGOV1 are in :mod:`wtg_gym.physics.machine`. In
governors Δω is the speed's deviation ω - 1 beyond the dead band.
"""

import copyreg
import math
import types
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics import control_blocks as controls
from wtg_gym.physics import machine_parameters as parameters
from wtg_gym.physics.control_blocks import lag, lead_lag
from wtg_gym.physics.machine import beyond_dead_band, saturated, saturation_constants
from wtg_gym.physics.units import ControlJoining, joining
from wtg_gym.systems.elementary import clip, limited_rate, select
from wtg_gym.systems.systems import System, structured

#: The gate is kept this far open in h = (q/g)² of HYGOV [p.u.].
_LEAST_GATE = 0.01


class Stab1State(NamedTuple):
    washout: float  # [p.u.]
    lead_lag_1: float
    lead_lag_2: float


def stab1_rates(s: Stab1State, deviation: float, voltage: float, c: Any) -> tuple[Stab1State, float]:
    """Return the rates and the signal [p.u.] of STAB1 at a speed deviation ω - 1 [p.u.]; the voltage does not count.

        V_s = K · sT/(1 + sT) · (1 + sT_1)/(1 + sT_3) · (1 + sT_2)/(1 + sT_4) · (ω - 1),  within ±H_lim

    Source: the standard model STAB1 of PSS/E, whose data hold K/T in place of K.
    """
    washout, slow = lag(s.washout, deviation, c.inv_washout_time)
    first, led = lead_lag(s.lead_lag_1, c.gain * (deviation - slow), c.lead_time_1_s, c.inv_lag_time_1)
    second, signal = lead_lag(s.lead_lag_2, led, c.lead_time_2_s, c.inv_lag_time_2)
    return Stab1State(washout, first, second), clip(signal, -c.signal_limit_pu, c.signal_limit_pu)


STAB1 = controls.stabiliser(controls.Constants(parameters.SpeedStabiliserParameters), Stab1State, stab1_rates)


class Denominator(NamedTuple):
    """1 + A s + B s²."""

    linear: float  # A [s]
    inv_linear: float  # 1/A where B is 0 [1/s]; 0 for no denominator, or one of the second degree
    inv_square: float  # 1/B [1/s²]; 0 for one of the first degree, or none


class IeeestState(NamedTuple):
    slope_1: float  # rate of the next [p.u./s]
    filter_1: float  # [p.u.]
    slope_2: float
    filter_2: float
    lead_lag_1: float
    lead_lag_2: float
    washout: float


def _denominator(linear: float, square: float) -> Denominator:
    return Denominator(linear, 0.0 if square else controls.inverse(linear), controls.inverse(square))


def _filters(p: parameters.FilterStabiliserParameters) -> dict[str, Any]:
    return {
        "first": _denominator(p.filter_a1_s, p.filter_a2_s2),
        "second": _denominator(p.filter_a3_s, p.filter_a4_s2),
        "voltage_min": p.voltage_min_pu or -math.inf,
        "voltage_max": p.voltage_max_pu or math.inf,
    }


def _divided(
    slope: float, state: float, signal: float, signal_rate: float, signal_slope_rate: float, c: Denominator
) -> tuple[float, float, float]:
    """Return what divides a signal by 1 + A s + B s²: the rates of both states, and the output.

    Without a denominator the rates are those of the signal itself, as far as they are known.
    """
    exists = (c.inv_linear > 0.0) | (c.inv_square > 0.0)
    slope_rate = c.inv_square * (signal - state - c.linear * slope)
    rate = select(c.inv_square > 0.0, slope, c.inv_linear * (signal - state))
    rates = select(exists, slope_rate, signal_slope_rate), select(exists, rate, signal_rate)
    return *rates, select(exists, state, signal)


def ieeest_rates(s: IeeestState, deviation: float, voltage: float, c: Any) -> tuple[IeeestState, float]:
    """Return the rates and the signal [p.u.] of IEEEST at a speed deviation ω - 1 and a terminal voltage [p.u.].

        V_s = (1 + A_5 s + A_6 s²) / ((1 + A_1 s + A_2 s²)(1 + A_3 s + A_4 s²))
              · (1 + sT_1)/(1 + sT_2) · (1 + sT_3)/(1 + sT_4) · K_S sT_5/(1 + sT_6) · (ω - 1),  within L_Smin … L_Smax

    With T_5 = 0 the washout is a lag of T_6. The signal is zero while the voltage is outside V_CL … V_CU. Source:
    the standard model IEEEST of PSS/E, after IEEE Std 421.5 (PSS1A), as ANDES defines it. Unlike ANDES, which takes the
    second part of the filter away where A_4 is 0, the numerator keeps its effect then.
    """
    slope_1, filter_1, once = _divided(s.slope_1, s.filter_1, deviation, 0.0, 0.0, c.first)
    slope_2, filter_2, twice = _divided(s.slope_2, s.filter_2, once, filter_1, slope_1, c.second)
    filtered = twice + c.filter_a5_s * filter_2 + c.filter_a6_s2 * slope_2
    first, led = lead_lag(s.lead_lag_1, filtered, c.lead_time_1_s, c.inv_lag_time_1)
    second, led = lead_lag(s.lead_lag_2, led, c.lead_time_2_s, c.inv_lag_time_2)
    washout, slow = lag(s.washout, c.gain * led, c.inv_washout_time)
    washed = select(c.washout_gain_s > 0.0, c.washout_gain_s * washout, slow)
    acts = (c.voltage_min < voltage) & (voltage < c.voltage_max)
    rates = IeeestState(slope_1, filter_1, slope_2, filter_2, first, second, washout)
    return rates, select(acts, clip(washed, c.signal_min_pu, c.signal_max_pu), 0.0)


IEEEST = controls.stabiliser(
    controls.Constants(parameters.FilterStabiliserParameters, besides=_filters), IeeestState, ieeest_rates
)


class Ieeex1State(NamedTuple):
    sensed: float  # v [p.u.]
    lead_lag: float  # x [p.u.]
    regulator: float  # V_R [p.u.]
    excitation: float  # E_fd [p.u.]
    feedback: float  # f [p.u.]


def _saturation(p: parameters.SaturatingExciterParameters) -> dict[str, Any]:
    first, second = (p.saturation_voltage_1_pu, p.saturation_1), (p.saturation_voltage_2_pu, p.saturation_2)
    return {"saturation": saturation_constants(type(p).__name__, first, second)}


def ieeex1_rates(s: Ieeex1State, reference: float, voltage: float, c: Any) -> Ieeex1State:
    """Return the rates of IEEEX1, and of IEEET1, at a reference and a terminal voltage [p.u.].

        T_R v̇ = V - v,    u = V_ref - v - (K_F/T_F)(E_fd - f),    T_F ḟ = E_fd - f
        T_B ẋ = u - x,    y = x + (T_C/T_B)(u - x)
        T_A V̇_R = K_A y - V_R  with non-windup limits,    T_E Ė_fd = V_R - K_E E_fd - E_fd S_E(E_fd)

    E_fd S_E(E_fd) is the parabola of :func:`~wtg_gym.physics.machine.saturated`. In IEEET1 there is no lead-lag: y = u.
    Source: IEEE Std 421.5 (DC1A) and the standard models of PSS/E. Unlike there, ANDES scales the limits of V_R in its
    IEEEX1 by the terminal voltage, as DC2A has it; here they are constant, as in ANDES' IEEET1.
    """
    sensed, measured = lag(s.sensed, voltage, c.inv_sensing_time)
    slope, _ = lag(s.feedback, s.excitation, c.inv_feedback_time)
    error = reference - measured - c.feedback_gain_s * slope
    lead, led = lead_lag(s.lead_lag, error, c.lead_time_s, c.inv_lag_time)
    regulator, driving = controls.limited_lag(
        s.regulator, c.regulator_gain * led, c.inv_regulator_time, c.regulator_min_pu, c.regulator_max_pu
    )
    needed = c.exciter_gain * s.excitation + saturated(s.excitation, c.saturation)
    return Ieeex1State(sensed, lead, regulator, c.inv_exciter_time * (driving - needed), slope)


def ieeex1_start(field_voltage: float, voltage: float, c: Any) -> tuple[Ieeex1State, float]:
    """Return the equilibrium at a field and a terminal voltage [p.u.], and the voltage error that it needs [p.u.]."""
    regulator = c.exciter_gain * field_voltage + saturated(field_voltage, c.saturation)
    error = regulator / c.regulator_gain
    return Ieeex1State(voltage, error, regulator, field_voltage, field_voltage), error


IEEEX1 = controls.exciter(
    controls.Constants(
        parameters.SaturatingExciterParameters, parameters.LeadLagExciterParameters, besides=_saturation
    ),
    Ieeex1State,
    ieeex1_rates,
    ieeex1_start,
)


class HydroState(NamedTuple):
    speed_error: float  # e [p.u.]
    gate_order: float  # c [p.u.]
    hydro_gate: float  # g [p.u.]
    flow: float  # q [p.u.]


def hydro_rates(s: HydroState, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[HydroState, float]:
    """Return the rates and the torque [p.u.] of HYGOV; speed ω [p.u.], reference g_ref [p.u.], 1/R in use.

    Permanent and temporary droop, gate servo, inelastic water:

        T_f ė = R (g_ref - c) - Δω - e,    ċ = e/(r T_r) + ė/r with |ċ| ≤ v_max and non-windup limits,    T_g ġ = c - g
        T_w q̇ = 1 - h,    h = (q/g)²,    T_m = A_t h (q - q_nl) - D_t g (ω - 1)

    Without a droop the governor is lost: it and its gate stand still. Source: HYGOV of PSS/E, as ANDES defines it; P.
    Kundur: Power System Stability and Control, section 9.1.
    """
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    deviation = beyond_dead_band(speed - 1.0, c.dead_band_pu)
    permanent = (reference - s.gate_order) / max(inv_droop, 1e-6)
    error_rate = c.inv_filter_time * (permanent - deviation - s.speed_error)
    target = c.inv_temporary_droop * (c.inv_reset_time * s.speed_error + error_rate)
    order_rate = clip(target, -c.gate_rate_limit_pu_s, c.gate_rate_limit_pu_s)
    ratio = s.flow / max(s.hydro_gate, _LEAST_GATE)
    head = ratio * ratio
    rates = HydroState(
        speed_error=acts * error_rate,
        gate_order=acts * limited_rate(order_rate, s.gate_order, c.gate_min_pu, c.gate_max_pu),
        hydro_gate=acts * c.inv_gate_time * (s.gate_order - s.hydro_gate),
        flow=c.inv_water_time * (1.0 - head),
    )
    torque = c.turbine_gain * head * (s.flow - c.no_load_flow_pu) - c.turbine_damping_pu * s.hydro_gate * (speed - 1.0)
    return rates, torque


def hydro_limited(s: HydroState, c: Any) -> HydroState:
    return HydroState(s.speed_error, clip(s.gate_order, c.gate_min_pu, c.gate_max_pu), s.hydro_gate, s.flow)


def hydro_start(torque: float, c: Any) -> HydroState:
    """Return the equilibrium at a torque [p.u.]; its gate is g_ref."""
    gate = torque / c.turbine_gain + c.no_load_flow_pu
    return HydroState(0.0, gate, gate, gate)


hydro_constants = controls.Constants(
    parameters.HydroGovernorParameters, besides=lambda p: {"inv_temporary_droop": 1.0 / p.temporary_droop_pu}
)
HYGOV = controls.governor(hydro_constants, HydroState, hydro_rates, hydro_start, "hydro_gate", hydro_limited)
HYDRO = HYGOV.kind


class GastState(NamedTuple):
    valve: float  # g [p.u.]
    combustion: float  # c [p.u.]
    exhaust: float  # θ [p.u.]


def gast_rates(s: GastState, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[GastState, float]:
    """Return the rates and the torque [p.u.] of GAST; speed ω [p.u.], reference g_ref [p.u.], 1/R in use.

    A gas turbine: a valve with limits, combustion, a limit of the exhaust temperature.

        T_1 ġ = min(g_ref - Δω/R, A_T + K_T (A_T - θ)) - g  with non-windup limits V_min … V_max
        T_2 ċ = g - c,    T_3 θ̇ = c - θ,    T_m = c - D_t (ω - 1)

    Source: the standard model GAST of PSS/E, as ANDES defines it.
    """
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = reference - inv_droop * beyond_dead_band(speed - 1.0, c.dead_band_pu)
    allowed = c.load_limit_pu + c.temperature_gain * (c.load_limit_pu - s.exhaust)
    target = c.inv_valve_time * (min(demand, allowed) - s.valve)
    valve = limited_rate(target, s.valve, c.gate_min_pu, c.gate_max_pu)
    combusting, burnt = lag(s.combustion, clip(s.valve, c.gate_min_pu, c.gate_max_pu), c.inv_turbine_time)
    rates = GastState(acts * valve, combusting, c.inv_exhaust_time * (burnt - s.exhaust))
    return rates, burnt - c.turbine_damping_pu * (speed - 1.0)


def gast_start(torque: float, c: Any) -> GastState:
    """Return the equilibrium at a torque [p.u.]."""
    return GastState(torque, torque, torque)


GAST = controls.governor(controls.Constants(parameters.GasGovernorParameters), GastState, gast_rates, gast_start)


class Ieeeg1State(NamedTuple):
    governing: float  # x [p.u.]
    valve: float  # g [p.u.]
    steam_1: float  # s_1 [p.u.]
    steam_2: float
    steam_3: float
    steam_4: float


def ieeeg1_rates(s: Ieeeg1State, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[Ieeeg1State, float]:
    """Return the rates and the torque [p.u.] of IEEEG1; speed ω [p.u.], reference g_ref [p.u.], 1/R in use.

    A steam turbine on one shaft: a lead-lag, a valve with limits, four passes of steam.

        T_1 ẋ = Δω/R - x,    y = x + (T_2/T_1)(Δω/R - x)
        ġ = (g_ref - y - g)/T_3  with U_c ≤ ġ ≤ U_o and non-windup limits P_min … P_max
        T_4 ṡ_1 = g - s_1,    T_5 ṡ_2 = s_1 - s_2,    T_6 ṡ_3 = s_2 - s_3,    T_7 ṡ_4 = s_3 - s_4
        T_m = K_1 s_1 + K_3 s_2 + K_5 s_3 + K_7 s_4

    1/R is K. Source: IEEE Committee Report: Dynamic Models for Steam and Hydro Turbines in Power System Studies, 1973,
    and the standard model IEEEG1 of PSS/E. ANDES divides the shares K by their sum; here they count as they are, which
    is the same where they add up to 1.
    """
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = inv_droop * beyond_dead_band(speed - 1.0, c.dead_band_pu)
    governing, led = lead_lag(s.governing, demand, c.lead_time_s, c.inv_lag_time)
    target = clip(c.inv_valve_time * (reference - led - s.valve), c.closing_rate_pu_s, c.opening_rate_pu_s)
    valve = limited_rate(target, s.valve, c.gate_min_pu, c.gate_max_pu)
    steam_1, after_1 = lag(s.steam_1, clip(s.valve, c.gate_min_pu, c.gate_max_pu), c.inv_pass_time_1)
    steam_2, after_2 = lag(s.steam_2, after_1, c.inv_pass_time_2)
    steam_3, after_3 = lag(s.steam_3, after_2, c.inv_pass_time_3)
    steam_4, after_4 = lag(s.steam_4, after_3, c.inv_pass_time_4)
    rates = Ieeeg1State(acts * governing, acts * valve, steam_1, steam_2, steam_3, steam_4)
    torque = c.fraction_1 * after_1 + c.fraction_2 * after_2 + c.fraction_3 * after_3 + c.fraction_4 * after_4
    return rates, torque


def ieeeg1_start(torque: float, c: Any) -> Ieeeg1State:
    """Return the equilibrium at a torque [p.u.]."""
    valve = torque / (c.fraction_1 + c.fraction_2 + c.fraction_3 + c.fraction_4)
    return Ieeeg1State(0.0, valve, valve, valve, valve, valve)


IEEEG1 = controls.governor(
    controls.Constants(parameters.BoilerGovernorParameters), Ieeeg1State, ieeeg1_rates, ieeeg1_start
)


class IeesgoState(NamedTuple):
    controlling: float  # x [p.u.]
    governing: float  # z [p.u.]
    valve: float  # s_1 [p.u.]
    reheated: float  # s_2 [p.u.]
    crossed: float  # s_3 [p.u.]


def ieesgo_rates(s: IeesgoState, speed: float, reference: float, inv_droop: float, c: Any) -> tuple[IeesgoState, float]:
    """Return the rates and the torque [p.u.] of IEESGO; speed ω [p.u.], reference g_ref [p.u.], 1/R in use.

    A steam turbine: a lag, a lead-lag, a limit, three stages of steam.

        T_1 ẋ = Δω/R - x,    T_3 ż = x - z,    y = z + (T_2/T_3)(x - z)
        T_4 ṡ_1 = clip(g_ref - y, P_min, P_max) - s_1,    T_5 ṡ_2 = s_1 - s_2,    T_6 ṡ_3 = s_2 - s_3
        T_m = (1 - K_2) s_1 + K_2 (1 - K_3) s_2 + K_2 K_3 s_3

    1/R is K_1. A lost governor keeps what its inlet gives, s_1. Source: the standard model IEESGO of PSS/E, as ANDES
    defines it.
    """
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = inv_droop * beyond_dead_band(speed - 1.0, c.dead_band_pu)
    controlling, lagged = lag(s.controlling, demand, c.inv_lag_time)
    governing, led = lead_lag(s.governing, lagged, c.lead_time_s, c.inv_governor_time)
    valve, steam = lag(s.valve, clip(reference - led, c.gate_min_pu, c.gate_max_pu), c.inv_inlet_time)
    reheating, reheated = lag(s.reheated, steam, c.inv_reheat_time)
    crossing, crossed = lag(s.crossed, reheated, c.inv_crossover_time)
    rates = IeesgoState(acts * controlling, acts * governing, acts * valve, reheating, crossing)
    behind = reheated + c.fraction_3 * (crossed - reheated)
    return rates, steam + c.fraction_2 * (behind - steam)


def ieesgo_start(torque: float, c: Any) -> IeesgoState:
    """Return the equilibrium at a torque [p.u.]."""
    return IeesgoState(0.0, 0.0, torque, torque, torque)


IEESGO = controls.governor(
    controls.Constants(parameters.ReheatGovernorParameters), IeesgoState, ieesgo_rates, ieesgo_start
)


#: By the names of their kinds. Stabilisers come before the exciters whose references they shift.
CONTROLS: Mapping[str, controls.Control] = types.MappingProxyType(
    {control.kind.name: control for control in (STAB1, IEEEST, IEEEX1, HYGOV, IEEEG1, IEESGO, GAST)}
)


def control_kind(name: str) -> Any:
    """Return the kind of a control, by the kind's name."""
    return CONTROLS[name].kind


# A copy in another process finds the kind by its name: its record of constants has none there.
copyreg.pickle(controls.ControlKind, lambda kind: (control_kind, (kind.name,)))
_BY_PARAMETERS = {record: control for control in CONTROLS.values() for record in control.constants.parameters}


def controls_of(machine: parameters.SynchronousMachineParameters) -> list[tuple[controls.Control, Any]]:
    """Return the controls of a machine that are units of their own, each with its parameters."""
    electric = () if machine.classical else (machine.stabiliser, machine.exciter)
    records = (*electric, machine.governor)
    return [(_BY_PARAMETERS[type(record)], record) for record in records if type(record) in _BY_PARAMETERS]


def control_constants(machines: Sequence[parameters.SynchronousMachineParameters]) -> dict[str, npt.NDArray[np.void]]:
    """Return the constants of all controls that are units of their own, by the names of their kinds."""
    constants: dict[str, list[Any]] = {}
    for index, machine in enumerate(machines):
        for control, record in controls_of(machine):
            constants.setdefault(control.kind.name, []).append(control.constants(index, record))
    return {name: structured(CONTROLS[name].constants.record, records) for name, records in constants.items()}


def joining_controls(names: Sequence[str]) -> dict[str, tuple[System, ...]]:
    """Return the systems of controls, by the names of their kinds, by the places where they join."""
    places = joining([control.systems for name, control in CONTROLS.items() if name in names])
    if ControlJoining.SETTLE in places:
        # Exciters come before the stabilisers: they say what reference they need. Each control has one system there.
        places[ControlJoining.SETTLE] = places[ControlJoining.SETTLE][::-1]
    return places
