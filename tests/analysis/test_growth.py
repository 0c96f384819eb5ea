"""Exponents, shares and sentences from made-up costs; plants of other sizes."""

from __future__ import annotations

import math

import pytest

from wtg_gym.analysis.benchmarks.growth import ALL_GROUPS, Curve, Point, describe_growth, growth_cases
from wtg_gym.analysis.benchmarks.plant_sizes import network_with_machines
from wtg_gym.physics.ieee14 import modified_ieee14


def curve(name: str, cost: dict[int, float]) -> Curve:
    return Curve(name, tuple(Point(n, value, 0.0, 1e4) for n, value in cost.items()))


def test_exponent_of_a_power_law() -> None:
    assert curve("groups", {n: 2.0 * n**1.5 for n in (1, 2, 4, 8)}).exponent == pytest.approx(1.5)
    assert curve("threads", {1: 4.0, 2: 2.0}).exponent == pytest.approx(-1.0)
    assert math.isnan(curve("groups", {2: 1.0}).exponent)


def test_share_of_the_square() -> None:
    assert curve("groups", {n: 5.0 + 2.0 * n for n in ALL_GROUPS}).quadratic_share == pytest.approx(0.0, abs=1e-9)
    grown = curve("groups", {n: 100.0 + 50.0 * n + 1.0 * n * n for n in (1, 10, 50, 100)})
    assert grown.quadratic_share == pytest.approx(10_000 / 15_100)


def test_sentences_hold_the_numbers() -> None:
    groups, lanes, threads, single = describe_growth(
        [
            curve("groups", {n: 1.0 * n for n in (1, 2, 4, 8)}),
            curve("lanes", {1: 20.0, 16: 2.5, 64: 2.0, 1024: 4.0}),
            curve("threads", {1: 4.0, 4: 1.25}),
            curve("machines", {4: 1.0, 8: 3.0}),
            curve("machines", {4: 1.0}),
        ]
    )
    assert "from 1 to 8 a step costs 8 times as much" in groups and "power of 1.00" in groups
    assert "20 µs alone and 4 µs in a batch of 1024, 5.0 times less" in lanes and "2 µs, at 64 lanes" in lanes
    assert "4 are 3.20 times as fast as one" in threads and "80 % of the ideal" in threads
    assert "3 times as much" in single and "fit" not in single


def test_machines_are_split_at_their_buses() -> None:
    split, whole = network_with_machines(12), modified_ieee14()
    assert [machine.bus for machine in split.machines] == [1, 1, 1, 3, 3, 3, 6, 6, 6, 8, 8, 8]
    rating = sum(machine.rating_mva for machine in whole.machines)
    assert sum(machine.rating_mva for machine in split.machines) == pytest.approx(rating)
    for wrong in (0, 2, 6):
        with pytest.raises(ValueError, match=f"must be a multiple of 4, got {wrong}"):
            network_with_machines(wrong)


def test_full_growth_goes_to_the_largest_plants() -> None:
    sizes = {name: [n for n, _ in cases] for name, cases in growth_cases(full=True).items()}
    assert sizes["groups"] == sizes["groups, single"] == [1, 2, 4, 8, 16, 32, 64, 128]
    assert sizes["machines"][-1] == 128 and sizes["lanes"][-1] == 16384
    assert growth_cases(full=False)["groups"][-1][0] == 16
