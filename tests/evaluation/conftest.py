"""Short evaluations that many tests look at, one of each version of the benchmark."""

import pytest

from wtg_gym.evaluation import Entry, evaluate


@pytest.fixture(scope="session")
def entries():
    return [Entry(name=name, strategy=name) for name in ("mppt", "deloaded-10", "coordinated-piecewise")]


@pytest.fixture(scope="session")
def results(entries):
    return evaluate(entries, "standard", "test", seeds=(20_002, 20_000, 20_005), duration_s=10.0)


@pytest.fixture(scope="session")
def results_v1():
    return evaluate("baselines", "standard-v1", "validation", seeds=range(10_000, 10_012), duration_s=60.0)
