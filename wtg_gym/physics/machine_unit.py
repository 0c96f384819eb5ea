"""Synchronous machines as units: their parts, and the systems that move them."""

import math

from wtg_gym.physics import machine as equations
from wtg_gym.physics import units
from wtg_gym.physics.machine import Machine, MachineInput, MachineState, MachineVoltage, Saturating
from wtg_gym.physics.units import ENV, Connection, Failure, Phasor
from wtg_gym.systems.elementary import clip, select, sine_cosine
from wtg_gym.systems.systems import Kind, each, system

MACHINES = Kind(
    name="machines",
    rows={"state": MachineState, "inputs": MachineInput, "emf": MachineVoltage, "output": equations.MachineOutput},
    scratch={
        "turbine_torque": float,  # of its governor, where that is a unit of its own [p.u.]
        "iron": Saturating,  # zero where no machine saturates
    },
    constants={"machine": Machine, "dispatch": float, "saturation": equations.RotorSaturation},
    sees={"unit": units.UNITS, "island": units.ISLANDS, "env": ENV},
    states=("state",),
)
#: The first machine: its speed turns the frame of all angles, after an outage too.
FIRST_MACHINE = Kind(name="first machine", sees={"machine": MACHINES, "env": ENV})


@system(FIRST_MACHINE, "reference_speed")
def reference(speed: float) -> float:
    """Return the speed of the frame of all angles."""
    return speed


@system(MACHINES, "needed")
def subtract_machine_power(needed: float, dispatch: float) -> float:
    return needed - dispatch


@system(MACHINES, "planned_power")
def plan_machine(dispatch: float, needed: float, connection: Connection) -> float:
    """Return the dispatched power, and a share of what is needed."""
    return dispatch + connection.participation * needed


@system(MACHINES, "state", "voltage_reference", "gate_reference")
def start_machine(
    start: units.Terminal, inv_committed: float, machine: Machine, saturation: equations.RotorSaturation
) -> tuple[MachineState, float, float]:
    """Return the equilibrium that a run starts from; angles count from the network's frame. Source: Kundur, 3.6."""
    c, v, power = machine, start.voltage, inv_committed * start.power
    i_re, i_im = inv_committed * start.current.re, inv_committed * start.current.im
    # x'_d - x'' = (x'_d - x_l)(1 - γ_d), and likewise on the q axis.
    x_d_transient = c.internal_reactance + c.x_d_leak * (1.0 - c.gamma_d)
    x_q = c.internal_reactance + c.x_q_leak * (1.0 - c.gamma_q) + c.x_q_field
    axis_re, axis_im = v.re + (c.resistance * i_re - x_q * i_im), v.im + (c.resistance * i_im + x_q * i_re)
    # Saturation is that of the voltage behind x'', whose size the rotor's frame does not change.
    r, x = c.resistance, c.internal_reactance
    e_re, e_im = v.re + (r * i_re - x * i_im), v.im + (r * i_im + x * i_re)
    on_d = equations.saturation_factor(e_re, e_im, saturation)
    on_q = on_d * saturation.q_weight
    delta = math.atan2(axis_im + on_q * e_im, axis_re + on_q * e_re)
    sine, cosine = math.sin(delta), math.cos(delta)
    i_d, i_q = i_re * sine - i_im * cosine, i_re * cosine + i_im * sine
    v_q = v.re * cosine + v.im * sine
    e_q_transient = v_q + c.resistance * i_q + x_d_transient * i_d
    e_d_transient = c.x_q_field * i_q - on_q * (e_re * sine - e_im * cosine)
    field_voltage = e_q_transient + c.x_d_field * i_d + on_d * (e_re * cosine + e_im * sine)
    exciter, error = equations.exciter_start(field_voltage, c.exciter)
    torque = power + c.resistance * (i_d * i_d + i_q * i_q)
    gate = torque / c.rating
    state = MachineState(
        angle=delta,
        speed=1.0,
        e_q_transient=e_q_transient,
        e_d_transient=e_d_transient,
        psi_1d=e_q_transient - c.x_d_leak * i_d,
        psi_2q=-e_d_transient - c.x_q_leak * i_q,
        exciter=exciter,
        governor=equations.GovernorState(gate, gate),
    )
    return state, start.magnitude + error, gate


@system(FIRST_MACHINE, "frame")
def find_frame(state: MachineState) -> float:
    """Let all angles count from the first machine."""
    return state.angle


@system(MACHINES, "state")
def turn_machine(state: MachineState, frame: float) -> MachineState:
    """Count a machine's angle from the frame."""
    return state._replace(angle=state.angle - frame)


@system(MACHINES, "failure")
def check_machine(state: MachineState, machine: Machine, connection: Connection, failure: Failure) -> Failure:
    """Note a machine that would start beyond the limits of its built-in governor or exciter."""
    gate, field, c = state.governor.gate, state.exciter.field_voltage, machine
    fits = (c.governor.is_unit > 0.5) | (c.governor.gate_min <= gate) & (gate <= c.governor.gate_max)
    failure = units.noted(fits, units.StartFailure.GOVERNOR_LIMIT, connection.number, failure)
    fits = (c.exciter.field_min <= field) & (field <= c.exciter.field_max)
    return units.noted(fits, units.StartFailure.EXCITER_LIMIT, connection.number, failure)


@system(MACHINES, "emf", "unit_voltage")
def voltage_of_machine(state: MachineState, machine: Machine) -> tuple[MachineVoltage, Phasor]:
    """Return the voltage behind x'', in the frames of rotor and network."""
    c, (sine, cosine) = machine, sine_cosine(state.angle)
    e_d = c.gamma_q * state.e_d_transient - (1.0 - c.gamma_q) * state.psi_2q
    e_q = c.gamma_d * state.e_q_transient + (1.0 - c.gamma_d) * state.psi_1d
    return MachineVoltage(sine, cosine, e_d, e_q), Phasor(e_d * sine + e_q * cosine, e_q * sine - e_d * cosine)


@system(MACHINES, "iron", when="saturates")
def saturate_machine(emf: MachineVoltage, saturation: equations.RotorSaturation) -> Saturating:
    """Return what saturation takes; a plant in which no machine saturates does without."""
    factor = equations.saturation_factor(emf.e_d, emf.e_q, saturation)
    return Saturating(factor * emf.e_q, factor * saturation.q_weight * emf.e_d)


@system(MACHINES, "state_rates", "output")
def rates_of_machine(
    state: MachineState,
    emf: MachineVoltage,
    current: Phasor,
    inputs: MachineInput,
    iron: Saturating,
    turbine_torque: float,
    committed: float,
    inv_committed: float,
    machine: Machine,
    reference_speed: float,
    omega_n: float,
) -> tuple[MachineState, equations.MachineOutput]:
    """Return rates and outputs, by the equations of :mod:`wtg_gym.physics.machine`.

    The torque is that of its governor, where that is a unit of its own. Of its equal parts a share is committed: the
    equations are those of all parts, of which each gives as much. After an outage a machine keeps its states.
    """
    s, u, c = state, inputs, machine
    i_re, i_im = inv_committed * current.re, inv_committed * current.im
    i_d, i_q = equations.in_rotor(emf, i_re, i_im)
    voltage = equations.terminal_voltage(emf, i_re, i_im, c)
    power = emf.e_d * i_d + emf.e_q * i_q
    governor, torque = equations.governor_rates(s.governor, s.speed, u.gate_reference, u.inv_droop, c.governor)
    torque = c.rating * torque
    lag_d = s.psi_1d + c.x_d_leak * i_d - s.e_q_transient
    lag_q = s.psi_2q + c.x_q_leak * i_q + s.e_d_transient
    field = s.exciter.field_voltage - s.e_q_transient - c.x_d_field * (i_d - c.gamma_d2 * lag_d)
    damper = -s.e_d_transient + c.x_q_field * (i_q - c.gamma_q2 * lag_q)
    given = select(c.governor.is_unit > 0.5, turbine_torque, torque)
    # The machine's own torque first, then the difference to its governor's: the order that released bits have.
    speed_rate = u.inv_two_h * (torque - power - c.damping * (s.speed - 1.0)) + u.inv_two_h * (given - torque)
    rates = MachineState(
        angle=omega_n * (s.speed - reference_speed),
        speed=speed_rate,
        e_q_transient=c.inv_t_d0_transient * (field - iron.d),
        e_d_transient=c.inv_t_q0_transient * (damper - iron.q),
        psi_1d=-c.inv_t_d0_subtransient * lag_d,
        psi_2q=-c.inv_t_q0_subtransient * lag_q,
        exciter=equations.exciter_rates(s.exciter, u.voltage_reference - voltage, c.exciter),
        governor=governor,
    )
    output = equations.MachineOutput(committed * power, voltage, committed * (u.connected * given))
    return each(lambda rate: u.connected * rate, rates), output


@system(MACHINES, "gate_reference", when="secondary control")
def restore_frequency(
    state: MachineState, inputs: MachineInput, machine: Machine, secondary_gain: float, active: float
) -> float:
    """Move the gate reference of a governor against the deviation of its speed, an integral within the gate's limits.

    Source: UCTE Operation Handbook, appendix 1, load-frequency control.
    """
    g = machine.governor
    moved = inputs.gate_reference - secondary_gain * inputs.inv_droop * (state.speed - 1.0)
    acts = (active > 0.5) & (inputs.inv_droop > 0.0) & (inputs.connected > 0.5)
    return select(acts, clip(moved, g.gate_min, g.gate_max), inputs.gate_reference)


stage_of_machine = units.moving(rates_of_machine, equations.machine_limited, constants=["machine"])
