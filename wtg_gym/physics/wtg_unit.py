"""Groups of wind turbine generators as units: their parts, and the systems that move them."""

from __future__ import annotations

import math

from wtg_gym.physics.converter import ConverterState
from wtg_gym.physics.pitch import PitchState
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.units import (
    ISLANDS,
    LANE,
    UNITS,
    Back,
    Connection,
    Phasor,
    StartFailure,
    Terminal,
    noted,
    quotient,
)
from wtg_gym.physics.wind_turbine import (
    FOUND,
    Search,
    Turbine,
    WtgExtremes,
    WtgInput,
    WtgOutput,
    WtgState,
    captured_by_curve,
    captured_by_table,
    search_begun,
    searched,
    wind_at,
    wtg_limited,
    wtg_rates,
    wtg_voltage,
)
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.elementary import select
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import Kind, system

GROUPS = Kind(
    name="WTG groups",
    rows={"state": WtgState, "given": WtgInput, "output": WtgOutput, "extremes": WtgExtremes},
    scratch={
        "captured": float,  # power from the wind, connected or not [p.u.]
        "search": Search,  # for the equilibrium
    },
    # The share is the rating on the base of the system.
    constants={"turbine": Turbine, "cells": ex.Cells, "share": float, "inv_share": float},
    sees={"unit": UNITS, "island": ISLANDS, "lane": LANE},
    states=("state",),
)


@system(GROUPS, "search", "rotor_speed", "pitch")
def start_search(given: WtgInput, curtailment: float, turbine: Turbine) -> tuple[Search, float, float]:
    """Begin to look for the equilibrium of the turbine, which tries one state after the other."""
    return search_begun(given.wind_start, curtailment * given.law.k_nominal, turbine)


@system(LANE, "searching")
def reset_search_count() -> float:
    """Begin to count groups whose equilibrium is not found yet."""
    return 0.0


@system(GROUPS, "search", "rotor_speed", "pitch", "searching")
def advance_search(
    search: Search,
    rotor_speed: float,
    pitch: float,
    own_captured: float,
    k_nominal: float,
    curtailment: float,
    turbine: Turbine,
    searching: float,
) -> tuple[Search, float, float, float]:
    """Judge the state that was tried by the power that it captures, and choose the next."""
    search, rotor_speed, pitch = searched(search, rotor_speed, pitch, own_captured, curtailment * k_nominal, turbine)
    return search, rotor_speed, pitch, searching + select(search.phase < FOUND, 1.0, 0.0)


@system(GROUPS, "planned_power", "start_failure", "failing_unit")
def plan_group(
    search: Search,
    rotor_speed: float,
    k_nominal: float,
    curtailment: float,
    share: float,
    connection: Connection,
    start_failure: float,
    failing_unit: float,
) -> tuple[float, float, float]:
    """Return what a group feeds in before any policy has acted, and note one without an equilibrium."""
    power = share * (curtailment * k_nominal) * (rotor_speed * (rotor_speed * rotor_speed))
    fits = search.phase == FOUND
    return power, *noted(fits, StartFailure.NO_TURBINE_EQUILIBRIUM, connection.number, start_failure, failing_unit)


@system(GROUPS, "state", "emf", "connected", "extremes")
def start_group(
    start: Terminal, connection: Connection, rotor_speed: float, pitch: float, frame: float
) -> tuple[WtgState, float, float, WtgExtremes]:
    """Return the state of a group in the equilibrium that the search has found, and its internal voltage."""
    drop = quotient(start.current, connection.y)
    emf = Phasor(start.voltage.re + drop.re, start.voltage.im + drop.im)
    converter = ConverterState(angle=math.atan2(emf.im, emf.re) - frame, speed=1.0, filter=0.0)
    state = WtgState(converter, rotor_speed, PitchState(pitch, pitch), energy_captured=0.0, energy_delivered=0.0)
    return state, math.hypot(emf.re, emf.im), 1.0, WtgExtremes(-math.inf, math.inf, -math.inf, 0.0)


@system(GROUPS, "k_min", "k_nominal", "k_max", when="no machine")
def curtail_law(k_min: float, k_nominal: float, k_max: float, curtailment: float) -> tuple[float, float, float]:
    """Return the law with which a group takes its part of the balance."""
    return curtailment * k_min, curtailment * k_nominal, curtailment * k_max


@system(GROUPS, "state", "emf", "shift", "connected", when="extended")
def return_group(
    state: WtgState,
    emf: float,
    shift: float,
    inv_tau: float,
    connected: float,
    returns: float,
    back: Back,
    turbine: Turbine,
) -> tuple[WtgState, float, float, float]:
    """Synchronise a group that comes back; rotor and blades are as they stood."""
    comes = returns > 0.5
    deviation = select(inv_tau > 0.0, back.bus_speed - turbine.converter.corners.frequency_setpoint, 0.0)
    found = ConverterState(back.bus_angle, back.bus_speed, deviation)
    converter = each(lambda new, old: select(comes, new, old), found, state.converter)
    return (
        state._replace(converter=converter),
        select(comes, back.bus_voltage, emf),
        select(comes, 0.0, shift),
        select(comes, 1.0, connected),
    )


@system(GROUPS, "overload_time")
def reset_overload_time() -> float:
    """Let overload count from the first step on."""
    return 0.0


@system(GROUPS, "voltage", when="constant voltage")
def voltage_of_group(state: WtgState, given: WtgInput) -> Phasor:
    """Return the voltage behind the reactance."""
    return Phasor(*wtg_voltage(state, given.emf))


@system(GROUPS, "own_captured", when="curve")
def capture_by_curve(state: WtgState, given: WtgInput, turbine: Turbine, fraction: float) -> float:
    """Return the power from the wind."""
    return captured_by_curve(state.rotor_speed, wind_at(given, fraction), state.pitch.pitch, turbine.rotor)


@system(GROUPS, "own_captured", when="table")
def capture_by_table(state: WtgState, given: WtgInput, turbine: Turbine, cells: ex.Cells, fraction: float) -> float:
    """Return the power from the wind."""
    return captured_by_table(state.rotor_speed, wind_at(given, fraction), state.pitch.pitch, turbine.rotor, cells)


def power_of(voltage: Phasor, current: Phasor, inv_share: float) -> float:
    """Return the power that a group feeds in [p.u. of the group]."""
    return inv_share * (voltage.re * current.re + voltage.im * current.im)


@system(GROUPS, "state_rates", "output", when="constant voltage")
def rates_of_group(
    state: WtgState,
    voltage: Phasor,
    current: Phasor,
    given: WtgInput,
    own_captured: float,
    turbine: Turbine,
    inv_share: float,
    reference_speed: float,
    omega_n: float,
    fraction: float,
) -> tuple[WtgState, WtgOutput]:
    """Return rates and outputs of a group that is not extended."""
    power = power_of(voltage, current, inv_share)
    return wtg_rates(state, power, own_captured, wind_at(given, fraction), given, turbine, reference_speed, omega_n)


stage_of_group = moving(rates_of_group, wtg_limited, constants=["turbine"])
