"""Policies on converters with limits."""

from __future__ import annotations

import pytest

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.limited_converters import limited_table, play_limited
from wtg_gym.physics.protection import Status
from wtg_gym.policies.load import load_entries
from wtg_gym.policies.play import play, started_lanes


def test_limits_cut_the_peaks_and_their_absence_changes_nothing() -> None:
    (entry,) = load_entries("linear-feedback")
    free, limited = (play_limited(entry, "gust", 50, limited=limited) for limited in (False, True))
    with started_lanes(entry, EnvSettings(suite="gust", split="validation"), list(range(10_000, 10_050))) as (lanes, _):
        cost = 0.0
        for running in play(entry, lanes):
            cost -= float(lanes.rewards[running].sum())
        peak = lanes.simulator.wtg_values("peak_power").max()
        failures = (lanes.simulator.lane_values("status") != Status.RUNNING).sum()
    assert free.cost == pytest.approx(cost / 50.0, rel=1e-6)
    assert free.peak_power_pu == pytest.approx(peak, abs=1e-6) and free.failures == failures
    assert free.peak_power_pu > 1.3 > limited.peak_power_pu > 1.1
    assert limited.overload_time_s < free.overload_time_s
    assert f"| {free.peak_power_pu:.2f}/{limited.peak_power_pu:.2f} |" in limited_table([free, limited], "gust")
