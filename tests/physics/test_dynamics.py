"""Equilibria, balances, agreement with other integrators, what protections do, and what acts beyond a limit."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.machine_code import run_routine
from tests.physics import extended
from tests.physics.extended import NO_SHEDDING, largest_rate, plant, recorded, scenario, started, with_machine
from wtg_gym import LoadStep, Plant, TrackingLaw, get_law, get_suite
from wtg_gym.physics import parameters
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.linearisation import largest_stable_steps, moving_matrix
from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.plant import layout_of, plant_tables, with_places
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.step import FREE_CURRENTS, LIMITS
from wtg_gym.physics.tracking_law import LAWS
from wtg_gym.physics.units import PAIRS, UNITS, TripCause
from wtg_gym.physics.wtg_unit import EXTENSIONS
from wtg_gym.systems.programs import numbered
from wtg_gym.systems.routines import Routine

LAW = LAWS["coordinated-piecewise"]
PAIR = (LAW,) * 2
FAR = parameters.ConverterLimitParameters(
    current_max_pu=10.0, power_max_pu=10.0, power_min_pu=-10.0, power_gain=0.0, power_integral_gain=0.0
)
#: Out of reach is the pitch's limit too, which an extended plant lowers by its reserve.
NO_PITCH = parameters.PitchParameters(captured_power_limit_pu=10.0)
#: With stages of shedding, as the other extended plants have, so that it is compiled already.
UNLIMITED = Plant(limits=FAR, shedding=NO_SHEDDING, pitch=NO_PITCH)
CURRENTS = numbered(CURRENTS=(*FREE_CURRENTS, *LIMITS))
_FIND_CURRENTS = Routine(CURRENTS[0])
LIMIT = 1e-8
TOO_STEEP = [
    # The slope below ω_st is what is fast, but only once the wind has risen: it acts on the cube of the speed.
    (2.0, 3.0, 0.6, 0.55, 5.0),
    # The steeper slope takes power away while the frequency falls; the other one is what is fast.
    (0.7, 0.05, 0.9, 0.2, 16.0),
]
OVER_VOLTAGES = [(-150.0, 1.1, 29.0), (-190.0, 1.15, 20.0), (-230.0, 1.2, 2.0), (-330.0, 1.25, 0.2)]
PLAYED = [("paper", 0, "mppt", Status.STALL), ("gust", 10_003, "coordinated-piecewise", Status.RUNNING)]
FAST_VOLTAGE = parameters.VoltageControlParameters(integral_gain=1000.0)
TOO_FAST = [
    (Plant(case=with_machine(t_d0_subtransient_s=0.009)), r"eigenvalue -11\d.*mainly sync0.psi_1d.* at most 0.022"),
    (plant(voltage=FAST_VOLTAGE), r"eigenvalue -98\d.* 1/s \(mainly wtg[01].internal_voltage\) .* at most 0.0027 s"),
    # It switches at 0.5 p.u. a step once the power exceeds its limit.
    (plant(limits=parameters.ConverterLimitParameters(power_gain=1.0)), r"mainly wtg[01].angle\)"),
]


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_no_state_moves_at_the_start_at_any_wind(simulator, law):
    for wind in np.linspace(6.0, 13.0, 20):
        simulator.start(0, scenario(wind=[[wind], [19.0 - wind]]), (law, law))
        assert largest_rate(simulator) <= LIMIT, f"{wind:g} m/s"


def test_above_rated_the_pitch_holds_the_captured_power_at_its_limit_and_below_it_rests(simulator):
    for low, high in ((3.0, 12.0), (8.0, 15.0), (11.4, 24.0)):
        simulator.start(0, scenario(wind=[[low], [high]]), PAIR)
        assert largest_rate(simulator) <= LIMIT
        below, above = simulator.wtg_values("pitch")[0]
        assert below == 0.0 and above > 0.0
        assert simulator.wtg_values("captured")[0, 1] == pytest.approx(1.05, abs=1e-9)


def test_other_groups_machine_models_resistance_and_shared_buses_start_at_rest():
    groups = parameters.WtgGroup(bus=3), parameters.WtgGroup(bus=14, n_turbines=2.0)
    case = get_grid("ieee14").case
    for own in (case, case.classical()):
        settings = Plant(case=own, groups=groups)
        assert largest_rate(started(settings, scenario(wind=[[9], [9]]), "mppt")) <= LIMIT
    machines = [replace(machine, resistance=0.003) for machine in case.machines]
    # In the place of the last one: as many machines as usual, whose code is compiled already.
    case = replace(case, machines=(*machines[:-1], extended.classical(bus=3, dispatch_mw=20.0)))
    assert len({machine.bus for machine in case.machines}) < len(case.machines)
    result = started(Plant(case=case), scenario(wind=[[9.0], [9.0]]), "coordinated-linear")
    assert largest_rate(result) <= LIMIT


@pytest.mark.parametrize("table", [False, True])
def test_with_any_options_no_state_moves_at_the_start_which_is_stable(table):
    for limits, voltage, energy in extended.OPTIONS:
        settings = plant(table=table, limits=limits, voltage=voltage, energy=energy, dead_band=2e-4)
        simulator = Simulator(settings)
        laws = (get_law(extended.LAW, settings.turbine),) * 2
        for winds in ((6.0, 13.0), (8.0, 8.0), (11.4, 8.0), (12.0, 5.0), (16.0, 16.0), (24.0, 9.0)):
            for level in (0.7, 1.0, 1.2):
                simulator.start(0, scenario(wind=np.array([winds]).T, load_level=level), laws)
                assert largest_rate(simulator) <= 1e-8, (limits, voltage, energy, winds, level)
        # Without a dead band, within which a governor does nothing.
        simulator = Simulator(plant(table=table, limits=limits, voltage=voltage, energy=energy))
        for wind in (8.0, 11.0, 16.0):
            simulator.start(0, scenario(wind=[[wind], [8.0]]), laws)
            for side in (-1.0, 1.0):
                matrix, _ = moving_matrix(simulator.blocks[0, :, 0], simulator.plant, simulator.layout, side)
                assert np.linalg.eigvals(matrix).real.max() < -0.03


@pytest.mark.parametrize(("level", "sign"), [(1.2, 1.0), (0.5, -1.0)])
def test_a_bus_lets_go_of_its_voltage_where_the_groups_reactive_power_does_not_suffice(level, sign):
    result = {}
    for limit in (1.0, 0.04, 0.0):
        control = parameters.VoltageControlParameters(reactive_max_pu=limit, internal_voltage_max_pu=1.6)
        simulator = started(plant(limits=False, voltage=control), scenario(load_level=level))
        assert largest_rate(simulator) <= 1e-8
        held = np.abs(simulator.bus_voltages()[1]) - 1.045
        result[limit] = sign * simulator.wtg_values("reactive")[0], sign * held
    (ample, held), *scarce = result.values()
    assert (ample > 0.04).all() and (ample < 1.0).all() and held == pytest.approx(0.0, abs=1e-12)
    for limit, (reactive, deviation) in zip((0.04, 0.0), scarce, strict=True):
        assert reactive == pytest.approx(limit, abs=1e-11)
        assert deviation < -1e-4


@pytest.mark.parametrize(("table", "energy"), [(False, False), (False, True), (True, False), (True, True)])
def test_rotor_and_converter_keep_their_balances_in_rough_runs(table, energy):
    settings = plant(table=table, energy=energy, dead_band=2e-4)
    inertia = settings.turbine.inertia_constant_s
    chopped = 0.0
    for seed in range(8):
        simulator = started(settings, extended.rough(seed))
        before = simulator.wtg_values("rotor_speed")[0]
        assert recorded(simulator, 30.0, "current")["current"].max() <= extended.CURRENT_MAX * (1.0 + 1e-9)
        after = simulator.wtg_values("rotor_speed")[0]
        names = ("energy_captured", "energy_delivered", "energy_chopped")
        captured, delivered, burnt = (simulator.wtg_values(name)[0] for name in names)
        chopped = max(chopped, burnt.max())
        # A Runge-Kutta method keeps sums of rates exactly, so the paper's momentum; the energy H ω² is set from them.
        stored = after**2 - before**2 if energy else 2.0 * (after - before)
        assert captured - delivered - burnt == pytest.approx(inertia * stored, abs=1e-12)
    assert chopped > 0.001


@pytest.mark.parametrize("value", [-40.0 + 0j, -8.9 + 46j, -0.2 + 17j])
def test_a_mode_grows_just_beyond_its_largest_step_and_not_just_below(value):
    limit = float(largest_stable_steps(np.array([value])).min())
    # What a step of the classical Runge-Kutta method multiplies by: the exponential series up to its fourth power.
    below, beyond = (abs(sum((s * limit * value) ** n / math.factorial(n) for n in range(5))) for s in (0.999, 1.001))
    assert below < 1.0 < beyond


@pytest.mark.parametrize(("settings", "message"), TOO_FAST)
def test_a_plant_that_is_too_fast_for_the_step_is_refused(settings, message):
    with pytest.raises(ValueError, match=r"simulation_dt = 0.025 s is too long for this plant.*" + message):
        Simulator(settings)


def test_an_inertia_that_is_too_small_for_the_step_is_refused_with_its_scenario_but_not_in_the_default_plant():
    simulator = Simulator(Plant(case=with_machine(two_h_s=0.5)))
    light, lighter = (scenario(inertia_scale=scale) for scale in (0.3, 0.05))
    simulator.prepare([light], PAIR)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"scenario 'x', inertia_scale = 0.05: simulation_dt = 0.025 s"):
            simulator.prepare([light, lighter], PAIR)
    simulator.prepare([light], PAIR)
    Simulator(Plant(simulation_dt=0.04, interval_s=0.2)).prepare([lighter], PAIR)
    Simulator(Plant(simulation_dt=0.05)).prepare([scenario()], PAIR)


@pytest.mark.parametrize(("inertia_s", "k_min", "k_nominal", "k_max", "wind_m_s"), TOO_STEEP)
def test_a_law_that_is_too_steep_for_the_step_is_refused(inertia_s, k_min, k_nominal, k_max, wind_m_s):
    law = TrackingLaw(name="steep", k_min=k_min, k_nominal=k_nominal, k_max=k_max)
    what = scenario(wind=np.full((2, 1), wind_m_s))
    light = Plant(control=parameters.GridFormingParameters(inertia_constant_s=inertia_s))
    with pytest.raises(ValueError, match=r"\(mainly wtg[01].speed\) would grow without bound"):
        Simulator(light).prepare([what], (law,) * 2)
    Simulator(replace(light, simulation_dt=0.01)).prepare([what], (law,) * 2)


@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_load_noise_by_rank_one_update_equals_a_full_reduction(simulator, shift):
    # 12 MW of noise at bus 9 from t = 0.1 s on, against the same as a load step of 12 MW.
    results, settings = [], simulator.settings
    first, *others = settings.case.branches
    shifted = replace(settings.case, branches=(replace(first, phase_rad=shift), *others))
    simulator = Simulator(replace(settings, case=shifted))
    noise = scenario(load_noise_mw=np.concatenate([[0.0], np.full(40, 12.0)]), load_noise_bus=9)
    for what in (scenario(sc.LoadStep(time_s=0.1, bus=9, power_mw=12.0)), noise):
        simulator.start(0, what, PAIR)
        recorded(simulator, 3.0)
        results.append(np.concatenate([simulator.state(), np.abs(simulator.bus_voltages())]))
    assert results[0] == pytest.approx(results[1], abs=1e-12)


def test_load_noise_ends_with_its_series_at_every_control_interval():
    noisy = scenario(duration_s=2.0, load_noise_mw=np.array([0.0, 0.0, 40.0, 40.0]))
    for interval_s in (0.05, 0.1, 0.2):
        noise = started(Plant(interval_s=interval_s), noisy, duration_s=2.0).data.noise[0]
        assert noise.sum() * interval_s == pytest.approx(2 * 40.0 * 0.1)
        assert (noise[round(0.4 / interval_s) :] == 0.0).all()


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


@pytest.mark.parametrize(("suite", "seed", "strategy", "status"), PLAYED)
def test_limits_out_of_reach_leave_the_papers_plant_as_it_is(suite, seed, strategy, status):
    what = get_suite(suite).scenario(seed)
    paper, unlimited = (started(plant, what, strategy, what.duration_s) for plant in (Plant(pitch=NO_PITCH), UNLIMITED))
    names = ("rotor_speed", "power", "emf", "energy_captured", "energy_delivered")
    expected, result = (recorded(run, what.duration_s, *names) for run in (paper, unlimited))
    assert paper.env_values("status")[0] == unlimited.env_values("status")[0] == status
    assert all(result[name] == pytest.approx(values, rel=0.0, abs=1e-9) for name, values in expected.items())
    assert unlimited.env_values("coi_min")[0] == pytest.approx(paper.env_values("coi_min")[0], abs=1e-11)


@pytest.mark.parametrize(("mvar", "above_pu", "stays_s"), OVER_VOLTAGES)
def test_a_group_stays_through_the_over_voltages_it_must_and_no_longer(mvar, above_pu, stays_s):
    # A capacitor far too large, where no machine and hardly any group controls its voltage.
    capacitor = LoadStep(time_s=1.0, bus=2, power_mw=0.0, reactive_mvar=mvar)
    case, slow = get_grid("ieee14").case.classical(), parameters.VoltageControlParameters(integral_gain=0.01)
    simulator = started(plant(interval_s=0.1, voltage=slow, case=case), scenario(capacitor))
    result = recorded(simulator, 30.0, "terminal_voltage", "connected", "largest_voltage", "trip_cause")
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
    settings = plant(table=table, interval_s=0.025, shedding=NO_SHEDDING)
    simulator = started(settings, scenario(*events, duration_s=180.0), duration_s=180.0)
    start = simulator.state()
    names = ("current", "limiting_reactance", "over_power", "under_power", "internal_voltage", "power")
    result = recorded(simulator, 180.0, *names)
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
    simulator = started(plant(interval_s=0.025), scenario(*extended.pulse(4, reactive_mvar=60.0, until_s=16.0)))
    before = simulator.wtg_values("reactive")[0]
    result = recorded(simulator, 60.0, "reactive", "terminal_voltage")["reactive"]
    assert before == pytest.approx([0.33, 0.33], abs=1e-9)
    assert result.max() > 0.36
    held = result[40 + 20 : 600]
    assert held.max() < 0.3305
    assert result[-1] == pytest.approx(before, abs=1e-5)


# At four buses, and at a weak one.
@pytest.mark.parametrize(("buses", "n_turbines"), [((2, 4, 9, 14), 5.0), ((14,) * 4, 20.0)])
def test_limited_currents_solve_their_equations(buses, n_turbines):
    groups = tuple(parameters.WtgGroup(bus=bus, n_turbines=n_turbines) for bus in buses)
    built = plant_tables(Plant(groups=groups, limits=parameters.ConverterLimitParameters()))
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
        run_routine(_FIND_CURRENTS, (np.zeros((layout.n_rows, 1)), scratch), network.code)
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
