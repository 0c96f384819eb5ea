"""Facts about events: units, governors and lines that go and return, faults, and what a converter stands in them."""

import dataclasses
import math

import numpy as np
import pytest

from tests.physics import extended
from tests.physics.extended import LAW, NO_SHEDDING, numbers, phasors, plant, recorded, scenario, started
from tests.physics.test_islands import PARTED_WIND, cut, parted
from wtg_gym import Plant, simulate
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.devices import SOURCES
from wtg_gym.physics.grid import Source, get_grid
from wtg_gym.physics.network_events import assemble
from wtg_gym.physics.parameters import ConverterLimitParameters
from wtg_gym.physics.protection import FILTER_S, Status, turn_between
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import LAWS
from wtg_gym.physics.units import BUSES, ISLANDS, PAIRS, UNITS, Phasor, TripCause

IEEE14 = get_grid("ieee14").case
#: An imposed source in the place of the machine with the governor.
WITH_SOURCE = dataclasses.replace(IEEE14, machines=IEEE14.machines[1:], sources=(Source(bus=1, reactance=0.02),))
PAIR = (LAWS["coordinated-piecewise"],) * 2
ALL = (
    sc.LoadStep(time_s=0.5, bus=3, power_mw=20.0, reactive_mvar=5.0),
    sc.LineTrip(time_s=1.0, from_bus=2, to_bus=4, recloses_after_s=0.75),
    sc.MachineOutage(time_s=1.25, bus=6),
    sc.GovernorLoss(time_s=2.0, bus=1),
    sc.LoadRamp(time_s=2.1, bus=9, power_mw=-15.0, duration_s=0.5),
    sc.GroupTrip(time_s=2.525, group=1),
    sc.LineTrip(time_s=3.0, from_bus=4, to_bus=5),
    sc.LineTrip(time_s=3.0, from_bus=2, to_bus=4, recloses_after_s=0.025),
    sc.LoadTrip(time_s=3.5, bus=14),
)
#: And those that only extended plants take.
EVERY = (
    *ALL,
    sc.Fault(time_s=1.0, bus=4, clears_after_s=0.15, resistance_pu=0.01, reactance_pu=0.02, opens=(2, 4)),
    sc.Fault(time_s=2.0, bus=4, clears_after_s=0.15),
    sc.ReactanceStep(time_s=1.0, from_bus=1, to_bus=2, factor=2.0),
    sc.PhaseJump(time_s=1.0, bus=1, angle_deg=-30.0),
    sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=1.0, duration_s=2.0),
)


def bus_matrix(simulator: Simulator) -> np.ndarray:
    network = simulator.plant.network
    y = np.zeros((network.shunts.size,) * 2, dtype=np.complex128)
    assemble(y, np.zeros_like(network.unit_y), simulator.blocks[0], network, simulator.data)
    return y


def check_network(simulator: Simulator) -> None:
    """Reduced admittance, currents and power balance are those of the whole network with its connected units."""
    flags = simulator.machine_values("connected")[0], simulator.wtg_values("connected")[0]
    connected = np.flatnonzero(np.concatenate(flags))
    full, plant, n = bus_matrix(simulator), simulator.plant, simulator.layout.n_unit
    at, y = plant.network.unit_bus[connected], np.diag(plant.network.unit_y[connected])
    passive = full.copy()
    np.add.at(passive, (at, at), -plant.network.unit_y[connected])
    expected = np.zeros((n, n), dtype=complex)
    expected[np.ix_(connected, connected)] = y - y @ np.linalg.inv(full)[np.ix_(at, at)] @ y
    assert np.abs(phasors(simulator, PAIRS, "admittance").reshape(n, n) - expected).max() <= 1e-11
    emf, current = phasors(simulator, UNITS, "voltage"), phasors(simulator, UNITS, "current")
    assert (np.delete(current, connected) == 0.0).all()
    assert np.abs(current - expected @ emf).max() <= 1e-10
    voltage = simulator.bus_voltages()
    assert np.abs(y @ (emf[connected] - voltage[at]) - current[connected]).max() <= 1e-10
    given = simulator.machine_values("power")[0].sum() + simulator.wtg_values("power")[0] @ plant.share
    assert abs(given - (voltage @ np.conj(passive @ voltage)).real) <= 1e-9


def test_the_reduced_network_is_the_whole_one_through_every_kind_of_event(simulator):
    simulator.start(0, scenario(*ALL), PAIR)
    for _ in range(40):
        simulator.advance()
        check_network(simulator)
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
    assert simulator.machine_values("connected")[0].tolist() == [1.0, 1.0, 0.0, 1.0]


def test_a_load_ramp_is_a_staircase_whose_steps_are_the_means_of_the_intervals_and_ends_where_it_says(simulator):
    # From 2.1 s to 2.6 s, and cut by another event within an interval.
    cut = sc.LoadStep(time_s=2.525, bus=3, power_mw=0.0)
    ramp = sc.LoadRamp(time_s=2.1, bus=9, power_mw=-15.0, duration_s=0.5)
    shares = {2.1: 0.1, 2.2: 0.3, 2.3: 0.5, 2.4: 0.7, 2.5: 0.825, 2.525: 0.925, 2.6: 1.0}
    rises = zip(shares, np.diff([0.0, *shares.values()]), strict=True)
    steps = [sc.LoadStep(time_s=time_s, bus=9, power_mw=-15.0 * rise) for time_s, rise in rises]
    result = []
    for events in ((cut, ramp), (cut, *steps)):
        simulator.start(0, scenario(*events), PAIR)
        recorded(simulator, 3.0)
        result.append(simulator.state())
    assert result[0] == pytest.approx(result[1], abs=1e-12)


def test_a_env_that_starts_again_has_all_its_units_and_governors(simulator):
    simulator.start(0, scenario(), PAIR)
    fresh = simulator.blocks.copy()
    simulator.start(0, scenario(*ALL), PAIR)
    recorded(simulator, 4.0)
    simulator.start(0, scenario(), PAIR)
    assert (simulator.blocks == fresh).all()


@pytest.mark.parametrize("impedance", [1e-4j, 0.02 + 0.05j])
def test_during_a_fault_its_impedance_carries_all_that_flows_into_the_bus(impedance):
    what = sc.Fault(time_s=1.0, bus=4, clears_after_s=0.1, resistance_pu=impedance.real, reactance_pu=impedance.imag)
    simulator = started(plant(interval_s=0.025), scenario(what))
    recorded(simulator, 1.0)
    before = bus_matrix(simulator)
    simulator.advance()
    faulted, voltage = bus_matrix(simulator), simulator.bus_voltages()
    # All the rest of the network, with its load, gives the fault's current.
    into = -(before @ voltage)[3]
    assert abs(voltage[3] - impedance * into) < 1e-12 * abs(into)
    faulted[3, 3] -= 1.0 / impedance
    assert np.abs(faulted - before).max() < 1e-11
    recorded(simulator, 0.1)
    assert (bus_matrix(simulator) == before).all()


def test_a_line_that_clears_a_fault_is_a_line_that_trips_then():
    both = [
        (sc.Fault(time_s=1.0, bus=4, clears_after_s=0.15, opens=(4, 2)),),
        (sc.Fault(time_s=1.0, bus=4, clears_after_s=0.15), sc.LineTrip(time_s=1.15, from_bus=4, to_bus=2)),
    ]
    ends = []
    for events in both:
        simulator = started(plant(), scenario(*events))
        recorded(simulator, 5.0)
        assert simulator.env_values("status")[0] == Status.RUNNING
        ends.append(simulator.blocks.copy())
    assert (ends[0] == ends[1]).all()


@pytest.mark.parametrize(("ends", "factor"), [((2, 4), 3.0), ((4, 7), 0.25)], ids=["line", "transformer"])
def test_a_reactance_step_gives_the_network_with_that_impedance(ends, factor):
    event = sc.ReactanceStep(time_s=1.0, from_bus=ends[1], to_bus=ends[0], factor=factor)
    other = sc.ReactanceStep(time_s=0.5, from_bus=ends[0], to_bus=ends[1], factor=7.0)
    simulator = started(plant(), scenario(other, event))
    branch = simulator.settings.case.branch_index(*ends)
    (f, t), given = simulator.plant.network.branch_ends[branch], simulator.settings.case.branches[branch]
    recorded(simulator, 0.5)
    expected = bus_matrix(simulator)
    recorded(simulator, 1.0)
    old, new = (1.0 / (size * complex(given.resistance, given.reactance)) for size in (1.0, factor))
    change = (new - old) * np.array([[1.0 / given.tap**2, -1.0 / given.tap], [-1.0 / given.tap, 1.0]])
    expected[np.ix_([f, t], [f, t])] += change
    assert np.abs(bus_matrix(simulator) - expected).max() < 1e-12


def test_a_record_shows_the_frequency_of_the_voltage():
    what = scenario(sc.LoadStep(time_s=0.5, bus=2, power_mw=150.0), duration_s=3.0)
    result, simulator = simulate(what, LAW, plant()), started(plant(), what)
    live = recorded(simulator, 3.0, "speed", "shift")
    assert np.abs(live["shift"]).max() > 1e-4
    assert (result.wtg_frequency_hz[1:] == 50.0 * (live["speed"] + live["shift"])).all()


@pytest.mark.parametrize(("settings", "error"), [(Plant(), 1e-9), (plant(), 0.01)], ids=["paper", "extended"])
def test_a_record_shows_no_voltage_at_a_fault_and_apparent_power_is_voltage_times_current(settings, error):
    fault = sc.Fault(time_s=1.0, bus=4, clears_after_s=0.2)
    run = simulate(scenario(fault, duration_s=2.0), LAW, settings)
    during = (run.time_s > 1.05) & (run.time_s < 1.25)
    assert (run.bus_voltage_pu[during, 3] < 0.01).all() and (run.bus_voltage_pu[~during] > 0.5).all()
    at = [settings.case.bus_index(group.bus) for group in settings.groups]
    apparent = run.bus_voltage_pu[:, at] * run.current_pu
    assert np.hypot(run.power_pu, run.reactive_power_pu) == pytest.approx(apparent, abs=error)
    assert run.connected.all() and run.trip_causes == (None, None)
    assert run.current_pu[during].max() > 1.1 * run.current_pu[0].max()


def test_a_chopper_heats_by_what_it_burns_and_cools_and_a_group_with_a_full_one_trips():
    limits = ConverterLimitParameters(chopper_energy_pu_s=0.015, chopper_cooling_s=5.0)
    # A loss of load: machines press power into the converter that gives least.
    pressed = (sc.LoadStep(time_s=1.0, bus=bus, power_mw=power) for bus, power in ((3, -130.0), (9, -50.0)))
    simulator = started(plant(limits=limits, interval_s=0.025, shedding=NO_SHEDDING), scenario(*pressed))
    heat, burnt, fullest = np.zeros(2), np.zeros(2), np.zeros(2)
    for _ in range(1600):
        was = simulator.wtg_values("connected")[0]
        simulator.advance()
        now = simulator.wtg_values("energy_chopped")[0]
        heat, burnt = heat * np.exp(-0.025 / 5.0) + now - burnt, now
        assert simulator.wtg_values("heat")[0] == pytest.approx(heat, abs=1e-12)
        fullest = np.maximum(fullest, heat)
        if simulator.env_values("step")[0] % 4 == 0:
            assert (simulator.wtg_values("connected")[0] == was * (heat <= 0.015)).all()
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
    assert simulator.wtg_values("trip_cause")[0].tolist() == [0.0, TripCause.CHOPPER]
    assert 0.015 < fullest[1] < 0.02 and heat[1] < 0.2 * fullest[1] and fullest[0] == 0.0


def test_units_follow_the_frequency_that_a_source_imposes_and_the_centre_of_inertia_leaves_it_out():
    settings = plant(case=WITH_SOURCE, shedding=NO_SHEDDING)
    ramp = sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=-0.05, duration_s=6.0)
    simulator = started(settings, scenario(ramp, wind=[[8.0], [8.0]], duration_s=200.0), duration_s=200.0)
    assert extended.largest_rate(simulator) < 1e-10
    row = simulator.layout.rows_of(SOURCES, "speed")[0]
    weights = np.concatenate([simulator.plant.machines["two_h"], simulator.plant.share * 10.0])
    result = []
    for _ in range(2000):
        simulator.advance()
        speed = simulator.wtg_values("speed")[0] + simulator.wtg_values("shift")[0]
        speed = np.concatenate([simulator.machine_values("speed")[0], speed])
        centre = simulator.env_values("coi")[0]
        assert centre - 1.0 == pytest.approx(weights @ (speed - 1.0) / weights.sum(), abs=1e-14)
        result.append([simulator.blocks[0, row, 0], *speed])
    imposed, units = np.array(result)[:, 0], np.array(result)[:, 1:]
    times = 0.1 * np.arange(1, 2001)
    assert imposed == pytest.approx(1.0 - 0.001 * np.clip(times - 1.0, 0.0, 6.0), abs=1e-13)
    rate = np.diff(units[40:69], axis=0) / 0.1
    assert rate.mean() == pytest.approx(-0.001, rel=0.02)
    assert units[-1] == pytest.approx(0.994, abs=1e-9)
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert numbers(simulator, BUSES, "frequency") == pytest.approx(0.994, abs=1e-9)


@pytest.mark.parametrize(("deviation_hz", "power"), [(-0.4, 1.05), (-0.2, 1.02375), (0.0, 0.9975), (0.2, 0.97125)])
def test_above_rated_wind_a_group_holds_its_reserve_and_gives_it(deviation_hz, power):
    ramp = sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=deviation_hz / 4.0, duration_s=4.0)
    settings = plant(case=WITH_SOURCE, shedding=NO_SHEDDING)
    simulator = started(settings, scenario(ramp, wind=[[14.0], [8.0]], duration_s=120.0), duration_s=120.0)
    recorded(simulator, 120.0)
    assert simulator.wtg_values("captured")[0, 0] == pytest.approx(power, abs=1e-6)
    assert simulator.wtg_values("power")[0, 0] == pytest.approx(power, abs=1e-6)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.3, 90.0, 179.0, -179.0, 179.9999, -90.0, -0.3])
@pytest.mark.parametrize("at", [0.0, 100.0, 179.5, -135.0])
def test_the_angle_between_two_voltages_is_exact_near_half_a_turn_too(at, turn):
    first, second = (size * np.exp(1j * math.radians(a)) for size, a in ((0.9, at), (1.1, at + turn)))
    result = turn_between(Phasor(first.real, first.imag), Phasor(second.real, second.imag))
    assert result == pytest.approx(math.radians(turn), abs=2e-10)


def test_a_local_frequency_is_the_filtered_turn_of_the_voltage():
    simulator = started(plant(simulation_dt=0.0025), scenario(sc.LoadStep(time_s=1.0, bus=9, power_mw=60.0)))
    expected, before = np.ones(14), simulator.bus_voltages() * np.exp(1j * simulator.env_values("angle")[0])
    lowest = 1.0
    for _ in range(60):
        simulator.advance()
        now = simulator.bus_voltages() * np.exp(1j * simulator.env_values("angle")[0])
        measured = 1.0 + np.angle(now / before) / (2.0 * np.pi * 50.0 * 0.1)
        expected += (1.0 - math.exp(-0.1 / FILTER_S)) * (measured - expected)
        assert numbers(simulator, BUSES, "frequency") == pytest.approx(expected, abs=1e-7)
        before = now
        groups = simulator.wtg_values("speed") + simulator.wtg_values("shift")
        lowest = min(lowest, expected.min(), simulator.machine_values("speed").min(), groups.min())
        assert simulator.env_values("worst_min")[0] == pytest.approx(lowest, abs=1e-7)
    assert lowest < 0.998


def test_half_the_units_of_a_machine_are_a_machine_of_half_the_rating():
    half = extended.with_machine(rating_mva=0.5 * IEEE14.machines[0].rating_mva)
    step = sc.LoadStep(time_s=1.0, bus=3, power_mw=30.0)
    some, small = started(plant(), scenario(step, committed=0.5)), started(plant(case=half), scenario(step))
    for _ in range(100):
        some.advance()
        small.advance()
        for name in ("speed", "voltage", "gate"):
            assert some.machine_values(name) == pytest.approx(small.machine_values(name), abs=1e-12)
        assert some.machine_values("power") == pytest.approx(small.machine_values("power"), abs=1e-11)
        assert some.wtg_values("power") == pytest.approx(small.wtg_values("power"), abs=1e-12)
        assert some.env_values("coi") == pytest.approx(small.env_values("coi"), abs=1e-13)


def test_conductances_follow_the_frequency_of_their_island():
    settings, what = parted(load_frequency_dependence=2.0), scenario(*cut(1.0), wind=PARTED_WIND)
    simulator = started(settings, what)
    recorded(simulator, 3.0)
    centres = numbers(simulator, ISLANDS, "centre")
    assert np.ptp(centres[:2]) > 1e-4
    # In a control interval it is that of its beginning.
    before = numbers(simulator, ISLANDS, "centre")
    simulator.advance()
    load = numbers(simulator, BUSES, "load")
    island = numbers(simulator, BUSES, "island").astype(int)
    passive = started(parted(), what)
    recorded(passive, 3.1)
    assert np.abs(numbers(passive, BUSES, "load") - load).max() == 0.0
    # The matrix is written with the centre as it is when it is asked for.
    simulator.blocks[0, simulator.layout.rows_of(ISLANDS, "centre"), 0] = before
    change = bus_matrix(simulator) - bus_matrix(passive)
    assert np.abs(change - np.diag(load * 2.0 * (before[island] - 1.0))).max() < 1e-14


def test_every_event_and_the_commitment_come_back_from_text():
    what = scenario(*EVERY, committed=0.5)
    again = sc.Scenario.from_json(what.to_json())
    assert again.events == EVERY and again.committed == 0.5
    assert again.to_json() == what.to_json()
