"""Plants that add physics to the paper's: they differ from the simulator's own in that alone."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from docs.studies.small_signal import compare, infinite_bus
from tests.golden_cases import GOLDEN
from wtg_gym.analysis.case_file import read_parameters
from wtg_gym.analysis.load_models import run_with_loads
from wtg_gym.analysis.physics_study import count_suite
from wtg_gym.analysis.plant_forms import HONEST, NREL, PAPER, UNLIMITED, PlantRun, plant_forms, rotor_energy, run_plant
from wtg_gym.analysis.voltage_limits import VOLTAGE_LIMIT_PU, voltage_feedback, voltage_limits
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.modes import linearise, synchronising_coefficients
from wtg_gym.physics.parameters import ProtectionParameters, TurbineParameters, VoltageControlParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.reproduce.loops import single_machine, with_moving_voltage
from wtg_gym.scenarios import get_suite

_INERTIA_S = TurbineParameters().inertia_constant_s


@functools.cache
def _run(form: str, scenario: Scenario, strategy: str) -> PlantRun:
    (run,) = run_plant(plant_forms()[form], [scenario], strategy)
    assert run is not None
    return run


@pytest.mark.parametrize(
    ("suite", "seed", "strategy"),
    [("paper", 0, "mppt"), ("paper", 1, "deloaded-10"), ("gust", 10_003, "coordinated-piecewise")],
)
def test_the_papers_form_does_what_the_papers_plant_does(suite: str, seed: int, strategy: str) -> None:
    scenario, law = get_suite(suite).scenario(seed), STRATEGIES[strategy]
    run = _run(PAPER, scenario, strategy)
    simulator = Simulator(PlantSettings(control_dt=0.025), duration_s=scenario.duration_s)
    simulator.start(0, scenario, (law, law))
    least = simulator.wtg_values("rotor_speed")[0]
    peak = simulator.wtg_values("power")[0]
    for _ in range(simulator.n_intervals):
        simulator.advance()
        least = np.minimum(least, simulator.wtg_values("rotor_speed")[0])
        peak = np.maximum(peak, simulator.wtg_values("power")[0])
    assert run.status == simulator.lane_values("status")[0]
    assert run.end_s == pytest.approx(0.025 * simulator.lane_values("step")[0])
    assert run.times_s[-1] == pytest.approx(run.end_s)
    assert run.nadir_hz == pytest.approx(50.0 * simulator.lane_values("coi_min")[0], abs=1e-9)
    assert run.rotor_pu[-1] == pytest.approx(simulator.wtg_values("rotor_speed")[0], abs=1e-9)
    assert run.power_pu.max(axis=0) == pytest.approx(peak, abs=1e-9)
    assert run.rotor_pu.min(axis=0) == pytest.approx(least, abs=1e-9)
    assert run.internal_pu == pytest.approx(np.broadcast_to(simulator.wtg_values("emf")[0], run.internal_pu.shape))


@pytest.mark.parametrize("strategy", ["coordinated-piecewise", "mppt"])
def test_each_rotor_releases_the_energy_of_its_equation(strategy: str) -> None:
    scenario = get_suite("standard").scenario(10_001)
    consistent, papers = (_run(form, scenario, strategy) for form in ("rotor energy", PAPER))
    before, after = consistent.rotor_pu[[0, -1]]
    assert consistent.released_s == pytest.approx(_INERTIA_S * (before**2 - after**2), abs=1e-6)
    before, after = papers.rotor_pu[[0, -1]]
    assert papers.released_s == pytest.approx(2.0 * _INERTIA_S * (before - after), abs=1e-9)
    assert not np.allclose(papers.released_s, consistent.released_s, atol=1e-3)


@pytest.mark.parametrize("form", ["rotor energy", "dead band", HONEST])
def test_rotors_stall_earlier_and_in_the_papers_order(form: str) -> None:
    scenario = get_suite("paper").scenario(0)
    ends = []
    for name in ("mppt", "deloaded-5", "deloaded-10"):
        run = _run(form, scenario, name)
        assert run.status == Status.STALL
        assert run.end_s < _run(PAPER, scenario, name).end_s
        ends.append(run.end_s)
    assert ends == sorted(ends)
    assert _run(form, scenario, "coordinated-piecewise").status == Status.RUNNING


def test_the_presets_are_those_that_users_choose_and_all_together_lacks_trip_and_shedding_only() -> None:
    forms = plant_forms()
    for name, together in (("extended", HONEST), ("nrel-5mw", NREL)):
        assert forms[name] == EnvSettings(physics=name, version="v0").plant()
        lacking = dataclasses.replace(forms[name], protection=ProtectionParameters(), shedding=())
        assert forms[together] == lacking != forms[name]


def test_limits_hold_power_and_current() -> None:
    scenario = get_suite("paper").scenario(0)
    limited, free = (_run(form, scenario, "coordinated-piecewise") for form in ("current and power limits", PAPER))
    assert free.power_pu.max() > 1.25 and free.current_pu.max() > 1.2
    assert limited.power_pu.max() < 1.15 and limited.current_pu.max() <= 1.2 + 1e-9


def test_a_run_cut_off_keeps_what_came_before() -> None:
    run = _run(PAPER, get_suite("paper").scenario(0), "coordinated-piecewise")
    first = run.until(30.0)
    assert first.times_s[-1] == pytest.approx(29.975)
    assert first.nadir_hz == run.frequency_hz[:1200].min() > run.nadir_hz
    rates = np.abs(np.diff(run.frequency_hz[::20])) / 0.5
    assert rates.max() <= run.rocof_hz_s < 1.1 * rates.max()


def test_papers_equation_credits_too_much_below_rated_speed_and_too_little_above() -> None:
    slow, fast = rotor_energy(8.0, 0.996), rotor_energy(11.4, 0.996)
    assert slow.credited_s / slow.stored_s == pytest.approx(2.0 / (slow.before_pu + slow.after_pu))
    assert slow.credited_s > slow.stored_s
    assert fast.credited_s < fast.stored_s


def test_counts_are_those_of_the_runs() -> None:
    counts = count_suite(PlantSettings(limits=UNLIMITED), "low-wind", "mppt", 5)
    scenarios: list[Scenario] = get_suite("low-wind").scenarios(list(range(10_000, 10_005)))
    law = STRATEGIES["mppt"]
    assert counts.n_scenarios == 5 and counts.refused == 0
    assert counts.failures == sum(simulate(scenario, law).status == Status.STALL for scenario in scenarios)
    least = min(float(simulate(scenario, law).rotor_speed_pu.min()) for scenario in scenarios)
    # At every simulation step, where the recording has one sample in four.
    assert least - 0.01 < counts.least_rotor_pu <= least + 1e-9


def test_a_start_that_a_plant_refuses_is_counted() -> None:
    narrow = VoltageControlParameters(internal_voltage_max_pu=1.2)
    runs = run_plant(PlantSettings(voltage_control=narrow), [get_suite("paper").scenario(0)] * 2, "mppt")
    assert runs == [None, None]


def test_limited_start_holds_every_internal_voltage_at_the_limit_or_below() -> None:
    held, limited = voltage_limits(get_suite("paper").scenario(0))
    assert held.voltage_pu.max() > 1.3
    assert limited.voltage_pu.max() == pytest.approx(VOLTAGE_LIMIT_PU, abs=1e-4)
    assert limited.bus_voltage_pu < held.bus_voltage_pu
    assert (limited.synchronising_coefficient < held.synchronising_coefficient).all()


@pytest.mark.parametrize("side", ["under", "over"])
def test_the_loop_of_a_rotor_that_keeps_its_energy_has_the_simulators_poles(side: str) -> None:
    settings = dataclasses.replace(infinite_bus(), turbine=TurbineParameters(conserves_energy=True))
    law = STRATEGIES["coordinated-piecewise"]
    assert compare(law, 8.0, side, settings)[1] < 1e-6
    # The paper's loop has others.
    paper = single_machine(law, 8.0).closed_loop_poles()
    ours = single_machine(law, 8.0, turbine=settings.turbine).closed_loop_poles()
    assert np.abs(paper - ours).max() > 0.01


def test_the_loop_with_voltage_control_has_the_simulators_poles() -> None:
    settings = dataclasses.replace(infinite_bus(), voltage_control=VoltageControlParameters())
    scenario = Scenario(name="infinite bus", wind_speed=np.array([[8.0]]), load_noise_bus=1)
    law = STRATEGIES["coordinated-piecewise"]
    k_p = float(synchronising_coefficients(scenario, law, settings)[0, 0])
    simulator = Simulator(settings, duration_s=60.0)
    simulator.start(0, scenario, (law,))
    effect, decay = voltage_feedback(simulator, 0)
    assert effect != 0.0 and decay > 0.0
    poles = with_moving_voltage(single_machine(law, 8.0, k_p), effect, decay).closed_loop_poles()
    found = np.linalg.eigvals(linearise(scenario, law, settings).matrix)
    for pole in poles:
        assert np.abs(found - pole).min() < 1e-5 * abs(pole)


def test_loads_of_constant_power_cost_nadir_voltage_and_time() -> None:
    scenario = get_suite("paper").scenario(0)
    impedance, current, power = (
        run_with_loads(f"constant {model}", scenario, "mppt") for model in ("impedance", "current", "power")
    )
    simulated = simulate(scenario, STRATEGIES["mppt"])
    assert impedance.end_s == pytest.approx(simulated.time_s[-1], abs=0.1)
    assert impedance.nadir_hz == pytest.approx(float(simulated.frequency_hz.min()), abs=1e-4)
    assert impedance.nadir_hz > current.nadir_hz + 0.01 > power.nadir_hz + 0.02
    assert impedance.least_voltage_pu > current.least_voltage_pu > power.least_voltage_pu
    assert impedance.end_s > current.end_s > power.end_s
    finer = run_with_loads("constant power", scenario, "mppt", simulation_dt=0.0125)
    assert finer.nadir_hz == pytest.approx(power.nadir_hz, abs=5e-4)


@pytest.mark.parametrize(("model", "nadir_hz"), [("impedance", 49.7356), ("current", 49.7172), ("power", 49.6908)])
def test_loads_of_other_kinds_have_the_nadir_of_another_simulator(model: str, nadir_hz: float) -> None:
    """ANDES' nadirs in the events of the golden case `genrou`, of `tests/golden/measure_andes_only.py`."""
    case = read_parameters(GOLDEN / "genrou" / "params.json")
    scenario = Scenario(
        name="golden", wind_speed=np.zeros((0, 1)), events=case.events["a"], duration_s=60.0, load_noise_bus=1
    )
    settings = PlantSettings(case=case.network, groups=())
    run = run_with_loads(f"constant {model}", scenario, "mppt", settings, simulation_dt=0.005)
    assert run.nadir_hz == pytest.approx(nadir_hz, abs=2e-4)
