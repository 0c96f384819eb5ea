"""Facts about scores, means and intervals."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from wtg_gym.evaluation import score, statistics
from wtg_gym.evaluation.adjusted import Adjusted
from wtg_gym.evaluation.statistics import Bootstrap, Groups
from wtg_gym.tasks import V0

#: J0 of seven scenarios of three strata.
OFFSETS = np.array([40.0, 300.0, 3000.0, 40.0, 300.0, 3000.0, 40.0])


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
def test_impossible_costs_are_refused(bad):
    with pytest.raises(ValueError, match="finite and not negative"):
        score.gains(np.array([[1.0, bad]]), np.ones(2), np.full(2, 5.0))


def test_failure_costs_the_worst_there_is():
    assert score.pinned_cost(12.0, failed=True, duration_s=60.0, cap=50.0) == 3050.0
    assert score.pinned_cost(12.0, failed=False, duration_s=60.0, cap=50.0) == 12.0


def test_interval_of_several_seeds_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(6)
    covered = []
    for _ in range(200):
        # As trained policies are: hard and easy scenarios for all of them, better and worse seeds, and the rest.
        values = 20.0 * rng.normal(size=(1, 100)) + 3.0 * rng.normal(size=(5, 1)) + 2.0 * rng.normal(size=(5, 100))
        interval = Bootstrap(np.full(100, -1.0)).score(values)
        covered.append(interval.low <= 100.0 <= interval.high)
    assert 0.89 <= np.mean(covered) <= 0.99


def _gains(rng: np.random.Generator, n_runs: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Log gains of an entry and of MPPT, which loses more where the entry gains more: their ratio varies less."""
    mppt = -rng.uniform(0.5, 2.0, n)
    return 0.2 * rng.normal(size=(n_runs, n)) - 0.6 * mppt, mppt


def test_score_interval_agrees_with_scipys_paired_bootstrap_of_the_ratio():
    gains, mppt = _gains(np.random.default_rng(10), 1, 120)

    def score(own: np.ndarray, scale: np.ndarray, axis: int) -> np.ndarray:
        return 100.0 * (1.0 - own.mean(axis=axis) / scale.mean(axis=axis))

    interval = Bootstrap(mppt).score(gains)
    drawn = stats.bootstrap((gains[0], mppt), score, paired=True, n_resamples=20_000, method="percentile", rng=11)
    expected = drawn.confidence_interval
    width = expected.high - expected.low
    assert interval.value == pytest.approx(score(gains[0], mppt, 0))
    assert interval.low == pytest.approx(expected.low, abs=0.06 * width)
    assert interval.high == pytest.approx(expected.high, abs=0.06 * width)


def test_difference_of_two_entries_is_paired():
    gains, mppt = _gains(np.random.default_rng(13), 1, 200)
    better = gains + 0.01
    difference = Bootstrap(mppt).score_difference(better, gains)
    assert difference.value == pytest.approx(100.0 * 0.01 / -mppt.mean())
    alone = Bootstrap(mppt).score(better)
    assert difference.low > 0.0 and difference.high - difference.low < 0.1 * (alone.high - alone.low)
    back = Bootstrap(mppt).score_difference(gains, better)
    assert (back.value, back.low, back.high) == pytest.approx((-difference.value, -difference.high, -difference.low))


def test_seeds_of_two_entries_are_drawn_independently():
    # Two rows of equal seeds, good and bad: were they drawn together, the difference would always be nought.
    gains = np.repeat([[0.0], [1.0]], 30, axis=1)
    difference = Bootstrap(np.full(30, -1.0)).score_difference(gains, gains)
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


@given(
    arrays(np.float64, (3, 2, 7), elements=st.floats(0.0, 1000.0)),
    arrays(np.float64, (3, 7), elements=st.floats(0.0, 1000.0)),
)
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
