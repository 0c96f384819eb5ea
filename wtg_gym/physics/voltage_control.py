"""Voltage control of a grid-forming converter: droop, reactive limits and one integrator, on the base of its turbine.

    Ė = K_iv e,    e = max(min(V_ref - V - m_q (q - q_ref), K_q (q_max - q)), K_q (-q_max - q)),    E_min ≤ E ≤ E_max

E is the voltage behind X_g, V and q are those of the terminal. Where a reactive limit is exceeded its own error takes
over, so that one integrator serves both and nothing winds up; while the current is limited E does not rise. Source:
REGFM_A1 (W. Du et al., PNNL-32278), with the takeover of IEEE 421.5's excitation limiters in place of two integrators
more, and without the filters of its measurements.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.elementary import clip, limited_rate, select
from wtg_gym.physics.parameters import VoltageControlParameters


class VoltageControl(NamedTuple):
    """Constants."""

    gain: float  # K_iv [1/s]; 0 for a constant voltage behind X_g
    droop: float  # m_q [p.u./p.u.]
    reactive_max: float  # q_max [p.u.]
    takeover_gain: float  # K_q [p.u./p.u.]
    emf_min: float  # E_min [p.u.]
    emf_max: float  # E_max [p.u.]


class VoltageInput(NamedTuple):
    """Constant over a run."""

    voltage_reference: float  # V_ref [p.u.]
    reactive_reference: float  # q_ref [p.u.]


def voltage_control(p: VoltageControlParameters | None) -> VoltageControl:
    """Return the constants; None for a constant voltage behind X_g."""
    if p is None:
        return VoltageControl(0.0, 0.0, 0.0, 0.0, 0.0, math.inf)
    return VoltageControl(
        gain=p.integral_gain,
        droop=p.droop_pu,
        reactive_max=p.reactive_max_pu,
        takeover_gain=p.takeover_gain,
        emf_min=p.internal_voltage_min_pu,
        emf_max=p.internal_voltage_max_pu,
    )


@inlined
def emf_rate(emf: float, voltage: float, reactive: float, limited: bool, u: VoltageInput, c: VoltageControl) -> float:
    """Return Ė [p.u./s].

    Args:
        emf: E [p.u.].
        voltage, reactive: V and q at the terminal [p.u.].
        limited: the current is being limited.
        u, c: references, constants.
    """
    error = u.voltage_reference - voltage - c.droop * (reactive - u.reactive_reference)
    error = min(error, c.takeover_gain * (c.reactive_max - reactive))
    error = max(error, c.takeover_gain * (-c.reactive_max - reactive))
    rate = limited_rate(c.gain * error, emf, c.emf_min, c.emf_max)
    return select(limited, min(rate, 0.0), rate)


@inlined
def emf_limited(emf: float, c: VoltageControl) -> float:
    """Return E, held within its limits."""
    return clip(emf, c.emf_min, c.emf_max)
