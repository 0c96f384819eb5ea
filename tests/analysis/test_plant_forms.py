"""Measurements of what the paper's model leaves out: they differ from the simulator in that alone."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.analysis.omissions import count_suite, rotor_energy, run_rotors
from wtg_gym.analysis.voltage_limits import VOLTAGE_LIMIT_PU, voltage_limits
from wtg_gym.physics.layout import Status
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.scenarios import get_suite

_INERTIA_S = TurbineParameters().inertia_constant_s


@pytest.mark.parametrize(
    ("suite", "seed", "strategy"),
    [("paper", 0, "mppt"), ("paper", 1, "deloaded-10"), ("gust", 10_003, "coordinated-piecewise")],
)
def test_run_with_the_papers_rotor_is_the_simulators(suite: str, seed: int, strategy: str) -> None:
    scenario, law = get_suite(suite).scenario(seed), STRATEGIES[strategy]
    run = run_rotors([scenario], law, energy=False)[0]
    simulator = Simulator(PlantSettings(control_dt=0.025), duration_s=scenario.duration_s)
    simulator.start(0, scenario, (law, law))
    least = simulator.wtg_values("rotor_speed")[0]
    for _ in range(simulator.n_intervals):
        simulator.advance()
        least = np.minimum(least, simulator.wtg_values("rotor_speed")[0])
    assert run.status == simulator.lane_values("status")[0]
    assert run.end_s == pytest.approx(0.025 * simulator.lane_values("step")[0])
    assert run.nadir_hz == pytest.approx(50.0 * simulator.lane_values("coi_min")[0], abs=1e-9)
    assert run.rotor_pu[1] == pytest.approx(simulator.wtg_values("rotor_speed")[0], abs=1e-9)
    assert run.peak_power_pu == pytest.approx(simulator.wtg_values("peak_power")[0], abs=1e-9)
    assert run.least_rotor_pu == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("strategy", ["coordinated-piecewise", "mppt"])
def test_each_rotor_releases_the_energy_of_its_equation(strategy: str) -> None:
    scenario = get_suite("standard").scenario(10_001)
    law = STRATEGIES[strategy]
    consistent, papers = (run_rotors([scenario], law, energy=energy)[0] for energy in (True, False))
    before, after = consistent.rotor_pu
    assert consistent.released_s == pytest.approx(_INERTIA_S * (before**2 - after**2), abs=1e-6)
    before, after = papers.rotor_pu
    assert papers.released_s == pytest.approx(2.0 * _INERTIA_S * (before - after), abs=1e-9)
    assert not np.allclose(papers.released_s, consistent.released_s, atol=1e-3)


def test_energy_consistent_rotor_stalls_earlier_and_keeps_the_papers_order() -> None:
    scenario = get_suite("paper").scenario(0)
    ends = []
    for name in ("mppt", "deloaded-5", "deloaded-10"):
        run = run_rotors([scenario], STRATEGIES[name], energy=True)[0]
        assert run.status == Status.STALL
        assert run.end_s < run_rotors([scenario], STRATEGIES[name], energy=False)[0].end_s
        ends.append(run.end_s)
    assert ends == sorted(ends)
    assert run_rotors([scenario], STRATEGIES["coordinated-piecewise"], energy=True)[0].status == Status.RUNNING


def test_papers_equation_credits_too_much_below_rated_speed_and_too_little_above() -> None:
    slow, fast = rotor_energy(8.0, 0.996), rotor_energy(11.4, 0.996)
    assert slow.credited_s / slow.stored_s == pytest.approx(2.0 / (slow.before_pu + slow.after_pu))
    assert slow.credited_s > slow.stored_s
    assert fast.credited_s < fast.stored_s


def test_counts_are_those_of_the_runs() -> None:
    counts = count_suite("low-wind", "mppt", 5)
    scenarios: list[Scenario] = get_suite("low-wind").scenarios(list(range(10_000, 10_005)))
    law = STRATEGIES["mppt"]
    assert counts.n_scenarios == 5
    assert counts.stalls == sum(simulate(scenario, law).status == Status.STALL for scenario in scenarios)
    least = min(float(simulate(scenario, law).rotor_speed_pu.min()) for scenario in scenarios)
    # At every simulation step, where the recording has one sample in four.
    assert least - 0.01 < counts.least_rotor_pu <= least + 1e-9


def test_limited_start_holds_every_internal_voltage_at_the_limit_or_below() -> None:
    held, limited = voltage_limits(get_suite("paper").scenario(0))
    assert held.voltage_pu.max() > 1.3
    assert limited.voltage_pu.max() == pytest.approx(VOLTAGE_LIMIT_PU, abs=1e-4)
    assert limited.bus_voltage_pu < held.bus_voltage_pu
    assert (limited.synchronising_coefficient < held.synchronising_coefficient).all()
