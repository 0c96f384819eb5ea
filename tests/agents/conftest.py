"""What every test of the training shares."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import pytest

from wtg_gym.evaluation import evaluate


@pytest.fixture(autouse=True)
def _one_thread(one_thread: None) -> None:
    """Networks as small as these only wait for more threads; training sets one."""


@pytest.fixture(autouse=True, scope="module")
def _short_validations() -> Iterator[None]:
    """Validations over six seconds instead of a minute, which most of a small run would go into."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agents.runs.evaluate", functools.partial(evaluate, duration_s=6.0))
        yield
