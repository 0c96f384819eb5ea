"""Facts about scores, means and intervals, plain and adjusted by the laws' known means."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from wtg_gym.evaluation import Interval, score, statistics, summary
from wtg_gym.evaluation.adjusted import Adjusted, ControlVariates, KnownMeans, known_means
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.statistics import Bootstrap, Groups
from wtg_gym.scenarios import DEFAULT_SUITE, FROZEN_HASHES
from wtg_gym.tasks import V0, V1

#: J0 of seven scenarios of three strata.
OFFSETS = np.array([40.0, 300.0, 3000.0, 40.0, 300.0, 3000.0, 40.0])
COSTS = st.floats(0.0, 1000.0)
N = 60
GROUPS: Groups = {name: np.arange(i, 3 * N, 3) for i, name in enumerate(("ample", "tight", "short"))}
#: Entries whose true score is 100: training seeds, and the parts of the variance that the scenarios (beside the laws),
#: the seeds, and both together have. One training seed, and three that differ not at all, a little and much.
WORLDS = {
    "a law": (1, 0.5, 0.0, 0.0),
    "three equal seeds": (3, 0.3, 0.0, 0.3),
    "three seeds": (3, 0.3, 0.05, 0.2),
    "three unequal seeds": (3, 0.3, 0.5, 0.2),
}


def whole(n: int) -> Groups:
    return {"": np.arange(n)}


def test_score_is_the_written_formula():
    reference, mppt, costs = np.array([10.0, 20.0]), np.array([100.0, 40.0]), np.array([5.0, 80.0])
    scale = (math.log(105.0 / 15.0) + math.log(45.0 / 25.0)) / 2.0
    expected = [100.0 * (1.0 + math.log(15.0 / 10.0) / scale), 100.0 * (1.0 + math.log(25.0 / 85.0) / scale)]
    offsets = score.cost_offsets(whole(2), V0)
    assert score.score_scale(mppt, reference, V0, whole(2)) == pytest.approx(scale, rel=1e-14)
    gains, zero = score.gains(np.array([costs, mppt]), reference, offsets)
    scoring = Bootstrap(zero)
    assert scoring.score(gains[np.newaxis]).value == pytest.approx(sum(expected) / 2.0, rel=1e-14)
    assert scoring.points(gains[np.newaxis]) == pytest.approx(sum(expected) / 2.0 - 100.0, rel=1e-14)
    with pytest.raises(score.NoScaleError, match=r"on these 2 scenarios mppt .* is not worse than coordinated"):
        score.score_scale(reference, mppt, V0, whole(2))


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_failure_costs_the_worst_there_is_and_impossible_costs_are_refused(bad):
    known = {"entry": "mine", "training_seed": None, "seed": 0, "scenario": "any", "metrics": {"cost": 12.0}}
    run = [Episode(**known, duration_s=60.0, failure=failure) for failure in ("stall", "")]
    assert summary.pinned_costs([run], 50.0).tolist() == [[3050.0, 12.0]]
    assert summary.pinned_costs([run], None).tolist() == [[12.0, 12.0]]
    with pytest.raises(ValueError, match="finite and not negative"):
        score.gains(np.array([[1.0, bad]]), np.ones(2), np.full(2, 5.0))


def test_interval_of_several_seeds_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(6)
    covered = []
    for _ in range(200):
        # As trained policies are: hard and easy scenarios for all of them, better and worse seeds, and the rest.
        values = 20.0 * rng.normal(size=(1, 100)) + 3.0 * rng.normal(size=(5, 1)) + 2.0 * rng.normal(size=(5, 100))
        interval = Bootstrap(np.full(100, -1.0)).score(values)
        covered.append(interval.low <= 100.0 <= interval.high)
    assert 0.89 <= np.mean(covered) <= 0.99


def test_score_interval_agrees_with_scipys_paired_bootstrap_of_the_ratio():
    # Of an entry and of MPPT, which loses more where the entry gains more: their ratio varies less.
    rng = np.random.default_rng(10)
    mppt = -rng.uniform(0.5, 2.0, 120)
    gains = 0.2 * rng.normal(size=(1, 120)) - 0.6 * mppt

    def score(own: np.ndarray, scale: np.ndarray, axis: int) -> np.ndarray:
        return 100.0 * (1.0 - own.mean(axis=axis) / scale.mean(axis=axis))

    interval = Bootstrap(mppt).score(gains)
    drawn = stats.bootstrap((gains[0], mppt), score, paired=True, n_resamples=20_000, method="percentile", rng=11)
    expected = drawn.confidence_interval
    width = expected.high - expected.low
    assert interval.value == pytest.approx(score(gains[0], mppt, 0))
    assert interval.low == pytest.approx(expected.low, abs=0.06 * width)
    assert interval.high == pytest.approx(expected.high, abs=0.06 * width)


def test_seeds_of_two_entries_are_drawn_independently():
    # Two rows of equal seeds, good and bad: were they drawn together, the difference would always be nought.
    gains = np.repeat([[0.0], [1.0]], 30, axis=1)
    difference = Bootstrap(np.full(30, -1.0)).share_difference(gains, gains)
    assert (difference.value, difference.low, difference.high) == pytest.approx((0.0, -100.0, 100.0))


@pytest.mark.parametrize("version", ["v0", "v1"])
def test_differences_to_another_entry_are_paired(version):
    rng = np.random.default_rng(12)
    costs, happened = rng.lognormal(3.0, 1.0, (1, 70)), (rng.random((1, 70)) < 0.2).astype(float)
    differences = Bootstrap(np.full(70, -1.0)) if version == "v0" else Adjusted(0.4, whole(70))
    for none in (differences.share_difference(happened, happened), differences.worst_tenth_difference(costs, costs)):
        assert (none.value, none.low, none.high) == (0.0, 0.0, 0.0)
    dearer = differences.worst_tenth_difference(1.25 * costs, costs)
    assert (dearer.value, dearer.low, dearer.high) == pytest.approx((25.0, 25.0, 25.0))
    more = happened.copy()
    more[0, np.flatnonzero(happened[0] == 0.0)[:7]] = 1.0
    share = differences.share_difference(more, happened)
    assert share.value == pytest.approx(10.0) and 0.0 < share.low < 10.0 < share.high


def test_intervals_of_differences_agree_with_the_bootstrap():
    rng = np.random.default_rng(14)
    costs = rng.lognormal(3.0, 1.0, 600) * np.exp(0.3 * rng.normal(size=(2, 1, 600)))
    linear, bootstrap = Adjusted(0.4, whole(600)), Bootstrap(np.full(600, -1.0))
    for name, one, other in (("worst_tenth_difference", *costs), ("share_difference", *(costs > 60.0).astype(float))):
        own, base = (getattr(each, name)(one, other) for each in (linear, bootstrap))
        width = base.high - base.low
        assert own.value == pytest.approx(base.value)
        assert (own.low, own.high) == pytest.approx((base.low, base.high), abs=0.15 * width)


@given(arrays(np.float64, (3, 2, 7), elements=COSTS), arrays(np.float64, (3, 7), elements=COSTS))
def test_parts_of_terms_add_up_to_the_gains(terms, reference_terms):
    costs, reference = terms.sum(axis=0), reference_terms.sum(axis=0)
    parts = score.gains_by_term(costs, reference, terms, reference_terms, OFFSETS)
    gains = score.gains(costs, reference, OFFSETS)
    assert parts.sum(axis=0) == pytest.approx(gains, rel=1e-9, abs=1e-9 * np.abs(parts).max() + 1e-9)


def test_parts_of_terms_are_the_logarithmic_mean_written_out():
    terms, reference_terms = np.array([[[4.0]], [[1.0]]]), np.array([[2.0], [8.0]])
    # ln(15 / 10) is the gain of ten against five, and L(15, 10) = 5 / ln(15 / 10).
    expected = [(2.0 - 4.0) * math.log(1.5) / 5.0, (8.0 - 1.0) * math.log(1.5) / 5.0]
    costs = np.array([[5.0]]), np.array([10.0])
    parts = score.gains_by_term(*costs, terms, reference_terms, np.array([5.0]))
    assert parts.ravel().tolist() == pytest.approx(expected)


@pytest.mark.parametrize(("n_more", "n_less"), [(0, 0), (5, 0), (4, 0), (9, 2), (3, 8), (120, 100)])
def test_of_one_run_the_test_of_bad_runs_is_mcnemars(n_more, n_less):
    happened, other = np.zeros((2, 1, 400))
    happened[0, :n_more], other[0, n_more : n_more + n_less] = 1.0, 1.0
    happened[0, 300:], other[0, 300:] = 1.0, 1.0
    chance = statistics.sign_test(happened, other)
    n = n_more + n_less
    assert chance == pytest.approx(stats.binomtest(n_more, n, 0.5, alternative="greater").pvalue if n else 1.0)


def test_training_seeds_that_go_bad_in_the_same_scenarios_are_no_further_evidence():
    happened, other = np.zeros((1, 40)), np.zeros((1, 40))
    happened[0, :4] = 1.0
    alone = statistics.sign_test(happened, other)
    assert statistics.sign_test(np.repeat(happened, 3, axis=0), other) == pytest.approx(alone) == 1.0 / 16.0
    # Signs of 3, 1 and -1: a sum of 3 or 5 of the eight.
    mixed = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
    assert statistics.sign_test(mixed, np.array([[0.0, 0.0, 1.0]])) == pytest.approx(3.0 / 8.0)


def variates(x: np.ndarray, mean: Sequence[float], n: int = 10**12) -> ControlVariates:
    covariance = np.cov(x.T).reshape(len(mean), len(mean)).tolist()
    return ControlVariates(x, {name: KnownMeans(n, list(mean), covariance) for name in GROUPS})


def laws(rng: np.random.Generator, n: int = 3 * N, n_laws: int = 2) -> np.ndarray:
    """Gains of laws with mean 0: skewed, with heavy tails, and much alike."""
    common, own = rng.standard_t(5, size=(2, n, n_laws))
    skewed = common[:, :1] + 0.15 * (common[:, :1] ** 2 - 5.0 / 3.0)
    return skewed + 0.5 * own


def test_adjusted_score_is_the_written_formula():
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
    for own, expected in ((x[:, :1].T, 125.0), (np.repeat(x[:, 1:].T, 2, axis=0), 50.0)):
        assert list(vars(adjusted.score(own)).values()) == pytest.approx([expected] * 3, abs=1e-3)
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


@pytest.mark.parametrize(("world", "adjust"), [*((world, True) for world in WORLDS), ("three seeds", False)])
def test_intervals_cover_the_truth_in_95_of_100_cases(world, adjust):
    (n_runs, of_scenarios, of_runs, of_both), rng, n_known = WORLDS[world], np.random.default_rng(5), 3000
    covariance = np.cov(laws(rng, 100_000).T)

    def entry(x: np.ndarray) -> np.ndarray:
        # Strata differ in how an entry follows the laws; where a law does badly, the rest varies more.
        slopes = np.tile([[0.5, 0.5], [1.0, 0.2], [2.0, -1.0]], (N, 1))
        spread = 1.0 + 0.5 * np.abs(x[:, 0])
        own = of_scenarios * rng.standard_t(5, 3 * N) + of_both * rng.standard_t(5, (n_runs, 3 * N))
        return (slopes * x).sum(axis=1) + spread * own + of_runs * rng.normal(size=(n_runs, 1))

    covered = []
    for _ in range(300):
        x, means = laws(rng), rng.multivariate_normal([0.0, 0.0], covariance / n_known, 3)
        own = [KnownMeans(n_known, mean.tolist(), covariance.tolist()) for mean in means]
        known = dict(zip(GROUPS, own, strict=True))
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
