"""Shared fixtures of the physics tests."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator


@pytest.fixture(scope="session")
def simulator() -> Simulator:
    """The paper's plant, one lane, two minutes at most."""
    return Simulator(PlantSettings(), duration_s=120.0)


@pytest.fixture
def calm() -> Scenario:
    """Constant wind as in the paper, nothing happens."""
    return Scenario(name="calm", wind_speed=np.array([[11.4], [8.0]]), duration_s=60.0)
