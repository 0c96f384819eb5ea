"""Short evaluations that many tests look at, one of each version of the benchmark."""

from __future__ import annotations

import pytest

from wtg_gym.evaluation import Entry, Results, evaluate

SEEDS = (20_002, 20_000, 20_005)
DURATION_S = 10.0


@pytest.fixture(scope="session")
def entries() -> list[Entry]:
    names = ("mppt", "deloaded-10", "coordinated-piecewise")
    return [Entry(name=name, strategy=name) for name in names]


@pytest.fixture(scope="session")
def results(entries: list[Entry]) -> Results:
    return evaluate(entries, "standard", "test", seeds=SEEDS, duration_s=DURATION_S)


@pytest.fixture(scope="session")
def results_v1() -> Results:
    return evaluate("baselines", "standard-v1", "validation", seeds=range(10_000, 10_012), duration_s=60.0)
