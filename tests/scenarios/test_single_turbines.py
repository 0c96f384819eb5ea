"""The winds of single turbines: their spectrum, the mean of a group, and wakes."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym import get_suite
from wtg_gym.scenarios.single_turbines import single_and_aggregate, turbine_winds, with_wakes
from wtg_gym.scenarios.wind import (
    group_filter,
    kaimal_spectrum,
    resolved_frequencies,
    rotor_filter,
)

MEAN, SIGMA, N = 9.0, 1.6, 10


def resolved_deviation(n_turbines: float, n_period: int) -> float:
    frequency = resolved_frequencies(n_period)[1:-1]
    spectrum = kaimal_spectrum(frequency, MEAN, SIGMA) * rotor_filter(frequency, MEAN)
    return float(np.sqrt((spectrum * group_filter(frequency, MEAN, n_turbines)).sum() * frequency[0]))


def test_a_turbine_and_the_mean_of_its_group_have_the_spectra_of_the_suites() -> None:
    rng, n_samples = np.random.default_rng(0), 3000
    winds = np.stack([turbine_winds(MEAN, SIGMA, N, n_samples, rng) for _ in range(200)])
    single = np.sqrt(((winds - MEAN) ** 2).mean())
    group = np.sqrt(((winds.mean(axis=1) - MEAN) ** 2).mean())
    assert single == pytest.approx(resolved_deviation(1, 2 * n_samples), rel=0.03)
    assert group == pytest.approx(resolved_deviation(N, 2 * n_samples), rel=0.05)
    assert group < 0.5 * single


def test_the_aggregate_is_the_mean_of_its_turbines() -> None:
    scenario = get_suite("standard").scenario(10000)
    winds = [turbine_winds(8.0, 1.5, 3, 601, np.random.default_rng(seed)) for seed in (1, 2)]
    single, aggregate = single_and_aggregate(scenario, winds)
    assert single.wind_speed.shape == (6, 601) and aggregate.wind_speed.shape == (2, 601)
    assert aggregate.wind_speed[1] == pytest.approx(single.wind_speed[3:].mean(axis=0), abs=1e-12)
    assert single.events == aggregate.events == scenario.events


def test_wakes_slow_the_turbines_behind() -> None:
    winds = turbine_winds(10.0, 1.5, 3, 100, np.random.default_rng(3))
    slowed = with_wakes(winds, (0.0, 0.1, 0.3))
    assert slowed == pytest.approx(winds * np.array([1.0, 0.9, 0.7])[:, None])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: turbine_winds(2.0, 1.0, 3, 10, np.random.default_rng()), ["mean wind", "2", "m/s", "4 … 20"]),
        (lambda: turbine_winds(8.0, 1.0, 0, 10, np.random.default_rng()), ["turbines", "1 … 1000", "0"]),
        (lambda: turbine_winds(8.0, 1.0, 3, 0, np.random.default_rng()), ["samples", "2 … 10000000", "0"]),
        (lambda: turbine_winds(8.0, -1.0, 3, 10, np.random.default_rng()), ["sigma", "-1", "0 … 20"]),
        (lambda: with_wakes(np.full((2, 5), np.nan), (0.1, 0.1)), ["finite", "(2, 5)"]),
        (lambda: with_wakes(np.full((2, 5), 8.0), (0.1,)), ["one wake deficit per turbine", "2", "1"]),
        (lambda: with_wakes(np.full((1, 5), 8.0), (0.9,)), ["wake deficit", "0.9", "0 … 0.6"]),
    ],
)
def test_bad_input_is_named(call: object, words: list[str]) -> None:
    with pytest.raises(ValueError) as error:
        call()  # type: ignore[operator]
    assert all(word in str(error.value) for word in words)
