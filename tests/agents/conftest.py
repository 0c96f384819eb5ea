"""What every test of the training shares."""

import functools

import pytest

from wtg_gym import evaluate


@pytest.fixture(autouse=True)
def _small_runs(one_thread, monkeypatch):
    """Validations last six seconds, and torch has one thread: networks as small as these only wait for more."""
    monkeypatch.setattr("agents.run.evaluate", functools.partial(evaluate, duration_s=6.0))
