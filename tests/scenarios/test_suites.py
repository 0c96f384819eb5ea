"""Facts about the frozen suites."""

import copy
import dataclasses
import pickle
from itertools import pairwise

import numpy as np
import pytest

from wtg_gym.physics.scenario import LoadStep, LoadTrip
from wtg_gym.scenarios import FROZEN_HASHES, SPLITS, SUITES, Suite, get_suite

DRAWN = [suite for suite in SUITES.values() if suite.distribution is not None]


def test_suites_are_the_five_of_the_benchmark():
    assert list(SUITES) == ["paper", "standard", "low-wind", "gust", "weak-grid"]
    assert all(get_suite(name).name == name for name in SUITES)


@pytest.mark.parametrize("name", SUITES)
def test_hash_is_the_frozen_one(name: str):
    assert get_suite(name).hash == FROZEN_HASHES[name], "a changed suite is a new version of the benchmark"


def test_every_frozen_hash_belongs_to_a_suite():
    assert set(FROZEN_HASHES) == set(SUITES)
    assert len(set(FROZEN_HASHES.values())) == len(SUITES)


@pytest.mark.parametrize(
    "change", [{"description": "other words"}, {"load_noise_mw": 1.01}, {"duration_s": 61.0}, {"test": range(9, 99)}]
)
def test_hash_sees_settings_and_seeds_but_not_words(change: dict):
    suite = get_suite("standard")
    if "load_noise_mw" in change:
        change = {"distribution": dataclasses.replace(suite.distribution, **change)}
    other = dataclasses.replace(suite, **change)
    assert (other.hash == suite.hash) == ("description" in change)


@pytest.mark.parametrize("suite", DRAWN, ids=lambda suite: suite.name)
def test_splits_are_disjoint_and_of_the_announced_size(suite: Suite):
    assert (len(suite.seeds("validation")), len(suite.seeds("test"))) == (100, 200)
    spans = sorted((suite.seeds(split) for split in SPLITS), key=lambda seeds: seeds.start)
    assert all(low.stop <= high.start for low, high in pairwise(spans))


def test_overlapping_splits_are_refused():
    with pytest.raises(ValueError, match="overlap"):
        dataclasses.replace(get_suite("standard"), validation=range(20_100, 20_300))


def test_suite_needs_a_distribution_or_cases():
    with pytest.raises(ValueError, match="either a distribution or cases"):
        Suite(name="empty", description="", duration_s=60.0)


def test_suites_share_no_random_stream():
    winds = [suite.scenario(20_000).wind_speed[0] for suite in DRAWN]
    for i, first in enumerate(winds):
        for second in winds[:i]:
            assert abs(np.corrcoef(first, second)[0, 1]) < 0.999
    noises = [suite.scenario(20_000).load_noise_mw for suite in DRAWN]
    assert np.max(np.abs(np.corrcoef(noises) - np.eye(len(DRAWN)))) < 0.9


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


@pytest.mark.parametrize(("n_wtg", "winds"), [(1, [11.4]), (3, [11.4, 8.0, 11.4]), (4, [11.4, 8.0, 11.4, 8.0])])
def test_winds_of_the_paper_alternate_over_more_groups(n_wtg: int, winds: list[float]):
    assert get_suite("paper").scenario(1, n_wtg=n_wtg).wind_speed[:, 0].tolist() == winds


@pytest.mark.parametrize("name", SUITES)
def test_duration_and_groups_can_be_chosen(name: str):
    suite = get_suite(name)
    seed = suite.test[-1]
    scenario = suite.scenario(seed, n_wtg=3, n_turbines=[1.0, 5.0, 10.0], duration_s=30.0)
    assert (scenario.n_wtg, scenario.duration_s, scenario.seed) == (3, 30.0, seed)
    assert suite.scenario(seed).duration_s == suite.duration_s


@pytest.mark.parametrize("name", SUITES)
def test_suite_survives_pickle_and_copy(name: str):
    suite = get_suite(name)
    assert pickle.loads(pickle.dumps(suite)) == suite == copy.deepcopy(suite)


def test_unknown_suite_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="unknown suite 'storm'; known suites: paper, standard, low-wind, gust, weak-"):
        get_suite("storm")


def test_unknown_split_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="unknown split 'dev'; known splits: train, validation, test"):
        get_suite("standard").seeds("dev")


@pytest.mark.parametrize("seed", [9_999, 10_100, 20_200, 2**31, 20_000.0, True])
def test_seed_outside_every_split_is_refused_with_the_ranges(seed: object):
    with pytest.raises(ValueError, match=r"train 1000000 … 2147483647, validation 10000 … 10099, test 20000 … 20199"):
        get_suite("standard").scenario(seed)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"n_wtg": 0}, "n_wtg must be a positive integer, got 0"),
        ({"n_turbines": [10.0]}, r"one value per WTG group \(2\), got 1"),
        ({"duration_s": -1.0}, "duration_s = -1 s"),
    ],
)
def test_bad_arguments_are_refused_by_fixed_cases_too(arguments: dict, text: str):
    # Those of drawn suites are in test_distribution.py.
    with pytest.raises(ValueError, match=text):
        get_suite("paper").scenario(0, **arguments)
