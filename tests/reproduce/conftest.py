"""The data of the figures, made once."""

from __future__ import annotations

import pytest

from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.scenarios import get_suite


@pytest.fixture(scope="session")
def load_increase() -> tuple[Scenario, dict[str, Trajectory]]:
    """The paper's load increase under every strategy."""
    scenario = get_suite("paper").scenario(0)
    return scenario, {name: simulate(scenario, law) for name, law in STRATEGIES.items()}
