"""The data of the figures, made once, and the browser for the pages."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from typing import Any

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


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium; tests are skipped where there is none, or no playwright to drive it."""
    playwright = pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright")
    with playwright.sync_playwright() as driver:
        names = ("chromium", "chromium-browser", "google-chrome")
        found = next(filter(None, map(shutil.which, names)), None) or driver.chromium.executable_path
        if not os.path.exists(found):
            pytest.skip("there is no Chromium to look at the page with")
        started = driver.chromium.launch(executable_path=found)
        yield started
        started.close()
