"""Balances, agreement with other integrators, what protections do, and what acts in extended plants beyond a limit."""

from dataclasses import replace

import numpy as np
import pytest

from tests.physics import extended
from tests.physics.extended import NO_SHEDDING, recorded, scenario, started
from wtg_gym import LoadStep, Plant, get_suite
from wtg_gym.physics import grid
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.parameters import ConverterLimitParameters, PitchParameters, VoltageControlParameters, WtgGroup
from wtg_gym.physics.plant import layout_of, plant_tables, with_places
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.step import FREE_CURRENTS, LIMITS
from wtg_gym.physics.tracking_law import LAWS
from wtg_gym.physics.units import PAIRS, UNITS, TripCause
from wtg_gym.physics.wtg_unit import EXTENSIONS
from wtg_gym.systems.programs import in_one_table
from wtg_gym.systems.routines import Routine

LAW = LAWS["coordinated-piecewise"]
FAR = ConverterLimitParameters(
    current_max_pu=10.0, power_max_pu=10.0, power_min_pu=-10.0, power_gain=0.0, power_integral_gain=0.0
)
#: Out of reach is the pitch's limit too, which an extended plant lowers by its reserve.
NO_PITCH = PitchParameters(captured_power_limit_pu=10.0)
#: With stages of shedding, as the other extended plants have, so that it is compiled already.
UNLIMITED = Plant(limits=FAR, shedding=NO_SHEDDING, pitch=NO_PITCH)
CURRENTS = in_one_table(CURRENTS=(*FREE_CURRENTS, *LIMITS))
_FIND_CURRENTS = Routine(CURRENTS[0])


def test_kinetic_energy_is_what_was_captured_and_not_delivered(simulator):
    simulator.start(0, get_suite("gust").scenario(20_003), (LAW, LAWS["mppt"]))
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


def test_a_run_that_has_ended_stands_still():
    simulator = started(Plant(), get_suite("paper").scenario(0), "mppt", 120.0)
    recorded(simulator, 100.0)
    assert simulator.env_values("status")[0] == Status.STALL
    assert simulator.env_values("step")[0] < 2500.0
    before, peak = simulator.state(), simulator.wtg_values("peak_power")
    simulator.advance()
    assert (simulator.state() == before).all() and (simulator.wtg_values("peak_power") == peak).all()


@pytest.mark.parametrize(
    ("suite", "seed", "strategy", "status"),
    [("paper", 0, "mppt", Status.STALL), ("gust", 10_003, "coordinated-piecewise", Status.RUNNING)],
)
def test_limits_out_of_reach_leave_the_papers_plant_as_it_is(suite, seed, strategy, status):
    what = get_suite(suite).scenario(seed)
    paper, unlimited = (started(plant, what, strategy, what.duration_s) for plant in (Plant(pitch=NO_PITCH), UNLIMITED))
    expected, result = (recorded(run, what.duration_s, "rotor_speed", "power", "emf") for run in (paper, unlimited))
    assert paper.env_values("status")[0] == unlimited.env_values("status")[0] == status
    assert all(result[name] == pytest.approx(values, rel=0.0, abs=1e-9) for name, values in expected.items())
    assert unlimited.env_values("coi_min")[0] == pytest.approx(paper.env_values("coi_min")[0], abs=1e-11)


@pytest.mark.parametrize(
    ("mvar", "above_pu", "stays_s"),
    [(-150.0, 1.1, 29.0), (-190.0, 1.15, 20.0), (-230.0, 1.2, 2.0), (-330.0, 1.25, 0.2)],
)
def test_a_group_stays_through_the_over_voltages_it_must_and_no_longer(mvar, above_pu, stays_s):
    # A capacitor far too large, where no machine and hardly any group controls its voltage.
    capacitor = LoadStep(time_s=1.0, bus=2, power_mw=0.0, reactive_mvar=mvar)
    case, slow = grid.get_grid("ieee14").case.classical(), VoltageControlParameters(integral_gain=0.01)
    result = extended.recorded(
        extended.started(extended.plant(control_dt=0.1, voltage=slow, case=case), extended.scenario(capacitor)),
        30.0,
        *("terminal_voltage", "connected", "largest_voltage", "trip_cause"),
    )
    voltage, there = result["terminal_voltage"][:, 0], result["connected"][:, 0] > 0.5
    assert 0.1 * there.sum() - 1.0 == pytest.approx(stays_s)
    assert (result["trip_cause"][:, 0] == TripCause.OVER_VOLTAGE * ~there).all()
    assert above_pu < voltage[there][10:].min() and voltage[there].max() < above_pu + 0.05
    assert result["largest_voltage"][-1, 0] == pytest.approx(voltage.max(), rel=1e-3)


@pytest.mark.parametrize("table", [False, True])
@pytest.mark.parametrize("disturbance", ["fault", "load"])
def test_limits_are_held_and_left_without_wind_up(table, disturbance):
    # The hydro governor is slow: under more load the groups lose synchronism.
    load = extended.pulse(2, 160.0, until_s=5.0) if table else extended.pulse(2, 200.0, until_s=11.0)
    events = extended.fault() if disturbance == "fault" else load
    settings = extended.plant(table=table, control_dt=0.025, shedding=extended.NO_SHEDDING)
    simulator = extended.started(settings, extended.scenario(*events, duration_s=180.0), duration_s=180.0)
    start = simulator.state()
    names = ("current", "limiting_reactance", "over_power", "under_power", "internal_voltage", "power")
    result = extended.recorded(simulator, 180.0, *names)
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert (result["limiting_reactance"] > 0.0).any()
    assert result["current"].max() <= extended.CURRENT_MAX * (1.0 + 1e-9)
    control = settings.voltage_control
    assert result["internal_voltage"].max() <= control.internal_voltage_max_pu
    assert result["internal_voltage"].min() >= control.internal_voltage_min_pu
    for name in ("over_power", "under_power"):
        assert np.abs(result[name]).max() < 0.03
        assert (result[name][-1] == 0.0).all()
    # Left at once: no sample later than 0.1 s after the disturbance is limited.
    last = 0.025 * (np.flatnonzero(result["limiting_reactance"].max(axis=1) > 0.0).max() + 1)
    assert last < events[-1].time_s + 0.1
    keep = [i for i, name in enumerate(simulator.layout.state_names) if "energy" not in name and "angle" not in name]
    assert np.abs(simulator.state() - start)[keep].max() < 5e-5


def test_the_reactive_limit_takes_over_and_gives_back():
    simulator = extended.started(
        extended.plant(control_dt=0.025), extended.scenario(*extended.pulse(4, reactive_mvar=60.0, until_s=16.0))
    )
    before = simulator.wtg_values("reactive")[0]
    result = extended.recorded(simulator, 60.0, "reactive", "terminal_voltage")["reactive"]
    assert before == pytest.approx([0.33, 0.33], abs=1e-9)
    assert result.max() > 0.36
    held = result[40 + 20 : 600]
    assert held.max() < 0.3305
    assert result[-1] == pytest.approx(before, abs=1e-5)


@pytest.mark.parametrize(
    "groups",
    [
        tuple(WtgGroup(bus=bus, n_turbines=5.0) for bus in (2, 4, 9, 14)),
        tuple(WtgGroup(bus=14, n_turbines=20.0) for _ in range(4)),
    ],
    ids=["four buses", "a weak bus"],
)
def test_limited_currents_solve_their_equations(groups):
    built = plant_tables(Plant(groups=groups, limits=ConverterLimitParameters()))
    layout, rng = layout_of(built), np.random.default_rng(0)
    built = with_places(built, layout, CURRENTS)
    network = built.network
    unit_y, at, m = np.diag(network.unit_y), network.unit_bus, len(groups)
    n, largest = len(at), extended.CURRENT_MAX * built.share
    n_limited = []
    for _ in range(40):
        bus_y = network.shunts + built.buses["load.re"] - 1j * built.buses["load.im"]
        bus_y[rng.integers(14)] += rng.uniform(0.0, 5.0) - 1j * rng.uniform(0.0, 20.0)
        np.add.at(bus_y, at, network.unit_y)
        full = assemble_admittance(network.branch_ends, network.branch_y, bus_y)
        admittance = unit_y - unit_y @ np.linalg.inv(full)[np.ix_(at, at)] @ unit_y
        angles = np.concatenate([rng.uniform(-0.5, 0.5, n - m), rng.uniform(0.0, 2.8) * rng.uniform(-1.0, 1.0, m)])
        voltage = rng.uniform(0.8, 1.3, n) * np.exp(1j * angles)
        scratch = np.zeros((layout.n_scratch, 1))
        for kind, part, values in ((UNITS, "voltage", voltage), (PAIRS, "admittance", admittance.ravel())):
            first = layout.first_rows(kind, part)
            scratch[first, 0], scratch[first + 1, 0] = values.real, values.imag
        _FIND_CURRENTS((np.zeros((layout.n_rows, 1)), scratch), network.tables)
        first = layout.first_rows(UNITS, "current")
        current = scratch[first, 0] + 1j * scratch[first + 1, 0]
        reactance = scratch[layout.first_rows(EXTENSIONS, "reactance"), 0]
        # I = Y (V - j X I), with X above zero where the current is at its limit, and zero where it is below.
        behind = np.append(np.zeros(n - m), reactance)
        assert current == pytest.approx(admittance @ (voltage - 1j * behind * current), abs=1e-9)
        share = np.abs(current)[n - m :] / largest
        assert (reactance >= 0.0).all() and (share <= 1.0 + 1e-10).all()
        assert share[reactance > 0.0] == pytest.approx(1.0, abs=1e-10)
        n_limited.append(int((reactance > 0.0).sum()))
    assert max(n_limited) == m and min(n_limited) == 0
