"""Every run starts in an exact equilibrium; extended plants keep their balances and are stable there."""

import dataclasses
import math

import numpy as np
import pytest

from tests.physics import extended
from tests.physics.extended import plant, scenario, with_machine
from wtg_gym import Plant, TrackingLaw, get_law
from wtg_gym.physics import parameters
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.linearisation import largest_stable_steps, moving_states, state_matrix
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import LAWS

LIMIT = 1e-8
PAIR = (get_law("coordinated-piecewise"),) * 2
TOO_FAST = [
    (Plant(case=with_machine(t_d0_subtransient_s=0.009)), r"eigenvalue -11\d.*mainly sync0.psi_1d.* at most 0.022"),
    (
        plant(voltage=parameters.VoltageControlParameters(integral_gain=1000.0)),
        r"eigenvalue -98\d.* 1/s \(mainly wtg[01].internal_voltage\) .* at most 0.0027 s",
    ),
    # It switches at 0.5 p.u. a step once the power exceeds its limit.
    (plant(limits=parameters.ConverterLimitParameters(power_gain=1.0)), r"mainly wtg[01].angle\)"),
]


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_no_state_moves_at_the_start_at_any_wind(simulator, law):
    for wind in np.linspace(6.0, 13.0, 20):
        simulator.start(0, extended.scenario(wind=[[wind], [19.0 - wind]]), (law, law))
        assert extended.largest_rate(simulator) <= LIMIT, f"{wind:g} m/s"


def test_above_rated_the_pitch_holds_the_captured_power_at_its_limit_and_below_it_rests(simulator):
    for low, high in ((3.0, 12.0), (8.0, 15.0), (11.4, 24.0)):
        simulator.start(0, extended.scenario(wind=[[low], [high]]), (LAWS["coordinated-piecewise"],) * 2)
        assert extended.largest_rate(simulator) <= LIMIT
        below, above = simulator.wtg_values("pitch")[0]
        assert below == 0.0 and above > 0.0
        assert simulator.wtg_values("captured")[0, 1] == pytest.approx(1.05, abs=1e-9)


def test_other_groups_machine_models_resistance_and_shared_buses_start_at_rest():
    groups = parameters.WtgGroup(bus=3), parameters.WtgGroup(bus=14, n_turbines=2.0)
    case = get_grid("ieee14").case
    for own in (case, case.classical()):
        settings = Plant(case=own, groups=groups)
        assert extended.largest_rate(extended.started(settings, extended.scenario(wind=[[9], [9]]), "mppt")) <= LIMIT
    machines = [dataclasses.replace(machine, resistance=0.003) for machine in case.machines]
    # In the place of the last one: as many machines as usual, whose code is compiled already.
    case = dataclasses.replace(case, machines=(*machines[:-1], extended.classical(bus=3, dispatch_mw=20.0)))
    assert len({machine.bus for machine in case.machines}) < len(case.machines)
    result = extended.started(Plant(case=case), extended.scenario(wind=[[9.0], [9.0]]), "coordinated-linear")
    assert extended.largest_rate(result) <= LIMIT


@pytest.mark.parametrize("table", [False, True])
def test_with_any_options_no_state_moves_at_the_start_which_is_stable(table):
    for limits, voltage, energy in extended.OPTIONS:
        settings = extended.plant(table=table, limits=limits, voltage=voltage, energy=energy, dead_band=2e-4)
        simulator = Simulator(settings)
        laws = (get_law(extended.LAW, settings.turbine),) * 2
        for winds in ((6.0, 13.0), (8.0, 8.0), (11.4, 8.0), (12.0, 5.0), (16.0, 16.0), (24.0, 9.0)):
            for level in (0.7, 1.0, 1.2):
                simulator.start(0, extended.scenario(wind=np.array([winds]).T, load_level=level), laws)
                assert extended.largest_rate(simulator) <= 1e-8, (limits, voltage, energy, winds, level)
        # Without a dead band, within which a governor does nothing.
        simulator = Simulator(extended.plant(table=table, limits=limits, voltage=voltage, energy=energy))
        for wind in (8.0, 11.0, 16.0):
            simulator.start(0, extended.scenario(wind=[[wind], [8.0]]), laws)
            rows, layout = simulator.blocks[0, :, 0], simulator.layout
            for side in (-1.0, 1.0):
                matrix = state_matrix(rows, simulator.plant, layout, side)
                keep = moving_states(matrix, rows, layout)
                assert np.linalg.eigvals(matrix[np.ix_(keep, keep)]).real.max() < -0.03


@pytest.mark.parametrize(("level", "sign"), [(1.2, 1.0), (0.5, -1.0)])
def test_a_bus_lets_go_of_its_voltage_where_the_groups_reactive_power_does_not_suffice(level, sign):
    result = {}
    for limit in (1.0, 0.04, 0.0):
        control = parameters.VoltageControlParameters(reactive_max_pu=limit, internal_voltage_max_pu=1.6)
        simulator = extended.started(extended.plant(limits=False, voltage=control), extended.scenario(load_level=level))
        assert extended.largest_rate(simulator) <= 1e-8
        held = np.abs(simulator.bus_voltages()[1]) - 1.045
        result[limit] = sign * simulator.wtg_values("reactive")[0], sign * held
    (ample, held), *scarce = result.values()
    assert (ample > 0.04).all() and (ample < 1.0).all() and held == pytest.approx(0.0, abs=1e-12)
    for limit, (reactive, deviation) in zip((0.04, 0.0), scarce, strict=True):
        assert reactive == pytest.approx(limit, abs=1e-11)
        assert deviation < -1e-4


@pytest.mark.parametrize(("table", "energy"), [(False, False), (False, True), (True, False), (True, True)])
def test_rotor_and_converter_keep_their_balances_in_rough_runs(table, energy):
    settings = extended.plant(table=table, energy=energy, dead_band=2e-4)
    inertia = settings.turbine.inertia_constant_s
    chopped = 0.0
    for seed in range(8):
        simulator = extended.started(settings, extended.rough(seed))
        before = simulator.wtg_values("rotor_speed")[0]
        assert extended.recorded(simulator, 30.0, "current")["current"].max() <= extended.CURRENT_MAX * (1.0 + 1e-9)
        after = simulator.wtg_values("rotor_speed")[0]
        captured, delivered, burnt = (
            simulator.wtg_values(f"energy_{name}")[0] for name in ("captured", "delivered", "chopped")
        )
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
    Simulator(Plant(simulation_dt=0.04, control_dt=0.2)).prepare([lighter], PAIR)
    Simulator(Plant(simulation_dt=0.05)).prepare([scenario()], PAIR)


@pytest.mark.parametrize(
    ("inertia_s", "k_min", "k_nominal", "k_max", "wind_m_s"),
    [
        # The slope below ω_st is what is fast, but only once the wind has risen: it acts on the cube of the speed.
        (2.0, 3.0, 0.6, 0.55, 5.0),
        # The steeper slope takes power away while the frequency falls; the other one is what is fast.
        (0.7, 0.05, 0.9, 0.2, 16.0),
    ],
)
def test_a_law_that_is_too_steep_for_the_step_is_refused(inertia_s, k_min, k_nominal, k_max, wind_m_s):
    law = TrackingLaw(name="steep", k_min=k_min, k_nominal=k_nominal, k_max=k_max)
    what = scenario(wind=np.full((2, 1), wind_m_s))
    light = Plant(control=parameters.GridFormingParameters(inertia_constant_s=inertia_s))
    with pytest.raises(ValueError, match=r"\(mainly wtg[01].speed\) would grow without bound"):
        Simulator(light).prepare([what], (law,) * 2)
    Simulator(dataclasses.replace(light, simulation_dt=0.01)).prepare([what], (law,) * 2)
