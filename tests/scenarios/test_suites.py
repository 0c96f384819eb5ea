"""Facts about the frozen suites."""

import dataclasses
import pickle

import pytest

from wtg_gym.scenarios import FROZEN_HASHES, SUITES, Suite, get_suite
from wtg_gym.scenarios.benchmark import V1
from wtg_gym.scenarios.sensor_distribution import SensorDistribution

FIRST = [name for name, suite in SUITES.items() if suite.benchmark.version == "v0"]
SECOND = [suite for suite in SUITES.values() if suite.benchmark.version == "v1"]


def test_suites_are_those_of_the_benchmark():
    assert FIRST == ["paper", "standard", "low-wind", "gust", "weak-grid"]
    kinds = ["standard", "low-share", "high-share", "gusty", "no-wind-sensor", "faults", "paper"]
    assert [suite.name for suite in SECOND] == [f"{kind}-v1" for kind in kinds]
    assert all(get_suite(name).name == name for name in SUITES)


@pytest.mark.parametrize("name", FROZEN_HASHES)
def test_hash_is_the_frozen_one(name: str):
    assert get_suite(name).hash == FROZEN_HASHES[name], "a changed suite is a new version of the benchmark"


STANDARD, STANDARD_V1 = (
    dataclasses.replace(get_suite(name), validation=range(10_000, 10_002), test=range(20_000, 20_002))
    for name in ("standard", "standard-v1")
)


@pytest.mark.parametrize(
    ("suite", "change"),
    [
        (STANDARD, {"distribution": dataclasses.replace(STANDARD.distribution, load_noise_mw=1.01)}),
        (STANDARD, {"test": range(9, 99)}),
        (STANDARD_V1, {"plant": dataclasses.replace(STANDARD_V1.plant, generator_mva=251.0)}),
        (STANDARD_V1, {"sensors": SensorDistribution(delay_s=(0.1, 0.2))}),
        (STANDARD_V1, {"sensors": None}),
        (STANDARD_V1, {"benchmark": dataclasses.replace(V1, weights=(("rotor", 21.0),))}),
        (STANDARD_V1, {"benchmark": dataclasses.replace(V1, duty_time_s=20.0)}),
    ],
    ids=str,
)
def test_hash_sees_scenarios_plant_sensors_and_task_but_not_words_and_copies(suite: Suite, change: dict):
    assert dataclasses.replace(suite, **change).hash != suite.hash
    assert dataclasses.replace(suite, description="other words").hash == suite.hash
    assert pickle.loads(pickle.dumps(suite)).hash == suite.hash
