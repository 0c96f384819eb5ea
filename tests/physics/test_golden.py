"""The classical model against a trace that another simulator converges to."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.cases import GOLDEN, golden_case
from wtg_gym.physics.layout import SyncRow
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.synchronous_machine import SyncState


@pytest.mark.parametrize(("simulation_dt", "speed", "power"), [(0.005, 1e-8, 1e-6), (0.02, 3e-6, 2e-4)])
def test_classical_machines_follow_the_golden_trace(simulation_dt: float, speed: float, power: float) -> None:
    events = (LoadStep(time_s=5.0, bus=2, power_mw=75.0), LoadStep(time_s=30.0, bus=3, power_mw=75.0))
    trace = np.genfromtxt(GOLDEN / "classical_m_a.csv", delimiter=",", names=True)
    simulator = Simulator(PlantSettings(case=golden_case("m"), groups=(), control_dt=1.0, simulation_dt=simulation_dt))
    simulator.start(0, Scenario(name="x", wind_speed=np.zeros((0, 1)), events=events), ())
    for row in trace:
        for i, machine in enumerate("12368"):
            at = i * SyncRow.N_ROWS
            assert simulator.values(at + SyncState.SPEED)[0] == pytest.approx(row[f"w{machine}"], abs=speed)
            # The trace's row at an event is the one before it, ours has already seen it strike.
            if row["t"] not in (5.0, 30.0):
                assert simulator.values(at + SyncRow.POWER)[0] == pytest.approx(row[f"Pe{machine}"], abs=power)
        if row["t"] < 60.0:
            simulator.advance()
