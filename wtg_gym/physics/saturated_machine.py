"""Saturation of GENROU: more field current, and more reaction on the q axis, for the flux of the air gap.

    ψ = √(E''_d² + E''_q²),    S = B (ψ - A)²/ψ  for ψ > A
    T'_d0 Ė'_q = … - S E''_q,    T'_q0 Ė'_d = … - S E''_d (x_q - x_l)/(x_d - x_l)

A and B are those of the parabola through S(1.0) and S(1.2), see :mod:`wtg_gym.physics.saturation`; the rest is as in
:mod:`wtg_gym.physics.machine`. Source: the standard model GENROU of PSS/E, as ANDES defines it.

A plant with a saturated machine has these systems in place of those of :mod:`wtg_gym.physics.machine_unit`, for all of
its machines.
"""

from __future__ import annotations

from wtg_gym.physics import machine_unit
from wtg_gym.physics.exciter import exciter_start
from wtg_gym.physics.machine import (
    Machine,
    MachineInput,
    MachineOutput,
    MachineState,
    MachineVoltage,
    RotorSaturation,
    machine_limited,
    machine_start,
    saturation_factor,
)
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.saturation import saturated
from wtg_gym.physics.units import Back, Phasor, Terminal
from wtg_gym.systems.elementary import select
from wtg_gym.systems.systems import system

_unsaturated_rates = machine_unit.rates_of_machine.equation
_unsaturated_return = machine_unit.return_machine.equation


@system(MACHINES, "state", "voltage_reference", "gate_reference")
def start_saturated(
    start: Terminal, inv_committed: float, machine: Machine, saturation: RotorSaturation
) -> tuple[MachineState, float, float]:
    """Return the equilibrium that a run starts from; angles count from the network's frame."""
    v, i_re, i_im = start.voltage, inv_committed * start.current.re, inv_committed * start.current.im
    return machine_start(inv_committed * start.power, v.re, v.im, start.magnitude, i_re, i_im, machine, saturation)


@system(MACHINES, "state_rates", "output")
def rates_of_saturated(
    state: MachineState,
    emf: MachineVoltage,
    current: Phasor,
    given: MachineInput,
    turbine_torque: float,
    committed: float,
    inv_committed: float,
    machine: Machine,
    saturation: RotorSaturation,
    reference_speed: float,
    omega_n: float,
) -> tuple[MachineState, MachineOutput]:
    """Return rates and outputs."""
    rates, output = _unsaturated_rates(
        state,
        emf,
        current,
        given,
        turbine_torque,
        committed,
        inv_committed,
        machine,
        reference_speed,
        omega_n,
    )
    factor = given.connected * saturation_factor(emf.e_d, emf.e_q, saturation)
    e_q = rates.e_q_transient - machine.inv_t_d0_transient * factor * emf.e_q
    e_d = rates.e_d_transient - machine.inv_t_q0_transient * factor * saturation.q_weight * emf.e_d
    return rates._replace(e_q_transient=e_q, e_d_transient=e_d), output


@system(MACHINES, "state", "connected", "gate_reference", when="extended")
def return_saturated(
    state: MachineState, given: MachineInput, returns: float, back: Back, machine: Machine, saturation: RotorSaturation
) -> tuple[MachineState, float, float]:
    """Synchronise a machine that comes back, with the field voltage that its saturation needs without load."""
    found, connected, reference = _unsaturated_return(state, given, returns, back, machine)
    exciter, _ = exciter_start(back.voltage + saturated(back.voltage, saturation.curve), machine.exciter)
    comes = returns > 0.5
    field = found.exciter._replace(
        lead_lag=select(comes, exciter.lead_lag, found.exciter.lead_lag),
        field_voltage=select(comes, exciter.field_voltage, found.exciter.field_voltage),
    )
    return found._replace(exciter=field), connected, reference


stage_of_saturated = moving(rates_of_saturated, machine_limited, constants=["machine"])

#: What stands in place of the systems of machines, by the places of :mod:`wtg_gym.physics.step`.
SYSTEMS = {
    "machine settle": (start_saturated,),
    "machine move": (stage_of_saturated,),
    "machine rates": (rates_of_saturated,),
    "machine return": (return_saturated,),
}
