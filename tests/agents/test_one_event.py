"""Facts about the figure of several controllers in one event: it shows what was played, in MW, and who failed."""

from __future__ import annotations

import dataclasses

import numpy as np
from side_by_side import plot_one_event

from wtg_gym.envs import EnvSettings
from wtg_gym.evaluation import Entry
from wtg_gym.evaluation.recording import record
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.scenarios import get_suite


def test_lines_are_the_runs_and_a_run_that_fails_ends_with_a_cross_at_the_limit() -> None:
    settings = EnvSettings(suite="paper-v1")
    (scenario,) = get_suite("paper-v1").scenarios([0])
    # More than governor and turbines can bear.
    scenario = dataclasses.replace(scenario, events=(LoadStep(time_s=5.0, bus=2, power_mw=200.0),), duration_s=30.0)
    names = ("coordinated-piecewise", "coordinated-tuned")
    runs = {name: record(Entry(name=name, strategy=name), settings, [scenario]) for name in names}
    plant = settings.plant()
    frequency, power, rotor = plot_one_event(scenario, runs, plant).axes
    run = runs["coordinated-piecewise"]
    last = int(np.flatnonzero(np.isfinite(run.frequency_hz[0]))[-1])
    assert last < run.time_s.size - 1
    assert np.array_equal(frequency.lines[0].get_ydata(), run.frequency_hz[0], equal_nan=True)
    # All turbines of 20, 14, 10 and 8 that are rated 5 MW.
    total = run.power_pu[0] @ (5.0 * np.array([20.0, 14.0, 10.0, 8.0]))
    assert np.allclose(power.lines[0].get_ydata(), total, equal_nan=True)
    assert np.array_equal(rotor.lines[0].get_ydata(), run.rotor_speed_pu[0].min(axis=1), equal_nan=True)
    crosses = [line for line in frequency.lines if line.get_marker() not in ("None", None, "")]
    assert len(crosses) == len(runs)
    assert any(np.allclose(line.get_ydata(), 48.5) for line in frequency.lines)
