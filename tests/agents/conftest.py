"""What every test of the training shares."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _one_thread(one_thread: None) -> None:
    """Networks as small as these only wait for more threads; training sets one."""
