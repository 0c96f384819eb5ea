"""What every test of the training shares."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _small_runs(short_validations: None, one_thread: None) -> None:
    """Validations are short, and torch has one thread: networks as small as these only wait for more."""
