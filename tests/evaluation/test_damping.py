"""Eigenvalues of the grid with an entry in the loop."""

import numpy as np
import pytest

from docs.studies.small_signal import linearise
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import load_entries
from wtg_gym.evaluation.damping import SLOPES, WIND_M_S, Loop, damping

#: Continuous models know no secondary control, which acts at every simulation step.
PLANT = {"secondary_time_s": 0.0}


@pytest.mark.parametrize("law", ["deloaded-10", "coordinated-tuned"])
def test_a_law_alone_has_the_modes_of_the_linearised_plant(law):
    entry, plant = load_entries(law)[0], EnvSettings(suite="standard-v1", plant=PLANT).resolved_plant
    found, scenario, step_s = damping(entry, plant=PLANT), Loop(entry, WIND_M_S, PLANT).scenario, plant.simulation_dt
    assert found.rests and found.largest_action == 0.0 and found.largest_rate < 0.0
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
    assert found.rests and found.largest_action < 1e-3
    assert found.modes[0].damping_ratio < alone.modes[0].damping_ratio - 0.02
