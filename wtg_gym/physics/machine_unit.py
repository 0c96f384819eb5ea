"""Synchronous machines as units: their parts, and the systems that move them."""

from __future__ import annotations

from wtg_gym.physics.machine import (
    Machine,
    MachineInput,
    MachineOutput,
    MachineState,
    MachineVoltage,
    driven_by,
    machine_limited,
    machine_rates,
    machine_start,
    machine_voltage,
)
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.units import LANE, UNITS, Connection, Phasor, StartFailure, Terminal, noted
from wtg_gym.systems.elementary import select
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import Kind, system

MACHINES = Kind(
    name="machines",
    rows={"state": MachineState, "given": MachineInput, "emf": MachineVoltage, "output": MachineOutput},
    scratch={"hydro_torque": float},  # of its hydro governor, if it has one [p.u.]
    constants={"machine": Machine, "dispatch": float},
    sees={"unit": UNITS, "lane": LANE},
    states=("state",),
)
#: The first machine: its speed turns the frame of all angles, after an outage too.
FIRST_MACHINE = Kind(name="first machine", sees={"machine": MACHINES, "lane": LANE})


@system(FIRST_MACHINE, "reference_speed")
def reference(speed: float) -> float:
    """Return the speed of the frame of all angles."""
    return speed


@system(MACHINES, "planned_power")
def plan_machine(dispatch: float) -> float:
    """Return the dispatched power."""
    return dispatch


@system(MACHINES, "state", "voltage_reference", "gate_reference")
def start_machine(start: Terminal, machine: Machine) -> tuple[MachineState, float, float]:
    """Return the equilibrium that a run starts from; angles count from the network's frame."""
    v, i = start.voltage, start.current
    return machine_start(start.power, v.re, v.im, start.magnitude, i.re, i.im, machine)


@system(FIRST_MACHINE, "frame")
def take_frame(state: MachineState) -> float:
    """Let all angles count from the first machine."""
    return state.angle


@system(MACHINES, "state")
def turn_machine(state: MachineState, frame: float) -> MachineState:
    """Count a machine's angle from the frame."""
    return state._replace(angle=state.angle - frame)


@system(MACHINES, "start_failure", "failing_unit")
def check_machine(
    state: MachineState, machine: Machine, connection: Connection, start_failure: float, failing_unit: float
) -> tuple[float, float]:
    """Note a machine that would start beyond the limits of its governor or its exciter."""
    gate, field, c = state.governor.gate, state.exciter.field_voltage, machine
    fits = (c.governor.gate_min <= gate) & (gate <= c.governor.gate_max)
    start_failure, failing_unit = noted(
        fits, StartFailure.GOVERNOR_LIMIT, connection.number, start_failure, failing_unit
    )
    fits = (c.exciter.field_min <= field) & (field <= c.exciter.field_max)
    return noted(fits, StartFailure.EXCITER_LIMIT, connection.number, start_failure, failing_unit)


@system(MACHINES, "emf", "voltage")
def voltage_of_machine(state: MachineState, machine: Machine) -> tuple[MachineVoltage, Phasor]:
    """Return the voltage behind x'', in the frames of rotor and network."""
    emf, re, im = machine_voltage(state, machine)
    return emf, Phasor(re, im)


@system(MACHINES, "state_rates", "output")
def rates_of_machine(
    state: MachineState,
    emf: MachineVoltage,
    current: Phasor,
    given: MachineInput,
    hydro_torque: float,
    machine: Machine,
    reference_speed: float,
    omega_n: float,
) -> tuple[MachineState, MachineOutput]:
    """Return rates and outputs; the torque is that of its hydro governor, if it has one.

    After an outage a machine keeps its states.
    """
    rates, output = machine_rates(state, emf, current.re, current.im, given, machine, reference_speed, omega_n)
    torque = select(machine.governor.is_hydro > 0.5, hydro_torque, output.torque)
    rates = each(lambda rate: given.connected * rate, driven_by(torque, rates, output, given))
    return rates, MachineOutput(output.power, output.voltage, given.connected * torque)


stage_of_machine = moving(rates_of_machine, machine_limited, constants=["machine"])
