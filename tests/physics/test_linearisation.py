"""Which integration steps a plant takes, and that others are refused before anything runs."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.linearisation import STEP_MARGIN, largest_stable_steps, moving_states, state_matrix
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import TrackingLaw, get_law
from wtg_gym.scenarios import get_suite

LAWS = (get_law("coordinated-piecewise"),) * 2


def plant(simulation_dt: float = 0.025, **first_machine: float) -> PlantSettings:
    """Return the default plant with other data of the machine at bus 1."""
    case = modified_ieee14()
    machines = (dataclasses.replace(case.machines[0], **first_machine), *case.machines[1:])
    return PlantSettings(case=dataclasses.replace(case, machines=machines), simulation_dt=simulation_dt)


def largest_step(simulator: Simulator) -> float:
    """Return the largest stable step of a simulator's first lane where it stands [s]."""
    rows, layout = simulator.blocks[0], simulator.layout
    matrix = state_matrix(rows, simulator.plant, layout, -1.0)
    keep = moving_states(matrix, rows, layout)
    return float(largest_stable_steps(np.linalg.eigvals(matrix[np.ix_(keep, keep)])).min())


def after_steps(matrix: Floats, h: float, n_steps: int) -> float:
    """Return |x| of ẋ = A x after Runge-Kutta steps from an arbitrary start."""
    x = np.ones(matrix.shape[0])
    for _ in range(n_steps):
        k1 = matrix @ x
        k2 = matrix @ (x + 0.5 * h * k1)
        k3 = matrix @ (x + 0.5 * h * k2)
        k4 = matrix @ (x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return float(np.abs(x).max())


def test_stable_steps_end_where_the_stability_region_does() -> None:
    found = largest_stable_steps([-1.0, -200.0, 1j, -2j])
    assert found == pytest.approx([2.785293563405282, 2.785293563405282 / 200.0, 8.0**0.5, 2.0**0.5], rel=1e-6)


def test_a_mode_that_grows_by_itself_is_not_the_integrations_fault() -> None:
    assert largest_stable_steps([0.0, 0.3, 1.0 + 2.0j, 3.8 + 3.5j]).min() > 0.4


@pytest.mark.parametrize("value", [-40.0 + 0j, -8.9 + 46j, -0.2 + 17j])
def test_a_linear_system_grows_just_beyond_its_largest_step_and_not_just_below(value: complex) -> None:
    matrix = np.array([[value.real, value.imag], [-value.imag, value.real]])
    limit = float(largest_stable_steps(np.linalg.eigvals(matrix)).min())
    assert after_steps(matrix, 0.999 * limit, 20_000) < 1e-6
    assert after_steps(matrix, 1.001 * limit, 20_000) > 1e6


def test_a_subtransient_time_constant_that_the_step_cannot_follow_is_refused_when_the_plant_is_built() -> None:
    message = r"simulation_dt = 0.025 s .* eigenvalue -105.* 1/s \(mainly sync0.psi_1d\) .* at most 0.024 s"
    with pytest.raises(ValueError, match=message):
        Simulator(plant(t_d0_subtransient_s=0.01))
    Simulator(plant(t_d0_subtransient_s=0.01, simulation_dt=0.02))


def test_an_inertia_that_is_too_small_for_the_step_is_refused_with_its_scenario() -> None:
    simulator = Simulator(plant(two_h_s=0.5))
    scenario = Scenario(name="light", wind_speed=np.full((2, 1), 8.0), inertia_scale=0.3)
    simulator.prepare([scenario], LAWS)
    lighter = dataclasses.replace(scenario, inertia_scale=0.05)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"scenario 'light', inertia_scale = 0.05: simulation_dt = 0.025 s"):
            simulator.prepare([scenario, lighter], LAWS)
    simulator.prepare([scenario], LAWS)


@pytest.mark.parametrize(
    ("inertia_s", "k_min", "k_nominal", "k_max", "wind_m_s"),
    [
        # The slope below ω_st is what is fast, but only once the wind has risen: it acts on the cube of the speed.
        (2.0, 3.0, 0.6, 0.55, 5.0),
        # The steeper slope takes power away while the frequency falls; the other one is what is fast.
        (0.7, 0.05, 0.9, 0.2, 16.0),
    ],
)
def test_a_law_that_is_too_steep_for_the_step_is_refused(
    inertia_s: float, k_min: float, k_nominal: float, k_max: float, wind_m_s: float
) -> None:
    law = TrackingLaw(name="steep", k_min=k_min, k_nominal=k_nominal, k_max=k_max)
    scenario = Scenario(name="x", wind_speed=np.full((2, 1), wind_m_s))
    light = PlantSettings(control=GridFormingParameters(inertia_constant_s=inertia_s))
    with pytest.raises(ValueError, match=r"\(mainly wtg[01].speed\) would grow without bound"):
        Simulator(light).prepare([scenario], (law,) * 2)
    Simulator(dataclasses.replace(light, simulation_dt=0.01)).prepare([scenario], (law,) * 2)


@pytest.mark.parametrize("settings", [{}, {"simulation_dt": 0.04, "control_dt": 0.2}, {"groups": ()}])
def test_every_step_and_inertia_that_is_allowed_suits_the_default_plant(settings: dict[str, Any]) -> None:
    chosen = PlantSettings(**settings)
    n = len(chosen.groups)
    scenario = Scenario(name="x", wind_speed=np.full((n, 1), 8.0), inertia_scale=0.05)
    Simulator(chosen).prepare([scenario], LAWS[:n])


@pytest.mark.parametrize("suite", ["standard", "weak-grid", "low-wind", "gust"])
def test_operating_points_of_the_suites_move_the_largest_step_by_less_than_the_margin(suite: str) -> None:
    nominal = Simulator(PlantSettings())
    nominal.start(0, Scenario(name="x", wind_speed=np.full((2, 1), 8.0)), LAWS)
    steps = []
    for seed in get_suite(suite).validation[:4]:
        simulator = Simulator(PlantSettings())
        simulator.start(0, dataclasses.replace(get_suite(suite).scenario(seed), inertia_scale=1.0), LAWS)
        for _ in range(6):
            steps.append(largest_step(simulator))
            for _ in range(100):
                simulator.advance()
    assert largest_step(nominal) / min(steps) < 1.0 + 0.5 * (STEP_MARGIN - 1.0)
