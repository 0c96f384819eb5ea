"""Balances, agreement with other integrators, and what protections do."""

from dataclasses import replace

import numpy as np
import pytest

from tests.physics.extended import NO_SHEDDING, recorded, scenario, started
from wtg_gym import Plant, get_suite
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.parameters import ConverterLimitParameters, PitchParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES

LAW = STRATEGIES["coordinated-piecewise"]


def test_kinetic_energy_is_what_was_captured_and_not_delivered(simulator):
    simulator.start(0, get_suite("gust").scenario(20_003), (LAW, STRATEGIES["mppt"]))
    before = simulator.wtg_values("rotor_speed")[0]
    recorded(simulator, 30.0)
    gained = 13.0 * (simulator.wtg_values("rotor_speed")[0] - before)
    captured = simulator.wtg_values("energy_captured")[0]
    assert captured - simulator.wtg_values("energy_delivered")[0] == pytest.approx(gained, abs=1e-12)
    assert (captured > 5.0).all()


@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_load_noise_by_rank_one_update_equals_a_full_reduction(simulator, shift):
    # 12 MW of noise at bus 9 from t = 0.1 s on, against the same as a load step of 12 MW.
    results, settings = [], simulator.settings
    first, *others = settings.case.branches
    shifted = replace(settings.case, branches=(replace(first, phase_rad=shift), *others))
    simulator = Simulator(replace(settings, case=shifted))
    for what in (
        scenario(sc.LoadStep(time_s=0.1, bus=9, power_mw=12.0)),
        scenario(load_noise_mw=np.concatenate([[0.0], np.full(40, 12.0)]), load_noise_bus=9),
    ):
        simulator.start(0, what, (LAW, LAW))
        recorded(simulator, 3.0)
        results.append(np.concatenate([simulator.state(), np.abs(simulator.bus_voltages())]))
    assert results[0] == pytest.approx(results[1], abs=1e-12)


def test_load_noise_ends_with_its_series_at_every_control_interval():
    noisy = scenario(duration_s=2.0, load_noise_mw=np.array([0.0, 0.0, 40.0, 40.0]))
    for control_dt in (0.05, 0.1, 0.2):
        noise = started(Plant(control_dt=control_dt), noisy, duration_s=2.0).data.noise[0]
        assert noise.sum() * control_dt == pytest.approx(2 * 40.0 * 0.1)
        assert (noise[round(0.4 / control_dt) :] == 0.0).all()


def test_error_falls_with_the_fourth_power_of_the_step():
    ends, step = {}, sc.LoadStep(time_s=0.2, bus=2, power_mw=75.0, reactive_mvar=20.0)
    for dt in (0.02, 0.01, 0.005, 0.00125):
        run = started(Plant(simulation_dt=dt), scenario(step))
        recorded(run, 2.0)
        ends[dt] = run.wtg_values("speed")[0]
    errors = [np.abs(ends[dt] - ends[0.00125]).max() for dt in (0.02, 0.01, 0.005)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 3.5).all(), orders


@pytest.mark.parametrize("trips", [False, True])
def test_a_stalled_group_ends_the_run_which_then_stands_still_or_is_tripped(trips):
    simulator = Simulator(Plant(trips_groups=trips), duration_s=120.0)
    simulator.start(0, get_suite("paper").scenario(0), (STRATEGIES["mppt"],) * 2)
    recorded(simulator, 100.0)
    if trips:
        assert simulator.lane_values("status")[0] == Status.RUNNING
        assert simulator.lane_values("step")[0] == 1000 * simulator.plant.n_substeps
        assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
        assert simulator.wtg_values("power")[0, 1] == 0.0
        # The others carry the lost group's share at a lower frequency.
        assert 0.98 < simulator.lane_values("coi")[0] < 0.9953
    else:
        assert simulator.lane_values("status")[0] == Status.STALL
        assert simulator.lane_values("step")[0] < 2500.0
        before, peak = simulator.state(), simulator.wtg_values("peak_power")
        simulator.advance()
        assert (simulator.state() == before).all() and (simulator.wtg_values("peak_power") == peak).all()


FAR = ConverterLimitParameters(
    current_max_pu=10.0, power_max_pu=10.0, power_min_pu=-10.0, power_gain=0.0, power_integral_gain=0.0
)
#: Out of reach is the pitch's limit too, which an extended plant lowers by its reserve.
NO_PITCH = PitchParameters(captured_power_limit_pu=10.0)
#: With stages of shedding, as the other extended plants have, so that it is compiled already.
UNLIMITED = Plant(limits=FAR, shedding=NO_SHEDDING, pitch=NO_PITCH)


@pytest.mark.parametrize(
    ("suite", "seed", "strategy", "status"),
    [("paper", 0, "mppt", Status.STALL), ("gust", 10_003, "coordinated-piecewise", Status.RUNNING)],
)
def test_limits_out_of_reach_leave_the_papers_plant_as_it_is(suite, seed, strategy, status):
    what = get_suite(suite).scenario(seed)
    paper, unlimited = (started(plant, what, strategy, what.duration_s) for plant in (Plant(pitch=NO_PITCH), UNLIMITED))
    expected, found = (recorded(run, what.duration_s, "rotor_speed", "power", "emf") for run in (paper, unlimited))
    assert paper.lane_values("status")[0] == unlimited.lane_values("status")[0] == status
    assert all(found[name] == pytest.approx(values, rel=0.0, abs=1e-9) for name, values in expected.items())
    assert unlimited.lane_values("coi_min")[0] == pytest.approx(paper.lane_values("coi_min")[0], abs=1e-11)
