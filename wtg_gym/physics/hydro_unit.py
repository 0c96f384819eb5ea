"""Hydro governors as units: attached to machines, whose torque they set."""

from __future__ import annotations

from wtg_gym.physics.governor import HydroGovernor, HydroState, hydro_limited, hydro_rates, hydro_start
from wtg_gym.physics.machine import Machine, MachineInput, MachineState
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.runge_kutta import kept, moved_by_stage
from wtg_gym.physics.units import LANE
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import Kind, system

HYDRO = Kind(
    name="hydro governors",
    rows={"water": HydroState},
    scratch={"water_base": HydroState, "water_sum": HydroState, "water_rates": HydroState},
    constants={"hydro": HydroGovernor},
    sees={"machine": MACHINES, "lane": LANE},
    states={"water": "water_rates"},
)


@system(HYDRO, "water", "gate_reference")
def start_hydro(gate_reference: float, hydro: HydroGovernor) -> tuple[HydroState, float]:
    """Return the equilibrium at the torque that its machine needs."""
    water = hydro_start(gate_reference, hydro)
    return water, water.hydro_gate


@system(HYDRO, "water_rates", "hydro_torque")
def rates_of_hydro(
    water: HydroState, state: MachineState, given: MachineInput, machine: Machine, hydro: HydroGovernor
) -> tuple[HydroState, float]:
    """Return the rates, and the torque of the machine."""
    rates, torque = hydro_rates(water, state.speed, given.gate_reference, given.inv_droop, hydro)
    return each(lambda rate: given.connected * rate, rates), machine.rating * torque


@system(HYDRO, "water", "water_base", "water_sum", "hydro_torque")
def stage_of_hydro(
    water: HydroState,
    water_base: HydroState,
    water_sum: HydroState,
    state: MachineState,
    given: MachineInput,
    machine: Machine,
    hydro: HydroGovernor,
    active: float,
    ahead: float,
    first: float,
    last: float,
) -> tuple[HydroState, HydroState, HydroState, float]:
    """Move the states by a stage; the machines come after, and find the torque."""
    rates, torque = hydro_rates(water, state.speed, given.gate_reference, given.inv_droop, hydro)
    moved = moved_by_stage(water, water_base, water_sum, rates, ahead=ahead, first=first, last=last)
    found = kept(moved, hydro_limited(moved.state, hydro), last=last, active=active * given.connected)
    return found.state, found.base, found.sum, machine.rating * torque
