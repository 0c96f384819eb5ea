"""The tests that operators ask of grid-forming plants, and eigenvalues of the grid with an entry in the loop."""

import dataclasses

import numpy as np
import pytest

from docs.studies.small_signal import linearise
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import load_entries
from wtg_gym.evaluation.damping import SLOPES, Loop, damping
from wtg_gym.evaluation.grid_tests import GRID_TESTS, SOURCES, Recording, _longest_beyond, run_grid_test
from wtg_gym.physics.protection import Status

#: Continuous models know no secondary control, which acts at every simulation step.
PLANT = {"secondary_time_s": 0.0}


def played(name: str, law: str) -> tuple[Recording, bool]:
    found, (passed, _) = run_grid_test(GRID_TESTS[name], load_entries(law)[0])
    return found, passed


def test_every_test_says_where_it_comes_from():
    for test in GRID_TESTS.values():
        assert set(test.source.split(", ")) <= set(SOURCES)


def test_a_law_that_sheds_power_survives_a_surplus_and_one_that_cannot_does_not():
    found, passed = played("island-surplus", "mppt")
    assert passed and found.status is Status.RUNNING and found.shed_mws == 0.0
    found, passed = played("island-surplus", "coordinated-piecewise")
    assert not passed and found.status is Status.FREQUENCY_LIMIT and found.frequency_hz[-1] > 51.4


def test_a_source_drags_the_groups_to_its_frequency_and_back():
    found, passed = played("rocof-up", "coordinated-tuned")
    assert passed
    # The ramp ends at 2.25 s, its way back begins at 7.25 s; in between the groups swing about its frequency.
    assert found.frequency_hz[found.at(4.0) : found.at(7.2) + 1].mean() == pytest.approx(51.0, abs=0.01)
    assert found.frequency_hz[-1] == pytest.approx(50.0, abs=0.01)


@pytest.mark.parametrize(
    ("name", "power"), [("angle-step", 0.181), ("angle-step-30", 0.511), ("angle-step-forward", -0.54)]
)
def test_an_angle_step_is_measured_one_simulation_step_after_it(name, power):
    found, _ = played(name, "coordinated-piecewise")
    total, before = found.total(), found.at(2.0)
    assert found.time_s[before + 1] == pytest.approx(2.025)
    assert total[before + 1] - total[before] == pytest.approx(power, abs=0.005)


def test_the_last_machine_is_lost_in_balance_and_with_more_load_than_the_groups_can_carry():
    balanced, passed = played("last-machine-balance", "coordinated-piecewise")
    assert passed and np.ptp(balanced.frequency_hz) < 0.2 and balanced.shed_mws == 0.0
    loaded, passed = played("last-machine-limit", "coordinated-piecewise")
    assert passed and loaded.shed_mws > 0.0 and loaded.total()[0] == pytest.approx(0.9975, abs=1e-3)


def test_the_current_limit_is_reached_held_and_left_and_a_voltage_above_the_curve_fails_at_any_bus():
    found, passed = played("current-limit", "coordinated-tuned")
    assert passed and 1.2 < found.voltage_pu.max() < 1.25
    assert found.current_pu.max() == pytest.approx(1.2, abs=1e-6)
    assert found.limited.any() and not found.limited[found.at(3.0) :].any()
    voltage = found.voltage_pu.copy()
    voltage[found.at(5.0) : found.at(8.0), 0] = 1.21
    above = dataclasses.replace(found, voltage_pu=voltage)
    assert GRID_TESTS["current-limit"].verdict(above) == (False, "above 1.2 p.u. for 3.0 s")


def test_the_time_beyond_a_limit_is_that_of_the_longest_stretch():
    beyond = np.array([[0, 1, 1, 1, 0, 1, 1, 0], [0, 0, 0, 0, 0, 0, 0, 1]], dtype=bool).T
    assert _longest_beyond(0.1 * np.arange(8.0), beyond) == pytest.approx(0.3)


@pytest.mark.parametrize("law", ["deloaded-10", "coordinated-tuned"])
def test_a_law_alone_has_the_modes_of_the_linearised_plant(law):
    entry, plant = load_entries(law)[0], EnvSettings(suite="standard-v1", plant=PLANT).resolved_plant
    found, scenario, step_s = damping(entry, plant=PLANT), Loop(entry, PLANT).scenario, plant.simulation_dt
    assert found.rest.is_reached and found.rest.largest_action == 0.0 and found.largest_rate < 0.0
    for slope, side in zip(SLOPES, ("under", "over"), strict=True):
        if not (seen := np.array([mode.eigenvalue for mode in found.modes if mode.slope in (slope, "both")])).size:
            continue
        linear = np.linalg.eigvals(linearise(scenario, entry.law, plant, side=side)[0])
        steps = step_s * np.array([value for value in linear if value.imag > 0.0 and value.real > -9.0])
        # What a step of the classical Runge-Kutta method makes of a mode.
        simulated = np.log(1.0 + steps + steps**2 / 2.0 + steps**3 / 6.0 + steps**4 / 24.0) / step_s
        assert len(simulated) >= 10
        assert np.abs(seen[:, np.newaxis] - simulated).min(axis=0).max() < 1e-6
        # Beyond the integrator's own error they are those of the plant.
        assert np.abs(seen[:, np.newaxis] - steps / step_s).min(axis=0).max() < 1e-3


def test_a_policy_moves_the_modes_of_its_law():
    policy = load_entries("fast-droop")[0]
    found, alone = damping(policy), damping(load_entries(policy.law.name)[0])
    assert found.rest.is_reached and found.rest.largest_action < 1e-3
    assert found.modes[0].damping_ratio < alone.modes[0].damping_ratio - 0.02
