"""Shared fixtures of the physics tests."""

import pytest

from wtg_gym.physics.plant import Plant
from wtg_gym.physics.simulator import Simulator


@pytest.fixture(scope="session")
def simulator():
    return Simulator(Plant(), duration_s=120.0)
