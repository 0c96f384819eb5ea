"""The exciters IEEEX1 and IEEET1: a voltage regulator, a saturating dc exciter, rate feedback.

    T_R v̇ = V - v,    u = V_ref - v - (K_F/T_F)(E_fd - f),    T_F ḟ = E_fd - f
    T_B ẋ = u - x,    y = x + (T_C/T_B)(u - x)
    T_A V̇_R = K_A y - V_R  with non-windup limits,    T_E Ė_fd = V_R - K_E E_fd - E_fd S_E(E_fd)

E_fd S_E(E_fd) is the parabola of :mod:`wtg_gym.physics.saturation`. In IEEET1 there is no lead-lag: y = u.

Source: IEEE Std 421.5 (DC1A) and the standard models of PSS/E. Unlike there, ANDES scales the limits of V_R in its
IEEEX1 by the terminal voltage, as DC2A has it; here they are constant, as in ANDES' IEEET1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from wtg_gym.physics.control_blocks import Constants, lag, lead_lag, limited_lag
from wtg_gym.physics.control_parameters import LeadLagExciterParameters, SaturatingExciterParameters
from wtg_gym.physics.machine_controls import exciter
from wtg_gym.physics.saturation import saturated, saturation_constants


class Ieeex1State(NamedTuple):
    """States."""

    sensed: float  # v [p.u.]
    lead_lag: float  # x [p.u.]
    regulator: float  # V_R [p.u.]
    excitation: float  # E_fd [p.u.]
    feedback: float  # f [p.u.]


def _besides(p: SaturatingExciterParameters) -> dict[str, Any]:
    first = p.saturation_voltage_1_pu, p.saturation_1
    second = p.saturation_voltage_2_pu, p.saturation_2
    return {"saturation": saturation_constants(type(p).__name__, first, second)}


def ieeex1_rates(s: Ieeex1State, reference: float, voltage: float, c: Any) -> Ieeex1State:
    """Return the rates at a reference and a terminal voltage [p.u.]."""
    sensed, measured = lag(s.sensed, voltage, c.inv_sensing_time)
    slope, _ = lag(s.feedback, s.excitation, c.inv_feedback_time)
    error = reference - measured - c.feedback_gain_s * slope
    lead, led = lead_lag(s.lead_lag, error, c.lead_time_s, c.inv_lag_time)
    regulator, driving = limited_lag(
        s.regulator, c.regulator_gain * led, c.inv_regulator_time, c.regulator_min_pu, c.regulator_max_pu
    )
    needed = c.exciter_gain * s.excitation + saturated(s.excitation, c.saturation)
    return Ieeex1State(sensed, lead, regulator, c.inv_exciter_time * (driving - needed), slope)


def ieeex1_start(field_voltage: float, voltage: float, c: Any) -> tuple[Ieeex1State, float]:
    """Return the equilibrium at a field and a terminal voltage [p.u.], and the voltage error that it needs [p.u.]."""
    regulator = c.exciter_gain * field_voltage + saturated(field_voltage, c.saturation)
    error = regulator / c.regulator_gain
    return Ieeex1State(voltage, error, regulator, field_voltage, field_voltage), error


IEEEX1 = exciter(
    Constants(SaturatingExciterParameters, LeadLagExciterParameters, besides=_besides),
    Ieeex1State,
    ieeex1_rates,
    ieeex1_start,
)
