"""Facts about scores, means and intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.statistics import COST_OFFSET

COSTS = arrays(np.float64, 7, elements=st.floats(0.0, 3050.0))


def test_score_is_the_written_formula() -> None:
    reference, mppt, costs = np.array([10.0, 20.0]), np.array([100.0, 40.0]), np.array([5.0, 80.0])
    scale = (math.log(105.0 / 15.0) + math.log(45.0 / 25.0)) / 2.0
    expected = [100.0 * (1.0 + math.log(15.0 / 10.0) / scale), 100.0 * (1.0 + math.log(25.0 / 85.0) / scale)]
    assert COST_OFFSET == 5.0
    assert statistics.score_scale(mppt, reference) == pytest.approx(scale, rel=1e-14)
    gains = statistics.log_gains(costs[np.newaxis], reference)
    assert statistics.scenario_scores(gains, scale)[0] == pytest.approx(expected, rel=1e-14)
    assert statistics.mean_score(gains, scale) == pytest.approx(sum(expected) / 2.0, rel=1e-14)


@given(COSTS, COSTS)
def test_anchors_score_exactly_0_and_100(one: np.ndarray, other: np.ndarray) -> None:
    reference, mppt = sorted((one, other), key=lambda c: float(np.log(c + COST_OFFSET).sum()))
    try:
        scale = statistics.score_scale(mppt, reference)
    except ValueError:
        return
    assert statistics.mean_score(statistics.log_gains(mppt[np.newaxis], reference), scale) == 0.0
    assert statistics.mean_score(statistics.log_gains(reference[np.newaxis], reference), scale) == 100.0
    assert (statistics.scenario_scores(statistics.log_gains(reference[np.newaxis], reference), scale) == 100.0).all()


def test_one_free_scenario_cannot_carry_an_entry() -> None:
    reference, mppt = np.full(200, 70.0), np.full(200, 200.0)
    scale = statistics.score_scale(mppt, reference)
    costs = reference.copy()
    costs[0] = 0.0
    gain = statistics.mean_score(statistics.log_gains(costs[np.newaxis], reference), scale) - 100.0
    assert 0.0 < gain < 2.0


def test_scale_needs_an_mppt_that_is_worse() -> None:
    with pytest.raises(ValueError, match=r"MPPT \(mean cost 3\) is not worse than the reference \(mean cost 3\)"):
        statistics.score_scale(np.full(4, 3.0), np.full(4, 3.0))


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_impossible_costs_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="finite and not negative"):
        statistics.log_gains(np.array([[1.0, bad]]), np.ones(2))


def test_failure_costs_the_worst_there_is() -> None:
    assert statistics.pinned_cost(12.0, failed=True, duration_s=60.0, cap=50.0) == 3050.0
    assert statistics.pinned_cost(12.0, failed=False, duration_s=60.0, cap=50.0) == 12.0


@given(st.integers(1, 60), st.integers(0, 2**31))
def test_interquartile_mean_is_scipys_trimmed_mean(n: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(3, n))
    expected = stats.trim_mean(values, 0.25, axis=1)
    np.testing.assert_allclose(statistics.interquartile_mean(values), expected, rtol=1e-12, atol=1e-14)


def test_improvement_counts_equal_costs_half() -> None:
    better = statistics.improvement(np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 9.0]]), np.array([2.0, 2.0, 2.0]))
    assert better.tolist() == [[1.0, 0.5, 0.0], [1.0, 1.0, 0.0]]
    assert statistics.mean_interval(better).value == pytest.approx(3.5 / 6.0)


def test_bootstrap_agrees_with_scipys_percentile_bootstrap() -> None:
    values = np.random.default_rng(1).exponential(size=120)
    interval = statistics.mean_interval(values[np.newaxis])
    expected = stats.bootstrap((values,), np.mean, n_resamples=20_000, method="percentile", rng=2).confidence_interval
    width = expected.high - expected.low
    assert interval.value == pytest.approx(values.mean())
    assert interval.low == pytest.approx(expected.low, abs=0.05 * width)
    assert interval.high == pytest.approx(expected.high, abs=0.05 * width)


def test_bootstrap_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    intervals = [statistics.mean_interval(rng.normal(size=(1, 80))) for _ in range(200)]
    covered = np.mean([interval.low <= 0.0 <= interval.high for interval in intervals])
    assert 0.89 <= covered <= 0.99


def test_more_seeds_of_the_same_policy_tell_no_more() -> None:
    one = np.random.default_rng(5).normal(size=(1, 60))
    alone, together = statistics.mean_interval(one), statistics.mean_interval(np.repeat(one, 5, axis=0))
    assert (together.low, together.high) == pytest.approx((alone.low, alone.high), rel=1e-12)


def test_bootstrap_draws_seeds_too() -> None:
    # Without any spread over scenarios, what is left is that of the seeds: either, or half of each.
    values = np.repeat([[0.0], [100.0]], 30, axis=1)
    assert statistics.bootstrap(values, lambda samples: samples.mean(axis=-1)) == (0.0, 100.0)


def test_interval_of_several_seeds_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(6)
    covered = []
    for _ in range(200):
        # As trained policies are: hard and easy scenarios for all of them, better and worse seeds, and the rest.
        values = 20.0 * rng.normal(size=(1, 100)) + 3.0 * rng.normal(size=(5, 1)) + 2.0 * rng.normal(size=(5, 100))
        interval = statistics.mean_interval(values)
        covered.append(interval.low <= 0.0 <= interval.high)
    assert 0.89 <= np.mean(covered) <= 0.99


def test_bootstrap_gives_the_same_interval_again() -> None:
    values = np.random.default_rng(4).normal(size=(2, 50))
    assert statistics.interquartile_interval(values) == statistics.interquartile_interval(values)


def test_gap_closed_is_the_written_formula() -> None:
    reference, oracle = np.array([10.0, 30.0, 20.0]), np.array([8.0, 20.0, 20.0])
    costs = np.array([[9.0, 26.0, 21.0], [12.0, 24.0, 19.0]])
    # Gained: 1 + 4 - 1 and -2 + 6 + 1, of 12 that there are in each run.
    interval = statistics.gap_closed(costs, reference, oracle)
    assert interval is not None and interval.value == pytest.approx(100.0 * (4.0 + 5.0) / 24.0)
    assert interval.low < interval.value < interval.high


def test_gap_closed_has_two_fixed_points_also_in_every_resample() -> None:
    reference = np.random.default_rng(5).uniform(5.0, 50.0, 40)
    oracle = 0.7 * reference
    for costs, share in ((reference, 0.0), (oracle, 100.0)):
        interval = statistics.gap_closed(costs[np.newaxis], reference, oracle)
        assert interval is not None
        assert (interval.value, interval.low, interval.high) == pytest.approx((share, share, share))


def test_gap_closed_interval_agrees_with_scipys_paired_bootstrap() -> None:
    rng = np.random.default_rng(6)
    reference = rng.uniform(5.0, 50.0, 120)
    oracle, costs = reference * rng.uniform(0.5, 0.9, 120), reference * rng.uniform(0.6, 1.2, 120)

    def share(j: np.ndarray, ref: np.ndarray, best: np.ndarray, axis: int) -> np.ndarray:
        return 100.0 * (ref - j).mean(axis=axis) / (ref - best).mean(axis=axis)

    expected = stats.bootstrap(
        (costs, reference, oracle), share, paired=True, n_resamples=20_000, method="percentile", rng=7
    ).confidence_interval
    interval = statistics.gap_closed(costs[np.newaxis], reference, oracle)
    assert interval is not None
    width = expected.high - expected.low
    assert interval.low == pytest.approx(expected.low, abs=0.05 * width)
    assert interval.high == pytest.approx(expected.high, abs=0.05 * width)


def test_gap_closed_needs_a_gap() -> None:
    reference = np.array([3.0, 4.0])
    assert statistics.gap_closed(np.array([[1.0, 1.0]]), reference, reference) is None
    # One scenario has none: the resamples with that one alone say nothing.
    interval = statistics.gap_closed(np.array([[2.0, 4.0]]), reference, np.array([1.0, 4.0]))
    assert interval is not None and (interval.value, interval.low, interval.high) == (50.0, 50.0, 50.0)


def test_gap_interval_agrees_with_a_bootstrap_written_out() -> None:
    rng = np.random.default_rng(8)
    sides = []
    for n in (120, 90):
        mppt = -rng.uniform(0.5, 2.0, n)
        sides.append((0.2 * rng.normal(size=(1, n)) - 0.1 * mppt, mppt))
    (a, m), (b, k) = sides

    def gap(x: np.ndarray, y: np.ndarray, axis: int) -> np.ndarray:
        # Two columns at once: the entry's gains, and MPPT's.
        one, other = (100.0 * z[0].mean(axis=axis) / -z[1].mean(axis=axis) for z in (x, y))
        return one - other

    resampled = []
    for _ in range(20_000):
        i, j = rng.integers(0, 120, 120), rng.integers(0, 90, 90)
        resampled.append(gap(np.stack([a[0, i], m[i]]), np.stack([b[0, j], k[j]]), axis=-1))
    low, high = np.percentile(resampled, [2.5, 97.5])
    interval = statistics.score_gap(*sides)
    assert interval.value == pytest.approx(100.0 * (a.mean() / -m.mean() - b.mean() / -k.mean()))
    assert interval.low == pytest.approx(low, abs=0.06 * (high - low))
    assert interval.high == pytest.approx(high, abs=0.06 * (high - low))


def _two_sets(rng: np.random.Generator, fitted: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Gains of two seeds and of two controls on lucky public scenarios and on fresh ones; `fitted` on the public."""
    sides = []
    for luck, extra in ((0.5, fitted), (0.0, 0.0)):
        shared = rng.normal(size=100) + luck
        controls = np.stack([shared + 0.1 * rng.normal(size=100), rng.normal(size=100)])
        sides.append((0.8 * shared + 0.1 * rng.normal(size=(2, 100)) + extra, controls))
    return sides


def test_excess_is_what_the_controls_do_not_share() -> None:
    rng = np.random.default_rng(9)
    honest = [statistics.excess_gap(*_two_sets(rng, 0.0), 1.0) for _ in range(200)]
    assert 0.89 <= np.mean([interval.low <= 0.0 <= interval.high for interval in honest]) <= 0.99
    # The luck of half a standard deviation, 40 points here, is none of theirs.
    assert abs(np.mean([interval.value for interval in honest])) < 1.0
    fitted = [statistics.excess_gap(*_two_sets(rng, 0.1), 1.0) for _ in range(50)]
    assert np.mean([interval.value for interval in fitted]) == pytest.approx(10.0, abs=1.0)
    assert all(interval.low > 0.0 for interval in fitted)


def test_excess_of_a_row_shows_though_only_one_of_its_seeds_has_any() -> None:
    rng = np.random.default_rng(9)
    public, fresh = (0.2 * rng.normal(size=(1, 200)) for _ in range(2))
    # Two seeds that do what the control does; one of them a little better where the scenarios are public.
    sides = [np.concatenate([own, own]) + 0.005 * rng.normal(size=(2, 200)) for own in (public, fresh)]
    honest = statistics.excess_gap((sides[0], public), (sides[1], fresh), 0.5)
    assert honest.low < 0.0 < honest.high
    sides[0][1] += 0.02
    mixed = statistics.excess_gap((sides[0], public), (sides[1], fresh), 0.5)
    assert mixed.value == pytest.approx(honest.value + 2.0) and mixed.low > 1.5
