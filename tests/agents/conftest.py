"""What every test of the training shares."""

import functools

import pytest

from wtg_gym import evaluate


@pytest.fixture(autouse=True)
def _small_runs(one_thread, few_scenarios, monkeypatch):
    """Validations last six seconds, checks and futures are few, torch has one thread: small networks only wait."""
    monkeypatch.setattr("agents.planner._N_OTHERS", 30)
    monkeypatch.setattr("agents.run.evaluate", functools.partial(evaluate, duration_s=6.0))
