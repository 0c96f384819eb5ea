"""Plants that add physics to the paper's: they differ from it in that alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import ConverterLimitParameters, TurbineParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import group_laws
from wtg_gym.scenarios import get_suite

FAR = ConverterLimitParameters(
    current_max_pu=10.0, power_max_pu=10.0, power_min_pu=-10.0, power_gain=0.0, power_integral_gain=0.0
)
UNLIMITED = PlantSettings(limits=FAR)


def play(plant: PlantSettings, suite: str, seed: int, strategy: str) -> tuple[Simulator, Floats]:
    """Run a scenario; return the simulator at its end, and every group's rotor speed and power at every step."""
    scenario = get_suite(suite).scenario(seed)
    simulator = Simulator(plant, duration_s=scenario.duration_s)
    simulator.start(0, scenario, group_laws(strategy, len(plant.groups)))
    rows = []
    for _ in range(simulator.n_intervals):
        rows.append(np.concatenate([simulator.wtg_values(name)[0] for name in ("rotor_speed", "power", "emf")]))
        simulator.advance()
    return simulator, np.array(rows)


@pytest.mark.parametrize(
    ("suite", "seed", "strategy", "status"),
    [("paper", 0, "mppt", Status.STALL), ("gust", 10_003, "coordinated-piecewise", Status.RUNNING)],
)
def test_limits_out_of_reach_leave_the_papers_plant_as_it_is(
    suite: str, seed: int, strategy: str, status: Status
) -> None:
    (paper, expected), (unlimited, found) = (
        play(plant, suite, seed, strategy) for plant in (PlantSettings(), UNLIMITED)
    )
    assert paper.lane_values("status")[0] == unlimited.lane_values("status")[0] == status
    assert paper.lane_values("step")[0] == unlimited.lane_values("step")[0]
    assert np.abs(found - expected).max() < 1e-9
    assert unlimited.lane_values("coi_min")[0] == pytest.approx(paper.lane_values("coi_min")[0], abs=1e-11)


@pytest.mark.parametrize("conserves", [True, False])
def test_each_rotor_releases_the_energy_of_its_equation(conserves: bool) -> None:
    turbine = TurbineParameters(conserves_energy=conserves)
    simulator, rows = play(dataclasses.replace(UNLIMITED, turbine=turbine), "standard", 10_001, "mppt")
    before, after = rows[0, :2], simulator.wtg_values("rotor_speed")[0]
    released = (simulator.wtg_values("energy_delivered") - simulator.wtg_values("energy_captured"))[0]
    real, papers = before**2 - after**2, 2.0 * (before - after)
    assert released == pytest.approx(turbine.inertia_constant_s * (real if conserves else papers), abs=1e-6)
    assert np.abs(real - papers).max() > 1e-3
