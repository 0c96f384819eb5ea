"""Every scenario of version v1 can start, with room for the governor, under the laws of the benchmark."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.scenarios import SUITES

#: None of the 3,200 first scenarios of each suite is refused; so many are looked at in each run of the tests.
N_TRAIN = 300
LAWS = ("mppt", "deloaded-5", "deloaded-10", "coordinated-piecewise")


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", [name for name, suite in SUITES.items() if suite.benchmark.version == "v1"])
def test_scenarios_start_at_nominal_frequency_with_turning_rotors_and_a_gate_between_its_limits(
    name: str, law: str
) -> None:
    suite = SUITES[name]
    seeds = [*suite.validation, *suite.train[:N_TRAIN]]
    lanes = TaskLanes(EnvSettings(suite=name, strategy=law), len(seeds), 1)
    for first in range(0, len(seeds), 8):
        index = range(first, min(first + 8, len(seeds)))
        scenarios = lanes.scenarios([seeds[place] for place in index])
        # It refuses rotors below the under-speed trip as well.
        lanes.commit(index, [lanes.prepare_given(scenarios)])
    simulator = lanes.simulator
    gates = simulator.machine_values("gate")[:, 0]
    # The mean winds give a share of the load; the wind of the first moment may be another one.
    assert ((gates >= 0.1) & (gates <= 0.9)).mean() >= 0.99, f"{gates.min():.3f} … {gates.max():.3f}"
    assert gates.min() >= 0.05 and gates.max() <= 0.95, f"{gates.min():.3f} … {gates.max():.3f}"
    assert np.abs(simulator.lane_values("coi") - 1.0).max() < 1e-9
    power = simulator.wtg_values("power")
    assert power.max() <= simulator.settings.pitch.captured_power_limit_pu + 1e-6, (
        "no group starts beyond what the pitch allows"
    )
