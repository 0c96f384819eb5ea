"""Hydro governors as units: attached to machines, whose torque they set."""

from __future__ import annotations

from wtg_gym.physics.governor import HydroGovernor, HydroState, hydro_limited, hydro_rates, hydro_start
from wtg_gym.physics.machine import Machine, MachineInput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.units import LANE, UNITS, StartFailure, noted
from wtg_gym.systems.elementary import select
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import Kind, system

HYDRO = Kind(
    name="hydro governors",
    rows={"water": HydroState},
    constants={"hydro": HydroGovernor},
    sees={"machine": MACHINES, "unit": UNITS, "lane": LANE},
    states=("water",),
)


@system(HYDRO, "water", "gate_reference")
def start_hydro(gate_reference: float, hydro: HydroGovernor) -> tuple[HydroState, float]:
    """Return the equilibrium at the torque that its machine needs."""
    water = hydro_start(gate_reference, hydro)
    return water, water.hydro_gate


@system(HYDRO, "start_failure", "failing_unit")
def check_hydro(
    water: HydroState, hydro: HydroGovernor, start_failure: float, failing_unit: float
) -> tuple[float, float]:
    """Note a governor whose gate would start beyond its limits; machines have the first numbers of all units."""
    fits = (hydro.gate_min <= water.hydro_gate) & (water.hydro_gate <= hydro.gate_max)
    return noted(fits, StartFailure.GOVERNOR_LIMIT, hydro.machine, start_failure, failing_unit)


@system(HYDRO, "water_rates", "turbine_torque")
def rates_of_hydro(
    water: HydroState, state: MachineState, given: MachineInput, machine: Machine, hydro: HydroGovernor
) -> tuple[HydroState, float]:
    """Return the rates, and the torque of the machine, which comes after and finds it."""
    rates, torque = hydro_rates(water, state.speed, given.gate_reference, given.inv_droop, hydro)
    return each(lambda rate: given.connected * rate, rates), machine.rating * torque


@system(HYDRO, "water", when="extended")
def return_hydro(water: HydroState, returns: float, hydro: HydroGovernor) -> HydroState:
    """Close the gate of a machine that comes back to the flow without load."""
    found = hydro_start(0.0, hydro)
    back: HydroState = each(lambda new, old: select(returns > 0.5, new, old), found, water)
    return back


stage_of_hydro = moving(rates_of_hydro, hydro_limited, constants=["hydro"])
