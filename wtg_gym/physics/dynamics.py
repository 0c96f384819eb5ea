"""The right-hand side and a step of its integration: loops over units and lanes around the equations of each model.

The same functions serve one lane and blocks of lanes; they are compiled once per lane width, which arrives as a tuple
whose length the compiler knows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.currents import unit_currents
from wtg_gym.physics.elementary import select
from wtg_gym.physics.governor import HydroState, hydro_limited, hydro_rates
from wtg_gym.physics.kernel_data import Plant
from wtg_gym.physics.layout import (
    EXTENSION,
    LANE,
    MACHINE,
    MACHINE_TORQUE,
    N_EXTENSION_STATES,
    N_HYDRO_ROWS,
    N_HYDRO_STATES,
    N_MACHINE_ROWS,
    N_MACHINE_STATES,
    N_WTG_STATES,
    WTG,
    WTG_CAPTURED,
    WTG_ROTOR_SPEED,
    Floats,
    Lanes,
    Phasor,
    extension_at,
    load_extension_input,
    load_extension_state,
    load_hydro_state,
    load_machine_emf,
    load_machine_input,
    load_machine_state,
    load_phasor,
    load_wtg_input,
    load_wtg_state,
    read_extension,
    read_hydro,
    read_machine,
    read_turbine,
    rows_of,
    store_extension_output,
    store_machine_emf,
    store_machine_output,
    store_wtg_output,
    wtg_row,
)
from wtg_gym.physics.machine import (
    MachineOutput,
    MachineState,
    driven_by,
    machine_limited,
    machine_rates,
    machine_voltage,
)
from wtg_gym.physics.records import elementwise
from wtg_gym.physics.runge_kutta import EVALUATE, FIRST, LAST, MIDDLE, advancer
from wtg_gym.physics.wind_turbine import (
    ExtensionState,
    Turbine,
    WtgState,
    at_terminal,
    captured_power,
    extended_rates,
    extension_limited,
    rotor_of_energy,
    wind_at,
    wtg_limited,
    wtg_rates,
    wtg_voltage,
)


@inlined
def unit_voltages(block: Floats, c: Any, lanes: Lanes) -> None:
    """Find the voltages behind the internal impedances, in the network's frame, for every lane of a block."""
    width, rows = len(lanes), rows_of(c)
    n_sync = c["machines"].shape[0]
    for x in range(width):
        block[(rows.lane + LANE.reference_speed) * width + x] = load_machine_state(block, x, width).speed
    for i in range(n_sync):
        machine = read_machine(c["machines"][i])
        o, voltage = i * N_MACHINE_ROWS * width, (rows.voltage + 2 * i) * width
        for x in range(width):
            emf, re, im = machine_voltage(load_machine_state(block, o + x, width), machine)
            store_machine_emf(emf, block, o + MACHINE.emf * width + x, width)
            block[voltage + x] = re
            block[voltage + width + x] = im
    for j in range(c["share"].shape[0]):
        o, voltage = wtg_row(c, j) * width, (rows.voltage + 2 * (n_sync + j)) * width
        for x in range(width):
            magnitude = load_wtg_input(block, o + WTG.input * width + x, width).emf
            if c["extension"].shape[0] > 0:
                magnitude = load_extension_state(block, extension_at(c, j, width) + x, width).internal_voltage
            re, im = wtg_voltage(load_wtg_state(block, o + x, width), magnitude)
            block[voltage + x] = re
            block[voltage + width + x] = im


_advance_machine = advancer(MachineState, machine_limited)
_advance_hydro = advancer(HydroState, hydro_limited)
_advance_wtg = advancer(WtgState, wtg_limited)
_advance_extension = advancer(ExtensionState, extension_limited)


class ReferenceAngle(NamedTuple):
    """State of a lane: the angle of the first unit against a frame at nominal frequency [rad]."""

    angle: float


@inlined
def _unlimited(state: ReferenceAngle, c: float) -> ReferenceAngle:
    return state


_advance_angle = advancer(ReferenceAngle, _unlimited)


@inlined
def _share(rate: float, connected: float) -> float:
    return connected * rate


_share_of_machine: Callable[..., Any] = elementwise(MachineState, _share, "share", "rates", "connected")
_share_of_hydro: Callable[..., Any] = elementwise(HydroState, _share, "share", "rates", "connected")


@inlined
def unit_rates(block: Floats, c: Any, fraction: float, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    """Evaluate the units' rates and outputs, and move their states by one stage of the Runge-Kutta method.

    Args:
        block, lanes: as for :func:`advance_step`.
        c: constants of the plant.
        fraction: of the control interval that has passed, 0 … 1.
        stage: FIRST, MIDDLE or LAST of the method, or EVALUATE, which stores the rates and leaves the states. Callers
            pass a constant, so that the compiler specialises the function for each.
        ahead: how far the stage moves the states from their base [s]; a sixth of the step for the last.
    """
    _hydro_governors(block, c, stage, ahead, lanes)
    _machines(block, c, stage, ahead, lanes)
    _wtgs(block, c, fraction, stage, ahead, lanes)
    _reference_angle(block, c, stage, ahead, lanes)


@inlined
def _hydro_governors(block: Floats, c: Any, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    """Move hydro governors, and write their torque into the rows of their machines, which come next."""
    width, rows = len(lanes), rows_of(c)
    for h in range(c["hydro"].shape[0]):
        governor = read_hydro(c["hydro"][h])
        rating = read_machine(c["machines"][governor.machine]).rating
        o, machine = (rows.hydro + h * N_HYDRO_ROWS) * width, governor.machine * N_MACHINE_ROWS * width
        rate = (rows.hydro_rate + h * N_HYDRO_STATES) * width
        for x in range(width):
            state = load_hydro_state(block, o + x, width)
            speed = load_machine_state(block, machine + x, width).speed
            given = load_machine_input(block, machine + MACHINE.input * width + x, width)
            rates, torque = hydro_rates(state, speed, given.gate_reference, given.inv_droop, governor)
            block[machine + MACHINE_TORQUE * width + x] = rating * torque
            active = block[(rows.lane + LANE.active) * width + x] * given.connected
            if stage == EVALUATE:
                rates = _share_of_hydro(rates, given.connected)
            _advance_hydro(state, rates, governor, block, o + x, rate + x, active, stage, ahead, width)


@inlined
def _machines(block: Floats, c: Any, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    width, rows = len(lanes), rows_of(c)
    omega_n, lane = c["omega_n"], rows.lane * width
    for i in range(c["machines"].shape[0]):
        machine = read_machine(c["machines"][i])
        o, current = i * N_MACHINE_ROWS * width, (rows.current + 2 * i) * width
        rate = (rows.machine_rate + i * N_MACHINE_STATES) * width
        for x in range(width):
            state = load_machine_state(block, o + x, width)
            given = load_machine_input(block, o + MACHINE.input * width + x, width)
            rates, output = machine_rates(
                state,
                load_machine_emf(block, o + MACHINE.emf * width + x, width),
                block[current + x],
                block[current + width + x],
                given,
                machine,
                block[lane + LANE.reference_speed * width + x],
                omega_n,
            )
            # After an outage a machine keeps its states. The first one's speed goes on turning the frame of all angles.
            active = block[lane + LANE.active * width + x] * given.connected
            if c["hydro"].shape[0] > 0:
                torque = select(machine.governor.is_hydro > 0.5, block[o + MACHINE_TORQUE * width + x], output.torque)
                rates = driven_by(torque, rates, output, given)
                output = MachineOutput(output.power, output.voltage, torque)
            output = MachineOutput(output.power, output.voltage, given.connected * output.torque)
            if stage == EVALUATE:
                rates = _share_of_machine(rates, given.connected)
            store_machine_output(output, block, o + MACHINE.output * width + x, width)
            _advance_machine(state, rates, machine, block, o + x, rate + x, active, stage, ahead, width)


@inlined
def _wtgs(block: Floats, c: Any, fraction: float, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    width, rows = len(lanes), rows_of(c)
    omega_n, lane = c["omega_n"], rows.lane * width
    turbine, n_sync = read_turbine(c["turbine"]), c["machines"].shape[0]
    for j in range(c["share"].shape[0]):
        o, unit = wtg_row(c, j) * width, 2 * (n_sync + j)
        rate = (rows.wtg_rate + j * N_WTG_STATES) * width
        inv_share = 1.0 / c["share"][j]
        if c["cells"].shape[0] > 0:
            # In a loop of its own: looking up a table does not go lane beside lane, all the rest does.
            for x in range(width):
                state = load_wtg_state(block, o + x, width)
                wind = wind_at(load_wtg_input(block, o + WTG.input * width + x, width), fraction)
                block[o + WTG_CAPTURED * width + x] = captured_power(
                    state.rotor_speed, wind, state.pitch.pitch, turbine.rotor, c["cells"]
                )
        for x in range(width):
            state = load_wtg_state(block, o + x, width)
            e = load_phasor(block, (rows.voltage + unit) * width + x, width)
            current = load_phasor(block, (rows.current + unit) * width + x, width)
            given = load_wtg_input(block, o + WTG.input * width + x, width)
            power = inv_share * (e.re * current.re + e.im * current.im)
            wind = wind_at(given, fraction)
            if c["cells"].shape[0] > 0:
                captured = block[o + WTG_CAPTURED * width + x]
            else:
                captured = captured_power(state.rotor_speed, wind, state.pitch.pitch, turbine.rotor, c["cells"])
            rates, output = wtg_rates(
                state, power, captured, wind, given, turbine, block[lane + LANE.reference_speed * width + x], omega_n
            )
            active = block[lane + LANE.active * width + x]
            if c["extension"].shape[0] > 0:
                extension = read_extension(c["extension"][0])
                at, rate_at = extension_at(c, j, width) + x, rows.extension_rate + j * N_EXTENSION_STATES
                own = load_extension_state(block, at, width)
                reactance = block[at + EXTENSION.output * width]
                own_current = Phasor(inv_share * current.re, inv_share * current.im)
                terminal = at_terminal(e.re, e.im, own_current.re, own_current.im, reactance, turbine.converter)
                store_extension_output(terminal, block, at + EXTENSION.output * width, width)
                references = load_extension_input(block, at + EXTENSION.input * width, width)
                rates, own_rates = extended_rates(
                    rates, state, own, power, terminal, given, references, turbine, extension, omega_n
                )
                _advance_extension(
                    own, own_rates, extension, block, at, rate_at * width + x, active, stage, ahead, width
                )
            store_wtg_output(output, block, o + WTG.output * width + x, width)
            _advance_wtg(state, rates, turbine, block, o + x, rate + x, active, stage, ahead, width)
            if c["extension"].shape[0] > 0 and stage == LAST:
                keep_energy(block, c, j, x, turbine, width)


@inlined
def keep_energy(block: Floats, c: Any, j: int, x: int, turbine: Turbine, width: int) -> None:
    """Set the rotor speed of extended WTG group j of a running lane from the energies of a whole step."""
    o, at = wtg_row(c, j) * width + x, extension_at(c, j, width) + x
    before = load_wtg_state(block, o + N_WTG_STATES * width, width)
    after = load_wtg_state(block, o, width)
    own_before = load_extension_state(block, at + N_EXTENSION_STATES * width, width)
    own_after = load_extension_state(block, at, width)
    chopped = own_after.limits.energy_chopped - own_before.limits.energy_chopped
    speed = rotor_of_energy(before, after, chopped, turbine, read_extension(c["extension"][0]))
    active = block[(rows_of(c).lane + LANE.active) * width + x]
    block[o + WTG_ROTOR_SPEED * width] = select(active > 0.5, speed, after.rotor_speed)


@inlined
def _reference_angle(block: Floats, c: Any, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    """Move the angle of the first unit against a frame at nominal frequency."""
    width, omega_n = len(lanes), c["omega_n"]
    for x in range(width):
        lane = rows_of(c).lane * width + x
        rates = ReferenceAngle(omega_n * (block[lane + LANE.reference_speed * width] - 1.0))
        state = ReferenceAngle(block[lane + LANE.angle * width])
        active = block[lane + LANE.active * width]
        at, rate_at = lane + LANE.angle * width, lane + LANE.rate * width
        _advance_angle(state, rates, omega_n, block, at, rate_at, active, stage, ahead, width)


@inlined
def derivatives(block: Floats, c: Any, fraction: float, lanes: Lanes) -> None:
    """Evaluate rates and outputs of every lane of a block at its present state."""
    unit_voltages(block, c, lanes)
    unit_currents(block, c, lanes)
    unit_rates(block, c, fraction, np.int64(EVALUATE), 0.0, lanes)


@inlined
def advance_step(block: Floats, c: Any, step: int, lanes: Lanes) -> None:
    """Advance every running lane of a block by one simulation step with the classical Runge-Kutta method.

    Args:
        block: one block's rows, flat (see :mod:`wtg_gym.physics.layout`).
        c: constants of the plant.
        step: number of the step within the control interval, for the wind's interpolation.
        lanes: a tuple as long as the block is wide.
    """
    h = c["simulation_dt"]
    part = 1.0 / c["n_substeps"]
    advance_stage(block, c, step * part, np.int64(FIRST), 0.5 * h, lanes)
    # A loop, so that the stage is compiled once.
    for middle in range(2):
        advance_stage(block, c, (step + 0.5) * part, np.int64(MIDDLE), h if middle == 1 else 0.5 * h, lanes)
    advance_stage(block, c, (step + 1.0) * part, np.int64(LAST), h / 6.0, lanes)


@inlined
def advance_stage(block: Floats, c: Any, fraction: float, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    unit_voltages(block, c, lanes)
    unit_currents(block, c, lanes)
    unit_rates(block, c, fraction, stage, ahead, lanes)


@compiled
def evaluate_rates(blocks: Floats, plant: Plant, lanes: Lanes) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, in place."""
    for b in range(blocks.shape[0]):
        derivatives(blocks[b], plant.constants[0], 0.0, lanes)
