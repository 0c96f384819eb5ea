"""Groups against their single turbines."""

from __future__ import annotations

import dataclasses

import pytest

from wtg_gym.analysis.aggregation_study import totals_of
from wtg_gym.physics.parameters import default_groups
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.scenarios import get_suite


def test_energies_are_those_of_whole_runs_only() -> None:
    calm = dataclasses.replace(get_suite("paper").scenario(0), events=(), duration_s=20.0)
    lost = dataclasses.replace(calm, name="lost", events=(LoadStep(time_s=5.0, bus=4, power_mw=2000.0),))
    whole = totals_of([calm, calm], "mppt", default_groups(), "paper")
    # Nothing happens: each group captures the most there is, 1.0172 p.u. at 11.4 m/s, at 8 m/s less by the wind's cube.
    assert whole.energy_pu_s == pytest.approx([20.0 * 1.0172 * (1.0 + (8.0 / 11.4) ** 3) / 2.0] * 2, rel=1e-3)
    with pytest.raises(ValueError, match=r"of 2 runs under mppt 1 end early: \w[\w ]+ \(1\)"):
        totals_of([calm, lost], "mppt", default_groups(), "paper")
