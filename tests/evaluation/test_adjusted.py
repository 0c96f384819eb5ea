"""Facts about adjusted scores and their intervals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest

from wtg_gym.evaluation import Interval
from wtg_gym.evaluation.adjusted import Adjusted, ControlVariates, KnownMeans, known_means
from wtg_gym.evaluation.statistics import Groups
from wtg_gym.scenarios import DEFAULT_SUITE, FROZEN_HASHES
from wtg_gym.tasks import V1

N = 60
GROUPS: Groups = {name: np.arange(i, 3 * N, 3) for i, name in enumerate(("ample", "tight", "short"))}


def variates(x: np.ndarray, mean: Sequence[float], n: int = 10**12) -> ControlVariates:
    covariance = np.cov(x.T).reshape(len(mean), len(mean)).tolist()
    return ControlVariates(x, {name: KnownMeans(n, list(mean), covariance) for name in GROUPS})


def nearly(value: float, abs: float = 1e-9) -> Interval:
    return pytest.approx(Interval(value, value, value).__dict__, abs=abs)


def laws(rng: np.random.Generator, n: int = 3 * N, n_laws: int = 2) -> np.ndarray:
    """Gains of laws with mean 0: skewed, with heavy tails, and much alike."""
    common, own = rng.standard_t(5, size=(2, n, n_laws))
    skewed = common[:, :1] + 0.15 * (common[:, :1] ** 2 - 5.0 / 3.0)
    return skewed + 0.5 * own


def test_score_is_the_written_formula():
    rng = np.random.default_rng(1)
    x, gains = laws(rng), rng.normal(size=(2, 3 * N))
    plain, adjusted = Adjusted(0.4, GROUPS), Adjusted(0.4, GROUPS, variates(x, [0.1, -0.2]))
    assert plain.score(gains).value == pytest.approx(100.0 + 100.0 / 0.4 * gains.mean())
    expected = []
    for name, at in GROUPS.items():
        g, of_laws = gains[:, at].mean(axis=0), x[at]
        beta = np.linalg.lstsq(of_laws - of_laws.mean(axis=0), g - g.mean(), rcond=None)[0]
        expected.append(100.0 + 100.0 / 0.4 * (g.mean() - beta @ (of_laws.mean(axis=0) - [0.1, -0.2])))
        assert adjusted.strata(gains)[name].value == pytest.approx(expected[-1])
    assert adjusted.score(gains).value == pytest.approx(np.mean(expected))
    assert adjusted.points(gains) == pytest.approx(np.mean(expected) - 100.0)
    other = rng.normal(size=(3, 3 * N))
    difference = adjusted.score_difference(gains, other)
    assert difference.value == pytest.approx(adjusted.score(gains).value - adjusted.score(other).value)


def test_hundred_is_exactly_100_and_a_variate_is_its_known_mean():
    x = laws(np.random.default_rng(2))
    adjusted = Adjusted(0.4, GROUPS, variates(x, [0.1, -0.2]))
    assert adjusted.score(np.zeros((1, 3 * N))) == Interval(100.0, 100.0, 100.0)
    assert adjusted.score(x[:, :1].T).__dict__ == nearly(125.0, abs=1e-3)
    assert adjusted.score(np.repeat(x[:, 1:].T, 2, axis=0)).__dict__ == nearly(50.0, abs=1e-3)
    assert adjusted.score_difference(x[:, :1].T, x[:, :1].T) == Interval(0.0, 0.0, 0.0)
    # The known mean is from as many scenarios as are played: its own error is that of their mean.
    rough = Adjusted(0.4, GROUPS, variates(x, [0.1, -0.2], n=N)).score(x[:, :1].T)
    plain = Adjusted(0.4, GROUPS).score(x[:, :1].T)
    assert rough.high - rough.low == pytest.approx(plain.high - plain.low, rel=0.1)


def test_variates_that_say_nothing_change_nothing():
    rng = np.random.default_rng(3)
    x, gains = laws(rng, n_laws=1), rng.normal(size=(2, 3 * N))
    once, twice = (Adjusted(0.4, GROUPS, variates(np.repeat(x, n, axis=1), [0.1] * n)) for n in (1, 2))
    assert twice.score(gains).value == pytest.approx(once.score(gains).value)
    assert twice.score(gains).high == pytest.approx(once.score(gains).high, rel=1e-3)
    constant = Adjusted(0.4, GROUPS, variates(np.full((3 * N, 1), 0.3), [0.2]))
    assert constant.score(gains).value == pytest.approx(Adjusted(0.4, GROUPS).score(gains).value)


@pytest.mark.parametrize("n", [1, 2])
def test_few_scenarios_have_finite_intervals(n):
    rng = np.random.default_rng(4)
    groups = {name: i * n + np.arange(n) for i, name in enumerate(GROUPS)}
    for n_runs in (1, 2):
        gains = rng.normal(size=(n_runs, 3 * n))
        for interval in (Adjusted(0.4, groups).score(gains), Adjusted(0.4, groups).score_difference(gains, -gains)):
            assert np.isfinite([interval.low, interval.high]).all() and interval.low <= interval.value <= interval.high
            assert (interval.low == interval.high) == (n == n_runs == 1)


class World(NamedTuple):
    """Entries whose true score is 100, how they differ by their parts of the variance."""

    n_runs: int
    of_laws: float
    of_scenarios: float
    of_runs: float
    of_both: float


#: Almost all by the laws; one training seed and three that differ, not at all, a little and much.
WORLDS = {
    "a law": World(1, 1.0, 0.5, 0.0, 0.0),
    "three equal seeds": World(3, 1.0, 0.3, 0.0, 0.3),
    "three seeds": World(3, 1.0, 0.3, 0.05, 0.2),
    "three unequal seeds": World(3, 1.0, 0.3, 0.5, 0.2),
}


@pytest.mark.parametrize(("world", "adjust"), [*((world, True) for world in WORLDS), ("three seeds", False)])
def test_intervals_cover_the_truth_in_95_of_100_cases(world, adjust):
    w, rng, n_worlds, n_known = WORLDS[world], np.random.default_rng(5), 300, 3000
    covariance = np.cov(laws(rng, 100_000).T)

    def entry(x: np.ndarray) -> np.ndarray:
        # Strata differ in how an entry follows the laws; where a law does badly, the rest varies more.
        slopes = np.tile([[0.5, 0.5], [1.0, 0.2], [2.0, -1.0]], (N, 1))
        spread = 1.0 + 0.5 * np.abs(x[:, 0])
        own = w.of_scenarios * rng.standard_t(5, 3 * N) + w.of_both * rng.standard_t(5, (w.n_runs, 3 * N))
        return w.of_laws * (slopes * x).sum(axis=1) + spread * own + w.of_runs * rng.normal(size=(w.n_runs, 1))

    covered = []
    for _ in range(n_worlds):
        x, means = laws(rng), rng.multivariate_normal([0.0, 0.0], covariance / n_known, 3)
        known = {
            name: KnownMeans(n_known, mean.tolist(), covariance.tolist())
            for name, mean in zip(GROUPS, means, strict=True)
        }
        scoring = Adjusted(0.4, GROUPS, ControlVariates(x, known) if adjust else None)
        one, other = entry(x), entry(x)
        for interval, truth in ((scoring.score(one), 100.0), (scoring.score_difference(one, other), 0.0)):
            covered.append(interval.low <= truth <= interval.high)
    error = np.sqrt(0.95 * 0.05 / len(covered))
    assert 0.93 - 2.0 * error <= np.mean(covered) <= 0.97 + 2.0 * error


def test_means_of_another_suite_or_of_other_settings_are_not_taken():
    hash = FROZEN_HASHES[DEFAULT_SUITE]
    assert known_means(DEFAULT_SUITE, hash, {"duration_s": 1.0}, V1.variates) == {}
    assert known_means("/a/suite.json", hash, {}, V1.variates) == {}
