"""The numbers that count, against functions counted by hand."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from wtg_gym.analysis.benchmarks.counting import Counted, Counts, Rows, count, count_operations, counted


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
    assert counts["control interval"].roots == 17 * 4
    assert counts["environment step"].flops > counts["control interval"].flops


_SAME_BITS = """
import numpy as np
from wtg_gym.analysis.benchmarks.counting import Rows, instrument, counted
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task import step_blocks
from wtg_gym.physics.scenario import Scenario

lanes = TaskLanes(EnvSettings(duration_s=2.0))
lanes.start([0], [Scenario(name="calm", wind_speed=np.array([[11.4], [8.0]]), duration_s=2.0)])
simulator, actions = lanes.simulator, np.full((1, lanes.n_action), 0.1)
before = simulator.blocks[0].copy()

def step(block, *given):
    step_blocks([block], 0, 1, *given, lanes.outputs, simulator.lanes)
    return [float(block[i]) for i in range(block.shape[0])], float(lanes.outputs.rewards[0])

given = simulator.plant, simulator.data, lanes.task, actions
plain = step(before.copy(), *given)
instrument()
assert step(Rows(before), *map(counted, given)) == plain
assert plain[1] < 0.0
"""


def test_counting_changes_no_bit_of_the_result() -> None:
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    done = subprocess.run([sys.executable, "-c", _SAME_BITS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
