"""Power flow and linear algebra against published and independent results."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.physics.extended import classical
from wtg_gym.physics.equilibrium import FLOW_COLUMNS
from wtg_gym.physics.grid import Branch, NetworkCase, get_grid
from wtg_gym.physics.layout import n_rows_of
from wtg_gym.physics.network import branch_admittances, solve_power_flow
from wtg_gym.physics.plant import Plant, plant_tables
from wtg_gym.physics.units import BUSES

# Solution of the IEEE 14-bus test case: voltage [p.u.] and angle [deg] of buses 1 … 14, as printed in the archive.
VOLTAGES = (1.060, 1.045, 1.010, 1.019, 1.020, 1.070, 1.062, 1.090, 1.056, 1.051, 1.057, 1.055, 1.050, 1.036)
ANGLES = (0.0, -4.98, -12.72, -10.33, -8.78, -14.22, -13.37, -13.36, -14.94, -15.10, -14.79, -15.07, -15.16, -16.04)


def solve(case: NetworkCase, power: np.ndarray[Any, np.dtype[np.complex128]]) -> tuple[Any, Any, int]:
    plant = plant_tables(Plant(case=case, groups=()))
    buses, at = np.zeros((len(case.buses), n_rows_of(BUSES.scratch))), FLOW_COLUMNS
    buses[:, at.power] = power.real - plant.buses["load.re"]
    buses[:, at.power + 1] = power.imag - plant.buses["load.im"]
    buses[:, at.polar], buses[:, at.holds_voltage] = plant.buses["voltage"], plant.buses["holds_voltage"]
    iterations = solve_power_flow(plant.bus_y, case.bus_index(case.slack_bus), buses, at)
    return buses[:, at.polar], buses[:, at.polar + 1], iterations


def test_power_flow_meets_the_published_solution_of_the_ieee_14_bus_system():
    case = get_grid("ieee14").case
    original = dataclasses.replace(case, machines=(*case.machines, classical(bus=2, dispatch_mw=40.0)))
    power = np.zeros(14, dtype=np.complex128)
    power[1] = 0.4
    magnitude, angle, iterations = solve(original, power)
    assert 0 < iterations <= 6
    assert magnitude == pytest.approx(VOLTAGES, abs=1.5e-3)
    assert np.degrees(angle) == pytest.approx(ANGLES, abs=0.03)


def test_impossible_power_flow_is_reported():
    power = np.zeros(14, dtype=np.complex128)
    power[13] = -30.0
    assert solve(get_grid("ieee14").case, power)[2] == -1


def test_off_nominal_tap_and_phase_follow_the_pi_model():
    tap, phase, y = 0.9, 0.2, 1.0 / complex(0.01, 0.1)
    branch = Branch(from_bus=1, to_bus=2, resistance=0.01, reactance=0.1, charging=0.04, tap=tap, phase_rad=phase)
    ratio = tap * np.exp(1j * phase)
    expected = [(y + 0.02j) / tap**2, -y / np.conj(ratio), -y / ratio, y + 0.02j]
    assert branch_admittances((branch,))[0] == pytest.approx(np.array(expected))
