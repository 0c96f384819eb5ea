"""Traced numbers: what they come to, and their derivatives, operation by operation."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wtg_gym.systems import expressions as ex
from wtg_gym.systems.tracing import ARITHMETIC, retargeted
from wtg_gym.systems.elementary import exponential, fma, select, sine_cosine
from wtg_gym.physics.parameters import ROTOR_TABLE
from wtg_gym.physics.rotor_table import read_rotor_table, tabulated_power_coefficient

#: Of two numbers, by what traces and by what computes.
FUNCTIONS: dict[str, Any] = {
    "sum": lambda m, a, b: a + 2.0 * b - 3.0 + (1.0 - a),
    "product": lambda m, a, b: a * b * 0.5,
    "quotient": lambda m, a, b: a / b + 2.0 / a,
    "power": lambda m, a, b: 4.0**-a + 1.0 * b,
    "size": lambda m, a, b: abs(a) - abs(-b),
    "bounds": lambda m, a, b: m["min"](a, b) * 3.0 + m["max"](a, 0.5) + m["max"](-1.0, b),
    "root": lambda m, a, b: m["sqrt"](a * a + b * b),
    "waves": lambda m, a, b: m["sine_cosine"](a)[0] * m["sine_cosine"](b)[1],
    "exponential": lambda m, a, b: m["exponential"](-a * b) + m["exponential"](b - 50.0),
    "choice": lambda m, a, b: m["select"]((a > b) | (b >= 2.0), a * a, b) + m["select"]((a < b) & (a <= 9.0), b, 0.0),
    "multiply-add": lambda m, a, b: m["fma"](a, b, a) + m["fma"](0.0, b, a),
    "steps": lambda m, a, b: m["floor"](a) * b + m["ceil"](b) * a,
}
TRACED = {
    "min": ex.smallest,
    "max": ex.largest,
    "sqrt": ex.square_root,
    "sine_cosine": ex.sine_cosine,
    "exponential": ex.exponential,
    "select": ex.select,
    "fma": ex.multiply_add,
    "floor": ex.floor,
    "ceil": ex.ceil,
}
COMPUTED: dict[str, Any] = {
    "min": min,
    "max": max,
    "sqrt": math.sqrt,
    "sine_cosine": sine_cosine,
    "exponential": exponential,
    "select": select,
    "fma": fma,
    "floor": math.floor,
    "ceil": math.ceil,
}
POINTS = [(0.3, 0.8), (1.7, 0.4), (0.9, -1.3), (-0.6, 2.5)]


def worked_out(stores: dict[int, Any], *rows: float, **tables: Any) -> list[float]:
    # Compiled code divides by zero without a word, as numpy's numbers do here.
    names = {"chosen": select, "fma": fma, "sine_cosine": sine_cosine, "exponential": exponential, "inf": math.inf}
    space: dict[str, Any] = {"math": SimpleNamespace(sqrt=np.sqrt, floor=math.floor, ceil=math.ceil), **names, **tables}
    exec(ex.function_source("traced", (), stores), space)
    block = np.array([*rows, *np.zeros(4)])
    with np.errstate(all="ignore"):
        space["traced"](block, (0,))
    return block[len(rows) :].tolist()


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("point", POINTS)
@ex.making()
def test_an_operation_and_its_derivatives(name: str, point: tuple[float, float]) -> None:
    function, h = FUNCTIONS[name], 1e-6
    traced = function(TRACED, ex.row_of_block(0), ex.row_of_block(1))
    slopes = ex.pulled_back([(traced, ex.row_of_block(2))], (0, 1))
    stores = {3: traced, 4: slopes.get(0, 0.0), 5: slopes.get(1, 0.0)}
    value, by_first, by_second, _ = worked_out(stores, *point, 2.0)
    a, b = point
    assert value == pytest.approx(function(COMPUTED, a, b), rel=1e-14)
    first = (function(COMPUTED, a + h, b) - function(COMPUTED, a - h, b)) / h
    second = (function(COMPUTED, a, b + h) - function(COMPUTED, a, b - h)) / h
    assert (by_first, by_second) == pytest.approx((first, second), rel=1e-8, abs=1e-8)


#: Tip-speed ratio and pitch angle [deg] within the table, below its first ratio, and beyond its last one.
@pytest.mark.parametrize(("ratio", "pitch_deg"), [(7.3, 0.2), (5.1, 11.7), (1.2, 3.0), (40.0, 4.4)])
@ex.making()
def test_a_table_of_power_coefficients_is_looked_up_and_has_the_slopes_of_its_surface(
    ratio: float, pitch_deg: float
) -> None:
    grid, cells = read_rotor_table(ROTOR_TABLE).surface()
    whole = {**ARITHMETIC, "np": SimpleNamespace(int64=lambda value: value)}
    traced = retargeted(tabulated_power_coefficient, whole)(
        ex.row_of_block(0), ex.row_of_block(1), ex.Cells(cells.shape), grid
    )
    slopes = ex.pulled_back([(traced, 1.0)], (0, 1))
    found = worked_out({2: traced, 3: slopes[0], 4: slopes[1]}, ratio, pitch_deg, cells=cells)
    h, function = 1e-6, tabulated_power_coefficient.py_func
    ends = [function(ratio + h * a, pitch_deg + h * b, cells, grid) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    expected = [function(ratio, pitch_deg, cells, grid), (ends[0] - ends[1]) / (2 * h), (ends[2] - ends[3]) / (2 * h)]
    assert found[:3] == pytest.approx(expected, rel=1e-7, abs=1e-9)


@ex.making()
def test_what_a_choice_leaves_out_comes_back_as_nothing() -> None:
    """0/0 in the branch not taken would be the gradient else."""
    x = ex.row_of_block(0)
    for guarded in (ex.select(x > 0.0, ex.smallest(x, 5.0) / x, 1.0), ex.select(x > 0.0, ex.square_root(x), 0.0)):
        slope = ex.pulled_back([(guarded, 1.0)], (0,))[0]
        assert worked_out({1: slope}, 0.0)[0] == 0.0


@ex.making()
def test_nothing_is_worked_out_twice() -> None:
    a, b = ex.row_of_block(0), ex.row_of_block(1)
    assert a * b + 1.0 is a * b + 1.0
    assert 0.0 * a == 0.0 and a + 0.0 is a and 1.0 * a is a and ex.select(a > b, a, a) is a


def test_a_branch_on_a_traced_number_is_refused() -> None:
    with pytest.raises(TypeError, match="select"):
        bool(ex.row_of_block(0) > 1.0)
