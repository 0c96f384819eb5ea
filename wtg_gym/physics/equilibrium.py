"""The exact equilibrium a lane starts from: turbines, power flow, then every unit backwards from its terminal."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.integration import plan, refresh, release, settle, start
from wtg_gym.physics.kernel_data import LaneData, Network
from wtg_gym.physics.layout import OF_LANE, OF_STARTING_BUS, OF_STARTING_LANE, Floats, n_rows_of
from wtg_gym.physics.network import solve_power_flow
from wtg_gym.physics.units import BUSES, StartFailure
from wtg_gym.systems.compiled import compiled, internal
from wtg_gym.systems.programs import NONE
from wtg_gym.systems.routines import Function

#: Rows of a bus in scratch.
_STRIDE = n_rows_of(BUSES.scratch)
POWER_FLOW = Function(solve_power_flow, 1)
_flow = POWER_FLOW.call
_DIVERGED = float(StartFailure.POWER_FLOW_DIVERGED)


@internal
def _solve(scratch: Floats, y: npt.NDArray[np.complex128], network: Network) -> bool:
    """Find the voltages and flows of what buses and units plan; return whether there are any."""
    first, n = network.facts[0]["starts_of_buses"], y.shape[0]
    power, magnitude, angle = np.empty(n, dtype=np.complex128), np.empty(n), np.empty(n)
    holds_voltage = np.empty(n, dtype=np.bool_)
    for k in range(n):
        row = first + k * _STRIDE
        power[k] = complex(scratch[row + OF_STARTING_BUS.planned, 0], scratch[row + OF_STARTING_BUS.planned + 1, 0])
        magnitude[k], angle[k] = scratch[row + OF_STARTING_BUS.polar, 0], scratch[row + OF_STARTING_BUS.polar + 1, 0]
        holds_voltage[k] = scratch[row + OF_STARTING_BUS.holds, 0] > 0.5
    slack = network.facts[0]["slack"]
    if _flow(network.tables, (y, slack, holds_voltage, power, magnitude, angle)) < 0:
        return False
    # From here on it is the voltage.
    for k in range(n):
        power[k] = magnitude[k] * complex(math.cos(angle[k]), math.sin(angle[k]))
    for k in range(n):
        injected = 0j
        for m in range(n):
            injected += y[k, m] * power[m]
        flow, row = power[k] * injected.conjugate(), first + k * _STRIDE
        scratch[row + OF_STARTING_BUS.polar, 0], scratch[row + OF_STARTING_BUS.polar + 1, 0] = magnitude[k], angle[k]
        scratch[row + OF_STARTING_BUS.flow, 0], scratch[row + OF_STARTING_BUS.flow + 1, 0] = flow.real, flow.imag
        scratch[row + OF_STARTING_BUS.at_bus, 0], scratch[row + OF_STARTING_BUS.at_bus + 1, 0] = (
            power[k].real,
            power[k].imag,
        )
    return True


@compiled
def prepare_lanes(
    rows: Floats,
    scratch: Floats,
    y: npt.NDArray[np.complex128],
    network: Network,
    data: LaneData,
    load_levels: Floats,
    failures: npt.NDArray[np.int64],
) -> None:
    """Put lanes into the equilibrium of their wind, law and load, at nominal frequency.

    Args:
        rows: (n, n_rows, 1); laws, first wind, bus of the load noise, the machines' inv_two_h and inv_droop are set.
        scratch: (n_scratch, 1).
        y: bus admittance matrix without loads and units (n_bus, n_bus) [p.u.].
        network: constants.
        data: of the lanes; load events are given as P + jQ [p.u.], and turned into admittances here.
        load_levels: shares of the nominal load (n,).
        failures: takes why a lane cannot start, and the number of the unit that cannot, machines first (n, 2).
    """
    facts, tables = network.facts[0], network.tables
    own, buses = facts["starts"], facts["starts_of_buses"]
    for lane in range(rows.shape[0]):
        block, arrays = rows[lane], (rows[lane], scratch)
        scratch[own + OF_STARTING_LANE.load_level, 0] = load_levels[lane]
        plan(arrays, tables, NONE)
        released = scratch[own + OF_STARTING_LANE.start_failure, 0] == 0.0
        while released:
            if not _solve(scratch, y, network):
                scratch[own + OF_STARTING_LANE.start_failure, 0] = _DIVERGED
                break
            # Each time at least one bus lets go, and no bus does twice.
            release(arrays, tables, NONE)
            released = scratch[own + OF_STARTING_LANE.released, 0] > 0.0
        if scratch[own + OF_STARTING_LANE.start_failure, 0] == 0.0:
            settle(arrays, tables, NONE)
            noise_bus = int(block[facts["lane"] + OF_LANE.noise_bus, 0])
            voltage = scratch[buses + noise_bus * _STRIDE + OF_STARTING_BUS.polar, 0]
            block[facts["lane"] + OF_LANE.noise_per_mw, 0] = 1.0 / (facts["base_mva"] * voltage * voltage)
            events = data.events[lane]
            for e in range(events.shape[0]):
                if events[e]["bus"] >= 0:
                    voltage = scratch[buses + events[e]["bus"] * _STRIDE + OF_STARTING_BUS.polar, 0]
                    power, square = events[e]["admittance"], voltage * voltage
                    events[e]["admittance"] = complex(power.real / square, power.imag / -square)
            refresh(tables, (block, 0, lane, network, data))
            start(arrays, tables, NONE)
        failures[lane, 0] = int(scratch[own + OF_STARTING_LANE.start_failure, 0])
        failures[lane, 1] = int(scratch[own + OF_STARTING_LANE.failing_unit, 0])
