"""The accuracy study: same equations as the simulator's, and the orders of its methods."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.analysis.explicit_methods import CONTROL_DT, METHODS, Integration
from wtg_gym.analysis.step_error import on_the_grid, smooth_order, study_accuracy
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import get_suite

LAW = STRATEGIES["coordinated-piecewise"]


@pytest.mark.parametrize("seed", [10_000, 10_007])
def test_rk4_of_the_study_is_the_simulators_own(seed: int) -> None:
    scenario = on_the_grid(get_suite("standard").scenario(seed))
    run = Integration(scenario, 0.025)
    simulator = Simulator(PlantSettings(control_dt=CONTROL_DT), duration_s=scenario.duration_s)
    simulator.start(0, scenario, (LAW, LAW))
    (method,) = (method for method in METHODS if method.name == "RK4")
    for _ in range(run.n_intervals):
        run.advance_explicit(method)
        simulator.advance()
    assert run.block[run.states] == pytest.approx(simulator.state(), rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_order_on_a_smooth_case_is_the_methods_own(method: object) -> None:
    assert smooth_order(method) == pytest.approx(method.order, abs=0.25)  # type: ignore[arg-type,attr-defined]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_tableaux_are_consistent(method: object) -> None:
    a, b, c = (np.array(getattr(method, name)) for name in "abc")
    assert b.sum() == pytest.approx(1.0)
    assert a.sum(axis=1) == pytest.approx(c)
    assert (np.triu(a) == 0.0).all()


def test_default_step_is_exact_enough_and_errors_fall() -> None:
    study = study_accuracy(2, methods=[m for m in METHODS if m.name in ("Heun", "RK4")], steps=(0.005, 0.02, 0.025))
    chosen = study.row("RK4", 0.025)
    assert study.default_step_s == 0.025
    assert chosen.frequency_hz.max() < 1e-5
    assert chosen.power_pu.max() < 1e-4
    assert study.observed_order("Heun") == pytest.approx(2.0, abs=0.2)
    assert (study.row("RK4", 0.005).frequency_hz < study.row("Heun", 0.005).frequency_hz).all()
    assert chosen.evaluations_per_s == 160.0 and chosen.microseconds_per_s > 0.0


@pytest.mark.parametrize("n", [0, 101])
def test_impossible_numbers_of_scenarios_are_refused(n: int) -> None:
    with pytest.raises(ValueError, match=r"must be 1 … 100"):
        study_accuracy(n)
