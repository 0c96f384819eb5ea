"""What every test of the training shares."""

import pytest


@pytest.fixture(autouse=True)
def _small_runs(short_validations, one_thread):
    """Validations are short, and torch has one thread: networks as small as these only wait for more."""
