"""The right-hand side and its integration: loops over units and lanes around the equations of each model.

The same functions serve one lane and blocks of lanes; they are compiled once per lane width, which arrives as a tuple
whose length the compiler knows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.converter_limits import limiting_reactance
from wtg_gym.physics.elementary import fma, select
from wtg_gym.physics.hydro_governor import HydroState, hydro_limited, hydro_rates
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
    N_WTG_ROWS,
    N_WTG_STATES,
    WTG,
    WTG_CAPTURED,
    WTG_ROTOR_SPEED,
    Floats,
    Lanes,
    Phasor,
    Plant,
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
    store_phasor,
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
from wtg_gym.physics.records import elementwise, loader, size, storer
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

#: Stages of :func:`unit_rates`.
EVALUATE, FIRST, MIDDLE, LAST = -1, 0, 1, 2
#: Gauss-Seidel sweeps over the groups whose current is limited, at most: a few, but some thirty for large groups at a
#: weak bus. They end once no voltage moves by more than 1e-12 p.u.; the squares are compared.
_SWEEPS = 100
_SETTLED = 1e-12 * 1e-12


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


@inlined
def extension_at(c: Any, j: int, width: int) -> int:
    """Return where the extension of WTG group j begins: behind its other rows."""
    return (wtg_row(c, j) + N_WTG_ROWS) * width


@inlined
def unit_currents(block: Floats, c: Any, lanes: Lanes) -> None:
    """Find the units' currents I = Y E with the reduced admittance of each lane's network."""
    width, rows = len(lanes), rows_of(c)
    n = c["unit_bus"].shape[0]
    for i in range(n):
        at, y = (rows.current + 2 * i) * width, (rows.admittance + 2 * i * n) * width
        for x in range(2 * width):
            block[at + x] = 0.0
        # Three at a time: sums in registers save half of the memory's traffic.
        for j in range(0, n - n % 3, 3):
            e_j, y_j = (rows.voltage + 2 * j) * width, y + 2 * j * width
            for x in range(width):
                current = load_phasor(block, at + x, width)
                current = _plus_product(current, block, y_j + x, e_j + x, width)
                current = _plus_product(current, block, y_j + 2 * width + x, e_j + 2 * width + x, width)
                current = _plus_product(current, block, y_j + 4 * width + x, e_j + 4 * width + x, width)
                store_phasor(current, block, at + x, width)
        for j in range(n - n % 3, n):
            e_j, y_j = (rows.voltage + 2 * j) * width, y + 2 * j * width
            for x in range(width):
                current = load_phasor(block, at + x, width)
                store_phasor(_plus_product(current, block, y_j + x, e_j + x, width), block, at + x, width)
    if c["extension"].shape[0] > 0:
        _limit_currents(block, c, lanes)


@inlined
def _limit_currents(block: Floats, c: Any, lanes: Lanes) -> None:
    """Turn the voltages of groups whose current is too large into those behind their limiting reactance.

    A lane without such a group, or one that has settled, keeps its bits, whatever its neighbours do.
    """
    width, rows = len(lanes), rows_of(c)
    n_sync = c["machines"].shape[0]
    limit = read_extension(c["extension"][0]).limits.current_max
    # Whole numbers: a sum of them is taken for all lanes at once, the largest of floats is not.
    exceeded = np.int64(0)
    for j in range(c["share"].shape[0]):
        current_at, o = (rows.current + 2 * (n_sync + j)) * width, extension_at(c, j, width) + EXTENSION.output * width
        largest = (limit * c["share"][j]) * (limit * c["share"][j])
        for x in range(width):
            current = load_phasor(block, current_at + x, width)
            exceeded += np.int64(fma(current.re, current.re, current.im * current.im) > largest)
            block[o + x] = 0.0
    if exceeded == 0:
        return
    for j in range(c["share"].shape[0]):
        e, o = (rows.voltage + 2 * (n_sync + j)) * width, extension_at(c, j, width) + EXTENSION.source * width
        for x in range(width):
            store_phasor(load_phasor(block, e + x, width), block, o + x, width)
    for _ in range(_SWEEPS):
        moved = np.int64(0)
        for j in range(c["share"].shape[0]):
            moved += _limit_current(block, c, j, limit * c["share"][j], lanes)
        if moved == 0:
            return


@inlined
def _limit_current(block: Floats, c: Any, j: int, limit: float, lanes: Lanes) -> np.int64:
    """Find the limiting reactance of WTG group j with everybody else's voltage as it is, and move all currents.

    Returns:
        in how many lanes its voltage has moved.
    """
    width, rows = len(lanes), rows_of(c)
    n = c["unit_bus"].shape[0]
    unit = c["machines"].shape[0] + j
    own, o = (rows.voltage + 2 * unit) * width, extension_at(c, j, width)
    moved = np.int64(0)
    for x in range(width):
        y = load_phasor(block, (rows.admittance + 2 * (unit * n + unit)) * width + x, width)
        source = load_phasor(block, o + EXTENSION.source * width + x, width)
        e = load_phasor(block, own + x, width)
        current = load_phasor(block, (rows.current + 2 * unit) * width + x, width)
        free = _plus(current, y, Phasor(source.re - e.re, source.im - e.im))
        reactance = limiting_reactance(free.re, free.im, y.re, y.im, limit)
        # E' = E - jX_v I, and I = I_0 / (1 + jX_v Y).
        d_re, d_im = 1.0 - reactance * y.im, reactance * y.re
        size = reactance / fma(d_re, d_re, d_im * d_im)
        drop_re = size * fma(free.re, d_re, free.im * d_im)
        drop_im = size * fma(free.im, d_re, -(free.re * d_im))
        change = Phasor(source.re + drop_im - e.re, source.im - drop_re - e.im)
        moves = fma(change.re, change.re, change.im * change.im) > _SETTLED
        change = Phasor(select(moves, change.re, 0.0), select(moves, change.im, 0.0))
        moved += np.int64(moves)
        block[o + EXTENSION.output * width + x] = reactance
        store_phasor(change, block, o + EXTENSION.change * width + x, width)
        store_phasor(Phasor(e.re + change.re, e.im + change.im), block, own + x, width)
    for i in range(n):
        for x in range(width):
            y = load_phasor(block, (rows.admittance + 2 * (i * n + unit)) * width + x, width)
            change = load_phasor(block, o + EXTENSION.change * width + x, width)
            current = load_phasor(block, (rows.current + 2 * i) * width + x, width)
            store_phasor(_plus(current, y, change), block, (rows.current + 2 * i) * width + x, width)
    return moved


@inlined
def _plus_product(total: Phasor, block: Floats, admittance: int, voltage: int, width: int) -> Phasor:
    return _plus(total, load_phasor(block, admittance, width), load_phasor(block, voltage, width))


@inlined
def _plus(total: Phasor, y: Phasor, e: Phasor) -> Phasor:
    return Phasor(total.re + fma(y.re, e.re, -(y.im * e.im)), total.im + fma(y.re, e.im, y.im * e.re))


@inlined
def _base(state: float, base: float, first: bool) -> float:
    return select(first, state, base)


@inlined
def _sum(rate: float, total: float, first: bool) -> float:
    return select(first, rate, fma(2.0, rate, total))


@inlined
def _moved(base: float, rate: float, total: float, ahead: float, last: bool) -> float:
    # The last stage goes along the sum of all rates, k1 + 2 k2 + 2 k3 + k4.
    return fma(ahead, select(last, total + rate, rate), base)


@inlined
def _kept(moved: float, limited: float, base: float, last: bool, active: float) -> float:
    # An ended lane keeps its base exactly: nothing, not even a rounding, is added to it.
    return select(active > 0.5, select(last, limited, moved), base)


def _advancer(record: type[Any], limited: Callable[..., Any]) -> Callable[..., None]:
    """Return the function that moves a unit's states by one stage.

    Args:
        record: of the states; rows for their base and their sum of rates follow theirs.
        limited: compiled; returns the states, held within their limits, given states and constants.
    """
    load: Callable[..., Any] = loader(record)
    store: Callable[..., None] = storer(record)
    n = size(record)
    base_of: Callable[..., Any] = elementwise(record, _base, "base", "state, base", "first")
    sum_of: Callable[..., Any] = elementwise(record, _sum, "sum", "rate, total", "first")
    moved_of: Callable[..., Any] = elementwise(record, _moved, "moved", "base, rate, total", "ahead, last")
    kept_of: Callable[..., Any] = elementwise(record, _kept, "kept", "moved, limited, base", "last, active")

    @inlined
    def advance(
        state: Any,
        rates: Any,
        constants: Any,
        block: Floats,
        at: int,
        rate_at: int,
        active: float,
        stage: np.int64,
        ahead: float,
        width: int,
    ) -> None:
        first, last = stage == FIRST, stage == LAST
        if stage == EVALUATE:
            store(rates, block, rate_at, width)
        else:
            base = base_of(state, load(block, at + n * width, width), first)
            total = load(block, at + 2 * n * width, width)
            moved = moved_of(base, rates, total, ahead, last)
            moved = kept_of(moved, limited(moved, constants), base, last, active)
            store(moved, block, at, width)
            if first:
                store(base, block, at + n * width, width)
            if not last:
                store(sum_of(rates, total, first), block, at + 2 * n * width, width)

    return advance


_advance_machine = _advancer(MachineState, machine_limited)
_advance_hydro = _advancer(HydroState, hydro_limited)
_advance_wtg = _advancer(WtgState, wtg_limited)
_advance_extension = _advancer(ExtensionState, extension_limited)


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
        stage: one of FIRST, MIDDLE and LAST of the method; EVALUATE leaves the states and stores the rates. A constant
            where it is called: each stage is compiled for itself, without what it does not need.
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
    """The angle of the first unit against a frame at nominal frequency."""
    width = len(lanes)
    first, last = stage == FIRST, stage == LAST
    omega_n, lane = c["omega_n"], rows_of(c).lane * width
    for x in range(width):
        rate = omega_n * (block[lane + LANE.reference_speed * width + x] - 1.0)
        if stage == EVALUATE:
            block[lane + LANE.rate * width + x] = rate
        else:
            base = _base(block[lane + LANE.angle * width + x], block[lane + LANE.base * width + x], first)
            total = block[lane + LANE.sum * width + x]
            moved = _moved(base, rate, total, ahead, last)
            active = block[lane + LANE.active * width + x]
            block[lane + LANE.base * width + x] = base
            block[lane + LANE.sum * width + x] = _sum(rate, total, first)
            block[lane + LANE.angle * width + x] = _kept(moved, moved, base, last, active)


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
    _stage(block, c, step * part, np.int64(FIRST), 0.5 * h, lanes)
    # A loop, so that the stage is compiled once.
    for middle in range(2):
        _stage(block, c, (step + 0.5) * part, np.int64(MIDDLE), h if middle == 1 else 0.5 * h, lanes)
    _stage(block, c, (step + 1.0) * part, np.int64(LAST), h / 6.0, lanes)


@inlined
def _stage(block: Floats, c: Any, fraction: float, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    unit_voltages(block, c, lanes)
    unit_currents(block, c, lanes)
    unit_rates(block, c, fraction, stage, ahead, lanes)


@compiled
def evaluate_rates(blocks: Floats, plant: Plant, lanes: Lanes) -> None:
    """Evaluate the time derivatives of all blocks at the start of their wind interval, in place."""
    for b in range(blocks.shape[0]):
        derivatives(blocks[b], plant.constants[0], 0.0, lanes)
