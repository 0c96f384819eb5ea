"""The numbers that count, against functions counted by hand."""

from __future__ import annotations

import numpy as np

from wtg_gym.benchmarks.counting import Counted, Counts, Rows, count, count_operations, counted


def test_a_small_function_is_counted_as_by_hand() -> None:
    a, b = Counted(3.0), Counted(2.0)
    result: list[Counted] = []

    def work() -> None:
        result.append((1.0 - a / b + 2 * a * b) ** 3)

    # 1 - …, … + …; 2 · a, … · b and two for the cube; one division.
    assert count(work) == Counts(adds=2, multiplies=4, divisions=1)
    assert float(result[0]) == (1.0 - 1.5 + 12.0) ** 3


def test_choices_are_comparisons_and_signs_are_free() -> None:
    a, b = Counted(3.0), Counted(-2.0)
    results: list[float] = []
    counts = count(lambda: results.extend([float(min(a, 1.0)), float(max(abs(b), -a))]))
    assert results == [1.0, 2.0]
    assert counts == Counts(comparisons=2) and counts.flops == 0


def test_numbers_of_numpy_do_not_hide_operations() -> None:
    a = Counted(3.0)
    assert count(lambda: np.float64(2.0) * a + np.float64(1.0)) == Counts(adds=1, multiplies=1)
    assert count(lambda: 2.0**a) == Counts(powers=1)


def test_rows_count_loads_and_stores() -> None:
    rows = Rows(np.array([1.0, 2.0]))

    def work() -> None:
        rows[0] += rows[1]

    counts = count(work)
    assert counts == Counts(adds=1, loads=2, stores=1)
    assert counts.bytes == 24 and float(rows[0]) == 3.0


def test_counted_keeps_what_is_no_floating_point_number() -> None:
    assert counted(3) == 3
    assert counted(np.array([1, 2])).dtype == np.int64
    assert isinstance(counted(np.array([[1.0]]))[0, 0], Counted)


def test_right_hand_side_of_the_default_plant() -> None:
    counts = count_operations()
    derivatives = counts["right-hand side"]
    # The terminal voltage of each of four machines.
    assert derivatives.roots == 4
    # Six units' currents alone: four multiplies and adds each for 36 complex products with their sums.
    assert derivatives.multiplies > 4 * 36 and derivatives.adds > 4 * 36
    assert counts["control interval"].roots == 21 * 4
    assert counts["environment step"].flops > counts["control interval"].flops
