"""Facts about the frozen suites."""

import dataclasses
import pickle
from itertools import pairwise

import pytest

from wtg_gym.physics.scenario import LoadStep, LoadTrip
from wtg_gym.scenarios import FROZEN_HASHES, SPLITS, SUITES, Suite, get_suite
from wtg_gym.scenarios.benchmark import V1
from wtg_gym.scenarios.sensor_distribution import SensorDistribution

DRAWN = [suite for suite in SUITES.values() if suite.distribution is not None]
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


@pytest.mark.parametrize("suite", DRAWN, ids=lambda suite: suite.name)
def test_splits_are_disjoint_and_of_the_announced_size(suite: Suite):
    sizes = (100, 200) if suite.benchmark.version == "v0" else (200, 1000)
    assert (len(suite.seeds("validation")), len(suite.seeds("test"))) == sizes
    spans = sorted((suite.seeds(split) for split in SPLITS), key=lambda seeds: seeds.start)
    assert all(low.stop <= high.start for low, high in pairwise(spans))


def test_without_a_wind_sensor_the_scenarios_are_those_of_the_standard_suite():
    own, other = (get_suite(name).scenario(10_007) for name in ("standard-v1", "no-wind-sensor-v1"))
    assert dataclasses.replace(own.sensors, wind_sensor=False) == other.sensors
    assert (own.wind_speed == other.wind_speed).all() and own.events == other.events


def test_paper_has_its_two_cases_in_every_split():
    paper = get_suite("paper")
    assert all(paper.seeds(split) == range(2) for split in SPLITS)
    increase, decrease = paper.scenario(0), paper.scenario(1)
    assert increase.events == (
        LoadStep(time_s=5.0, bus=2, power_mw=75.0),
        LoadStep(time_s=30.0, bus=3, power_mw=75.0),
    )
    assert decrease.events == (LoadTrip(time_s=5.0, bus=4), LoadTrip(time_s=30.0, bus=9))
    for scenario in (increase, decrease):
        assert scenario.wind_speed.tolist() == [[11.4], [8.0]]
        assert scenario.duration_s == 120.0
        assert scenario.load_noise_mw.size == 0
        assert (scenario.governor_droop, scenario.inertia_scale, scenario.load_level) == (None, 1.0, 1.0)
