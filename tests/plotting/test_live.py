"""The page of play without a browser: matches and their costs."""

import numpy as np
import pytest

from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.plotting.live import OWN, REFERENCE, Match
from wtg_gym.scenarios import Suite, get_suite

_LENGTH_S = 12.0
_SEED = 20_000


@pytest.fixture(scope="module", params=["standard-v1", "standard"])
def suite(request):
    return get_suite(request.param)


def _played(suite: Suite, on_k: float, on_tau: float = 0.0, seed: int = _SEED) -> Match:
    match = Match(suite, seed, _LENGTH_S)
    while not match.over:
        match.step(on_k, on_tau)
    return match


def test_without_an_action_you_are_the_reference(suite):
    match = _played(suite, 0.0)
    you, *anchors = match.verdicts()
    same = next(each for each in anchors if each.name == "coordinated-piecewise")
    assert you._replace(name=same.name) == same
    assert [each.name for each in anchors] == list(suite.task.anchors)
    for values in match.sample().values():
        assert np.array_equal(values[OWN], values[REFERENCE])


def test_the_cost_is_the_evaluators(suite):
    class Held:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return np.tile([0.3, -0.2], (len(observation), len(suite.plant.groups))), state

    seeds = list(suite.validation[:3])
    entry = Entry(name="held", policy=Held(), action_mode="k+tau")
    results = evaluate([entry], suite.name, "validation", seeds=seeds, duration_s=_LENGTH_S)
    yours = [_played(suite, 0.3, -0.2, seed).verdicts()[0] for seed in seeds]
    assert [you.cost for you in yours] == [episode.metrics["cost"] for episode in results.episodes_of("held")]
