"""The page of play without a browser: matches and their scores."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.plotting.live.match import OWN, REFERENCE, Match, Scale
from wtg_gym.scenarios import get_suite

_LENGTH_S = 12.0
_SEED = 20_000


@pytest.fixture(scope="module", params=["standard-v1", "standard"])
def scale(request: pytest.FixtureRequest) -> Scale:
    return Scale.of(get_suite(request.param), _LENGTH_S)


def _played(scale: Scale, on_k: float, on_tau: float = 0.0, seed: int = _SEED) -> Match:
    match = Match(scale, seed)
    while not match.over:
        match.step(on_k, on_tau)
    return match


def test_without_an_action_you_are_the_reference(scale: Scale) -> None:
    match = _played(scale, 0.0)
    you, *anchors = match.verdicts()
    same = next(each for each in anchors if each.name == "coordinated-piecewise")
    assert you._replace(name=same.name) == same
    assert [each.name for each in anchors] == list(scale.suite.benchmark.anchors)
    for values in match.sample().values():
        assert np.array_equal(values[OWN], values[REFERENCE])


def test_the_score_is_the_evaluators(scale: Scale) -> None:
    """A policy that holds the same action through the scale's scenarios gets the mean of the matches' scores."""

    class Held:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):  # type: ignore[no-untyped-def]
            return np.full((len(observation), 2 * len(scale.suite.plant.groups)), 0.3), state

    seeds = list(scale.suite.validation[:50])
    entry = Entry(name="held", policy=Held(), action_mode="k+tau")
    results = evaluate([entry], scale.suite.name, "validation", seeds=seeds, duration_s=_LENGTH_S)
    yours = [_played(scale, 0.3, 0.3, seed).verdicts()[0] for seed in seeds]
    assert np.mean([you.score for you in yours]) == pytest.approx(results.scores["held"].value, abs=1e-9)
    assert [you.cost for you in yours] == [episode.metrics["cost"] for episode in results.episodes_of("held")]
