"""The right-hand side and its integration: loops over units and lanes around the equations of each model.

The same functions serve one lane and blocks of lanes; they are compiled once per lane width, which arrives as a tuple
whose length the compiler knows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.elementary import fma, select
from wtg_gym.physics.layout import (
    LANE,
    MACHINE,
    N_MACHINE_ROWS,
    N_MACHINE_STATES,
    N_WTG_ROWS,
    N_WTG_STATES,
    WTG,
    Floats,
    Lanes,
    Phasor,
    Plant,
    load_machine_emf,
    load_machine_input,
    load_machine_state,
    load_phasor,
    load_wtg_input,
    load_wtg_state,
    read_machine,
    read_turbine,
    rows_of,
    store_machine_emf,
    store_machine_output,
    store_machine_state,
    store_phasor,
    store_wtg_output,
    store_wtg_state,
)
from wtg_gym.physics.machine import MachineState, machine_limited, machine_rates, machine_voltage
from wtg_gym.physics.records import elementwise
from wtg_gym.physics.wind_turbine import WtgState, wtg_limited, wtg_rates, wtg_voltage

#: Stages of :func:`unit_rates`.
EVALUATE, FIRST, MIDDLE, LAST = -1, 0, 1, 2


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
        o, voltage = (rows.wtg + j * N_WTG_ROWS) * width, (rows.voltage + 2 * (n_sync + j)) * width
        for x in range(width):
            state, given = load_wtg_state(block, o + x, width), load_wtg_input(block, o + WTG.input * width + x, width)
            re, im = wtg_voltage(state, given)
            block[voltage + x] = re
            block[voltage + width + x] = im


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


@inlined
def _plus_product(total: Phasor, block: Floats, admittance: int, voltage: int, width: int) -> Phasor:
    y, e = load_phasor(block, admittance, width), load_phasor(block, voltage, width)
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


_machine_base = elementwise(MachineState, _base, "base", "state, base", "first")
_machine_sum = elementwise(MachineState, _sum, "sum", "rate, total", "first")
_machine_moved = elementwise(MachineState, _moved, "moved", "base, rate, total", "ahead, last")
_machine_kept = elementwise(MachineState, _kept, "kept", "moved, limited, base", "last, active")
_wtg_base = elementwise(WtgState, _base, "base", "state, base", "first")
_wtg_sum = elementwise(WtgState, _sum, "sum", "rate, total", "first")
_wtg_moved = elementwise(WtgState, _moved, "moved", "base, rate, total", "ahead, last")
_wtg_kept = elementwise(WtgState, _kept, "kept", "moved, limited, base", "last, active")


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
    _machines(block, c, stage, ahead, lanes)
    _wtgs(block, c, fraction, stage, ahead, lanes)
    _reference_angle(block, c, stage, ahead, lanes)


@inlined
def _machines(block: Floats, c: Any, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    width, rows = len(lanes), rows_of(c)
    first, last = stage == FIRST, stage == LAST
    omega_n, lane = c["omega_n"], rows.lane * width
    for i in range(c["machines"].shape[0]):
        machine = read_machine(c["machines"][i])
        o, current = i * N_MACHINE_ROWS * width, (rows.current + 2 * i) * width
        rate = (rows.machine_rate + i * N_MACHINE_STATES) * width
        for x in range(width):
            state = load_machine_state(block, o + x, width)
            rates, output = machine_rates(
                state,
                load_machine_emf(block, o + MACHINE.emf * width + x, width),
                block[current + x],
                block[current + width + x],
                load_machine_input(block, o + MACHINE.input * width + x, width),
                machine,
                block[lane + LANE.reference_speed * width + x],
                omega_n,
            )
            store_machine_output(output, block, o + MACHINE.output * width + x, width)
            if stage == EVALUATE:
                store_machine_state(rates, block, rate + x, width)
            else:
                base = _machine_base(state, load_machine_state(block, o + MACHINE.base * width + x, width), first)
                total = load_machine_state(block, o + MACHINE.sum * width + x, width)
                moved = _machine_moved(base, rates, total, ahead, last)
                active = block[lane + LANE.active * width + x]
                moved = _machine_kept(moved, machine_limited(moved, machine), base, last, active)
                store_machine_state(moved, block, o + x, width)
                if first:
                    store_machine_state(base, block, o + MACHINE.base * width + x, width)
                if not last:
                    total = _machine_sum(rates, total, first)
                    store_machine_state(total, block, o + MACHINE.sum * width + x, width)


@inlined
def _wtgs(block: Floats, c: Any, fraction: float, stage: np.int64, ahead: float, lanes: Lanes) -> None:
    width, rows = len(lanes), rows_of(c)
    first, last = stage == FIRST, stage == LAST
    omega_n, lane = c["omega_n"], rows.lane * width
    turbine, n_sync = read_turbine(c["turbine"]), c["machines"].shape[0]
    for j in range(c["share"].shape[0]):
        o, unit = (rows.wtg + j * N_WTG_ROWS) * width, 2 * (n_sync + j)
        rate = (rows.wtg_rate + j * N_WTG_STATES) * width
        inv_share = 1.0 / c["share"][j]
        for x in range(width):
            state = load_wtg_state(block, o + x, width)
            e = load_phasor(block, (rows.voltage + unit) * width + x, width)
            current = load_phasor(block, (rows.current + unit) * width + x, width)
            rates, output = wtg_rates(
                state,
                inv_share * (e.re * current.re + e.im * current.im),
                load_wtg_input(block, o + WTG.input * width + x, width),
                turbine,
                fraction,
                block[lane + LANE.reference_speed * width + x],
                omega_n,
            )
            store_wtg_output(output, block, o + WTG.output * width + x, width)
            if stage == EVALUATE:
                store_wtg_state(rates, block, rate + x, width)
            else:
                base = _wtg_base(state, load_wtg_state(block, o + WTG.base * width + x, width), first)
                total = load_wtg_state(block, o + WTG.sum * width + x, width)
                moved = _wtg_moved(base, rates, total, ahead, last)
                active = block[lane + LANE.active * width + x]
                moved = _wtg_kept(moved, wtg_limited(moved, turbine), base, last, active)
                store_wtg_state(moved, block, o + x, width)
                if first:
                    store_wtg_state(base, block, o + WTG.base * width + x, width)
                if not last:
                    store_wtg_state(_wtg_sum(rates, total, first), block, o + WTG.sum * width + x, width)


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
    """Evaluate rates and outputs of every lane of a block where it stands."""
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
