"""The exciters IEEEX1 and IEEET1: a voltage regulator, a saturating dc exciter, rate feedback.

    T_R v̇ = V - v,    u = V_ref - v - (K_F/T_F)(E_fd - f),    T_F ḟ = E_fd - f
    T_B ẋ = u - x,    y = x + (T_C/T_B)(u - x)
    T_A V̇_R = K_A y - V_R  with non-windup limits,    T_E Ė_fd = V_R - K_E E_fd - E_fd S_E(E_fd)

E_fd S_E(E_fd) is the parabola of :mod:`wtg_gym.physics.saturation`. In IEEET1 there is no lead-lag: y = u.

Source: IEEE Std 421.5 (DC1A) and the standard models of PSS/E. Unlike there, ANDES scales the limits of V_R in its
IEEEX1 by the terminal voltage, as DC2A has it; here they are constant, as in ANDES' IEEET1.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.control_blocks import inverse, lag, lead_lag, limited_lag
from wtg_gym.physics.control_parameters import LeadLagExciterParameters, SaturatingExciterParameters
from wtg_gym.physics.machine_controls import exciter
from wtg_gym.physics.saturation import Saturation, saturated, saturation_constants
from wtg_gym.systems.elementary import clip


class Ieeex1(NamedTuple):
    """Constants."""

    machine: int  # whose exciter it is
    inv_sensing_time: float  # 1/T_R [1/s]
    lead_time: float  # T_C [s]
    inv_lag_time: float  # 1/T_B [1/s]; 0 without a lead-lag
    gain: float  # K_A [p.u./p.u.]
    inv_regulator_time: float  # 1/T_A [1/s]
    regulator_min: float  # V_Rmin [p.u.]
    regulator_max: float  # V_Rmax [p.u.]
    exciter_gain: float  # K_E [p.u./p.u.]
    inv_exciter_time: float  # 1/T_E [1/s]
    feedback_ratio: float  # K_F / T_F [p.u./p.u.]
    inv_feedback_time: float  # 1/T_F [1/s]
    saturation: Saturation


class Ieeex1State(NamedTuple):
    """States."""

    sensed: float  # v [p.u.]
    lead_lag: float  # x [p.u.]
    regulator: float  # V_R [p.u.]
    excitation: float  # E_fd [p.u.]
    feedback: float  # f [p.u.]


def ieeex1_constants(machine: int, p: SaturatingExciterParameters) -> Ieeex1:
    """Return the constants of the exciter of a machine, given by its index."""
    lead_time, lag_time = (p.lead_time_s, p.lag_time_s) if isinstance(p, LeadLagExciterParameters) else (0.0, 0.0)
    return Ieeex1(
        machine=machine,
        inv_sensing_time=inverse(p.sensing_time_s),
        lead_time=lead_time,
        inv_lag_time=inverse(lag_time),
        gain=p.regulator_gain,
        inv_regulator_time=inverse(p.regulator_time_s),
        regulator_min=p.regulator_min_pu,
        regulator_max=p.regulator_max_pu,
        exciter_gain=p.exciter_gain,
        inv_exciter_time=1.0 / p.exciter_time_s,
        feedback_ratio=p.feedback_gain_s / p.feedback_time_s,
        inv_feedback_time=1.0 / p.feedback_time_s,
        saturation=saturation_constants(
            type(p).__name__,
            (p.saturation_voltage_1_pu, p.saturation_1),
            (p.saturation_voltage_2_pu, p.saturation_2),
        ),
    )


def ieeex1_rates(s: Ieeex1State, reference: float, voltage: float, c: Ieeex1) -> Ieeex1State:
    """Return the rates at a reference and a terminal voltage [p.u.]."""
    sensed, measured = lag(s.sensed, voltage, c.inv_sensing_time)
    slope, slow = lag(s.feedback, s.excitation, c.inv_feedback_time)
    error = reference - measured - c.feedback_ratio * (s.excitation - slow)
    lead, led = lead_lag(s.lead_lag, error, c.lead_time, c.inv_lag_time)
    regulator, driving = limited_lag(s.regulator, c.gain * led, c.inv_regulator_time, c.regulator_min, c.regulator_max)
    needed = c.exciter_gain * s.excitation + saturated(s.excitation, c.saturation)
    return Ieeex1State(sensed, lead, regulator, c.inv_exciter_time * (driving - needed), slope)


def ieeex1_limited(s: Ieeex1State, c: Ieeex1) -> Ieeex1State:
    """Return the states, held within their limits."""
    return s._replace(regulator=clip(s.regulator, c.regulator_min, c.regulator_max))


def ieeex1_start(field_voltage: float, voltage: float, c: Ieeex1) -> tuple[Ieeex1State, float]:
    """Return the equilibrium at a field and a terminal voltage [p.u.], and the voltage error that it needs [p.u.]."""
    regulator = c.exciter_gain * field_voltage + saturated(field_voltage, c.saturation)
    error = regulator / c.gain
    return Ieeex1State(voltage, error, regulator, field_voltage, field_voltage), error


def _limits(c: Ieeex1) -> tuple[float, float]:
    return c.regulator_min, c.regulator_max


IEEEX1 = exciter(
    "exciters IEEEX1",
    Ieeex1State,
    Ieeex1,
    ieeex1_constants,
    ieeex1_rates,
    ieeex1_limited,
    ieeex1_start,
    "regulator",
    _limits,
)
