"""Facts about scores, means and intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from wtg_gym.evaluation import score, statistics
from wtg_gym.evaluation.statistics import Groups
from wtg_gym.tasks import V0, V1, Task

COSTS = arrays(np.float64, 7, elements=st.floats(0.0, 3050.0))
#: Seven scenarios of three strata, and J0 of each.
STRATA: Groups = {"ordinary": np.array([0, 3, 6]), "large": np.array([1, 4]), "extreme": np.array([2, 5])}
OFFSETS = np.array([40.0, 300.0, 3000.0, 40.0, 300.0, 3000.0, 40.0])


def whole(n: int) -> Groups:
    return {"": np.arange(n)}


def test_score_is_the_written_formula() -> None:
    reference, mppt, costs = np.array([10.0, 20.0]), np.array([100.0, 40.0]), np.array([5.0, 80.0])
    scale = (math.log(105.0 / 15.0) + math.log(45.0 / 25.0)) / 2.0
    expected = [100.0 * (1.0 + math.log(15.0 / 10.0) / scale), 100.0 * (1.0 + math.log(25.0 / 85.0) / scale)]
    offsets = score.cost_offsets(whole(2), V0)
    scales = score.score_scales(mppt, reference, V0, whole(2))
    assert scales == pytest.approx([scale], rel=1e-14)
    gains = score.gains(costs[np.newaxis], reference, offsets)
    assert score.mean_score(gains, scales, whole(2)) == pytest.approx(sum(expected) / 2.0, rel=1e-14)


def test_score_of_strata_is_the_mean_of_theirs_each_with_its_offset_and_scale() -> None:
    rng = np.random.default_rng(3)
    zero, hundred, costs = rng.uniform(50.0, 60.0, 7), rng.uniform(10.0, 20.0, 7), rng.uniform(5.0, 90.0, (2, 7))
    assert np.array_equal(score.cost_offsets(STRATA, V1), OFFSETS)
    scales = score.score_scales(zero, hundred, V1, STRATA)
    own = score.gains(costs, hundred, OFFSETS)
    expected = []
    for offset, at in zip((40.0, 300.0, 3000.0), STRATA.values(), strict=True):
        z, h, c = (np.log(each[..., at] + offset).mean() for each in (zero, hundred, costs))
        expected.append(100.0 * (z - c) / (z - h))
        assert score.mean_score(own, [z - h], {"": at}) == pytest.approx(expected[-1])
    assert score.mean_score(own, scales, STRATA) == pytest.approx(np.mean(expected))
    zero[STRATA["large"]] = hundred[STRATA["large"]]
    with pytest.raises(score.NoScaleError, match="on these 2 scenarios of the stratum 'large' coordinated-piecewise"):
        score.score_scales(zero, hundred, V1, STRATA)


@given(COSTS, COSTS, st.sampled_from([(V0, whole(7)), (V1, STRATA)]))
def test_anchors_score_exactly_0_and_100(one: np.ndarray, other: np.ndarray, version: tuple[Task, Groups]) -> None:
    task, groups = version
    offsets = score.cost_offsets(groups, task)
    reference, zero = sorted((one, other), key=lambda c: float(np.log(c + offsets).sum()))
    try:
        scales = score.score_scales(zero, reference, task, groups)
    except score.NoScaleError:
        return
    for costs, points in ((zero, 0.0), (reference, 100.0)):
        gains = score.gains(costs[np.newaxis], reference, offsets)
        assert score.mean_score(gains, scales, groups) == points
        for at, scale in zip(groups.values(), scales, strict=True):
            assert score.mean_score(gains, [scale], {"": at}) == points


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_impossible_costs_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="finite and not negative"):
        score.gains(np.array([[1.0, bad]]), np.ones(2), np.full(2, 5.0))


def test_failure_costs_the_worst_there_is() -> None:
    assert score.pinned_cost(12.0, failed=True, duration_s=60.0, cap=50.0) == 3050.0
    assert score.pinned_cost(12.0, failed=False, duration_s=60.0, cap=50.0) == 12.0


def test_interval_of_several_seeds_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(6)
    covered = []
    for _ in range(200):
        # As trained policies are: hard and easy scenarios for all of them, better and worse seeds, and the rest.
        values = 20.0 * rng.normal(size=(1, 100)) + 3.0 * rng.normal(size=(5, 1)) + 2.0 * rng.normal(size=(5, 100))
        interval = statistics.score_interval(values, np.full(100, -1.0), whole(100))
        covered.append(interval.low <= 100.0 <= interval.high)
    assert 0.89 <= np.mean(covered) <= 0.99


def _gains(rng: np.random.Generator, n_runs: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Log gains of an entry and of MPPT, which loses more where the entry gains more: their ratio varies less."""
    mppt = -rng.uniform(0.5, 2.0, n)
    return 0.2 * rng.normal(size=(n_runs, n)) - 0.6 * mppt, mppt


def test_score_interval_agrees_with_scipys_paired_bootstrap_of_the_ratio() -> None:
    gains, mppt = _gains(np.random.default_rng(10), 1, 120)

    def score(own: np.ndarray, scale: np.ndarray, axis: int) -> np.ndarray:
        return 100.0 * (1.0 - own.mean(axis=axis) / scale.mean(axis=axis))

    interval = statistics.score_interval(gains, mppt, whole(120))
    expected = stats.bootstrap(
        (gains[0], mppt), score, paired=True, n_resamples=20_000, method="percentile", rng=11
    ).confidence_interval
    width = expected.high - expected.low
    assert interval.value == pytest.approx(score(gains[0], mppt, 0))
    assert interval.low == pytest.approx(expected.low, abs=0.06 * width)
    assert interval.high == pytest.approx(expected.high, abs=0.06 * width)


def test_difference_of_two_entries_is_paired() -> None:
    gains, mppt = _gains(np.random.default_rng(13), 1, 200)
    better = gains + 0.01
    difference = statistics.score_difference(better, gains, mppt, whole(200))
    assert difference.value == pytest.approx(100.0 * 0.01 / -mppt.mean())
    alone = statistics.score_interval(better, mppt, whole(200))
    assert difference.low > 0.0 and difference.high - difference.low < 0.1 * (alone.high - alone.low)
    other_way = statistics.score_difference(gains, better, mppt, whole(200))
    assert (other_way.value, other_way.low, other_way.high) == pytest.approx(
        (-difference.value, -difference.high, -difference.low)
    )


def test_seeds_of_two_entries_are_drawn_independently() -> None:
    # Two rows of equal seeds, good and bad: were they drawn together, the difference would always be nought.
    gains = np.repeat([[0.0], [1.0]], 30, axis=1)
    difference = statistics.score_difference(gains, gains, np.full(30, -1.0), whole(30))
    assert (difference.value, difference.low, difference.high) == pytest.approx((0.0, -100.0, 100.0))


def test_interval_of_strata_covers_the_truth_and_is_narrower_than_without_them() -> None:
    rng = np.random.default_rng(7)
    groups = {str(i): np.arange(i, 90, 3) for i in range(3)}
    covered, widths = [], []
    for _ in range(200):
        # Strata differ by far more than the scenarios in one.
        values = 10.0 * rng.normal(size=(1, 90)) + np.resize([0.0, 100.0, -100.0], 90)
        own, one = (statistics.score_interval(values, np.full(90, -1.0), each) for each in (groups, whole(90)))
        covered.append(own.low <= 100.0 <= own.high)
        widths.append((own.high - own.low) / (one.high - one.low))
    assert 0.89 <= np.mean(covered) <= 0.99 and max(widths) < 0.3


def test_differences_to_another_entry_are_paired() -> None:
    rng = np.random.default_rng(12)
    costs, happened = rng.lognormal(3.0, 1.0, (1, 70)), (rng.random((1, 70)) < 0.2).astype(float)
    groups = {name: np.concatenate([at + 7 * i for i in range(10)]) for name, at in STRATA.items()}
    for difference in (
        statistics.share_difference(happened, happened, groups),
        statistics.worst_tenth_difference(costs, costs, groups),
    ):
        assert (difference.value, difference.low, difference.high) == (0.0, 0.0, 0.0)
    dearer = statistics.worst_tenth_difference(1.25 * costs, costs, groups)
    assert (dearer.value, dearer.low, dearer.high) == pytest.approx((25.0, 25.0, 25.0))
    more = happened.copy()
    more[0, np.flatnonzero(happened[0] == 0.0)[:7]] = 1.0
    share = statistics.share_difference(more, happened, groups)
    assert share.value == pytest.approx(10.0) and 0.0 < share.low < 10.0 < share.high


@given(
    arrays(np.float64, (3, 2, 7), elements=st.floats(0.0, 1000.0)),
    arrays(np.float64, (3, 7), elements=st.floats(0.0, 1000.0)),
    st.sampled_from([(V0, whole(7), [0.7]), (V1, STRATA, [0.7, 5.0, 80.0])]),
)
def test_points_by_term_add_up_to_the_score(
    terms: np.ndarray, reference_terms: np.ndarray, version: tuple[Task, Groups, list[float]]
) -> None:
    task, groups, scales = version
    costs, reference = terms.sum(axis=0), reference_terms.sum(axis=0)
    offsets = score.cost_offsets(groups, task)
    points = score.points_by_term(costs, reference, terms, reference_terms, scales, groups, offsets)
    total = score.mean_score(score.gains(costs, reference, offsets), scales, groups) - 100.0
    assert math.fsum(points) == pytest.approx(total, rel=1e-9, abs=1e-9 * np.abs(points).max() + 1e-9)


def test_points_by_term_are_the_logarithmic_mean_written_out() -> None:
    terms, reference_terms = np.array([[[4.0]], [[1.0]]]), np.array([[2.0], [8.0]])
    # ln(15 / 10) is the gain of ten against five, and L(15, 10) = 5 / ln(15 / 10).
    expected = [100.0 * (2.0 - 4.0) * math.log(1.5) / 5.0 / 0.5, 100.0 * (8.0 - 1.0) * math.log(1.5) / 5.0 / 0.5]
    costs = np.array([[5.0]]), np.array([10.0])
    points = score.points_by_term(*costs, terms, reference_terms, [0.5], whole(1), np.array([5.0]))
    assert points.tolist() == pytest.approx(expected)
