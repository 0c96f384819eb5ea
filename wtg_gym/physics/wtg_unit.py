"""Groups of wind turbine generators as units: their parts, and the systems that move them."""

from __future__ import annotations

from wtg_gym.physics.rotor_table import Cells
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.units import LANE, UNITS, Phasor
from wtg_gym.physics.wind_turbine import (
    Turbine,
    WtgExtremes,
    WtgInput,
    WtgOutput,
    WtgState,
    captured_by_curve,
    captured_by_table,
    wind_at,
    wtg_limited,
    wtg_rates,
    wtg_voltage,
)
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.systems import Kind, system

GROUPS = Kind(
    name="WTG groups",
    rows={"state": WtgState, "given": WtgInput, "output": WtgOutput, "extremes": WtgExtremes},
    scratch={"captured": float},  # power from the wind, connected or not [p.u.]
    # The share is the rating on the base of the system.
    constants={"turbine": Turbine, "cells": ex.Cells, "share": float, "inv_share": float},
    sees={"unit": UNITS, "lane": LANE},
    states=("state",),
)


@system(GROUPS, "voltage", when="constant voltage")
def voltage_of_group(state: WtgState, given: WtgInput) -> Phasor:
    """Return the voltage behind the reactance."""
    return Phasor(*wtg_voltage(state, given.emf))


@system(GROUPS, "captured", when="curve")
def capture_by_curve(state: WtgState, given: WtgInput, turbine: Turbine, fraction: float) -> float:
    """Return the power from the wind."""
    return captured_by_curve(state.rotor_speed, wind_at(given, fraction), state.pitch.pitch, turbine.rotor)


@system(GROUPS, "captured", when="table")
def capture_by_table(state: WtgState, given: WtgInput, turbine: Turbine, cells: Cells, fraction: float) -> float:
    """Return the power from the wind."""
    return captured_by_table(state.rotor_speed, wind_at(given, fraction), state.pitch.pitch, turbine.rotor, cells)


def group_motion(
    state: WtgState,
    voltage: Phasor,
    current: Phasor,
    given: WtgInput,
    captured: float,
    turbine: Turbine,
    inv_share: float,
    reference_speed: float,
    omega_n: float,
    fraction: float,
) -> tuple[WtgState, WtgOutput]:
    """Return rates and outputs of a group that is not extended."""
    power = inv_share * (voltage.re * current.re + voltage.im * current.im)
    return wtg_rates(state, power, captured, wind_at(given, fraction), given, turbine, reference_speed, omega_n)


rates_of_group = system(GROUPS, "state_rates", "output", when="constant voltage")(group_motion)
stage_of_group = moving(rates_of_group, wtg_limited, constants=["turbine"])
