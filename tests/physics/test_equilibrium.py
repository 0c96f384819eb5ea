"""Every run starts in an exact equilibrium."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.physics.extended import classical
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import WtgGroup, default_groups
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.scenarios import SUITES, Suite

LIMIT = 1e-8


def rates_without_energies(simulator: Simulator) -> float:
    """Largest |dx/dt|; the two energies, which grow in every equilibrium, do not count."""
    keep = [i for i, name in enumerate(simulator.layout.state_names) if "energy" not in name]
    return float(np.abs(simulator.rates()[keep]).max())


@pytest.mark.parametrize("law", STRATEGIES.values(), ids=lambda law: law.name)
def test_no_state_moves_at_the_start_at_any_wind(simulator: Simulator, law: TrackingLaw) -> None:
    for wind in np.linspace(6.0, 13.0, 20):
        simulator.start(0, Scenario(name="x", wind_speed=np.array([[wind], [19.0 - wind]])), (law, law))
        assert rates_without_energies(simulator) <= LIMIT, f"{wind:g} m/s"


@pytest.mark.parametrize("suite", SUITES.values(), ids=lambda suite: suite.name)
@pytest.mark.parametrize("split", ["validation", "test"])
def test_no_state_moves_at_the_start_of_the_suites(simulator: Simulator, suite: Suite, split: str) -> None:
    if suite.benchmark.version != "v0":
        plant = suite.plant.settings(classical=False, control_dt=0.1, simulation_dt=0.025)
        simulator = Simulator(plant, duration_s=suite.duration_s)
    laws = (STRATEGIES["coordinated-piecewise"],) * len(suite.plant.groups)
    for seed in list(suite.seeds(split))[:50]:
        simulator.start(0, suite.scenario(seed), laws)
        assert rates_without_energies(simulator) <= LIMIT, f"seed {seed}"


@pytest.mark.parametrize("wind", [12.0, 15.0, 20.0, 24.0])
def test_above_rated_the_pitch_holds_the_captured_power_at_its_limit(simulator: Simulator, wind: float) -> None:
    law = STRATEGIES["coordinated-piecewise"]
    simulator.start(0, Scenario(name="x", wind_speed=np.full((2, 1), wind)), (law, law))
    assert rates_without_energies(simulator) <= LIMIT
    assert simulator.wtg_values("captured")[0] == pytest.approx([1.05, 1.05], abs=1e-9)
    assert (simulator.wtg_values("pitch")[0] > 0.0).all()


@pytest.mark.parametrize("wind", [3.0, 8.0, 11.4])
def test_below_rated_the_pitch_is_exactly_at_rest(simulator: Simulator, wind: float) -> None:
    law = STRATEGIES["coordinated-piecewise"]
    simulator.start(0, Scenario(name="x", wind_speed=np.full((2, 1), wind)), (law, law))
    assert (simulator.wtg_values("pitch")[0] == 0.0).all()


@pytest.mark.parametrize("model", ["genrou", "classical"])
@pytest.mark.parametrize("groups", [default_groups(1), (WtgGroup(bus=3), WtgGroup(bus=14, n_turbines=2.0))])
def test_other_groups_and_machine_models_start_at_rest(model: str, groups: tuple[WtgGroup, ...]) -> None:
    case = modified_ieee14(classical=model == "classical")
    simulator = Simulator(PlantSettings(case=case, groups=groups))
    wind = np.full((len(groups), 1), 9.0)
    simulator.start(0, Scenario(name="x", wind_speed=wind), (STRATEGIES["mppt"],) * len(groups))
    assert rates_without_energies(simulator) <= LIMIT


def test_resistance_and_shared_buses_start_at_rest() -> None:
    case = modified_ieee14()
    machines = [dataclasses.replace(machine, resistance=0.003) for machine in case.machines]
    # In the place of the last one: as many machines as usual, whose code is compiled already.
    case = dataclasses.replace(case, machines=(*machines[:-1], classical(bus=3, dispatch_mw=20.0)))
    assert len({machine.bus for machine in case.machines}) < len(case.machines)
    simulator = Simulator(PlantSettings(case=case))
    law = STRATEGIES["coordinated-linear"]
    simulator.start(0, Scenario(name="x", wind_speed=np.full((2, 1), 9.0)), (law, law))
    assert rates_without_energies(simulator) <= LIMIT
