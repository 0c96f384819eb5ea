"""Facts about events: units, governors and lines that go and return, faults, and what a converter stands in them."""

import numpy as np
import pytest

from tests.physics.extended import LAW, NO_SHEDDING, phasors, plant, recorded, scenario, started
from wtg_gym import simulate
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.parameters import ConverterLimitParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.reduction import assemble
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.units import PAIRS, UNITS

LAWS = (STRATEGIES["coordinated-piecewise"],) * 2
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


def bus_matrix(simulator: Simulator) -> np.ndarray:
    network = simulator.plant.network
    y = np.zeros((network.shunts.size,) * 2, dtype=np.complex128)
    assemble(y, np.zeros_like(network.unit_y), simulator.blocks[0], 0, 0, network, simulator.data)
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
    simulator.start(0, scenario(*ALL), LAWS)
    for _ in range(40):
        simulator.advance()
        check_network(simulator)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
    assert simulator.machine_values("connected")[0].tolist() == [1.0, 1.0, 0.0, 1.0]


def test_a_load_ramp_is_a_staircase_whose_steps_are_the_means_of_the_intervals_and_ends_where_it_says(simulator):
    # From 2.1 s to 2.6 s, and cut by another event within an interval.
    cut = sc.LoadStep(time_s=2.525, bus=3, power_mw=0.0)
    ramp = sc.LoadRamp(time_s=2.1, bus=9, power_mw=-15.0, duration_s=0.5)
    shares = {2.1: 0.1, 2.2: 0.3, 2.3: 0.5, 2.4: 0.7, 2.5: 0.825, 2.525: 0.925, 2.6: 1.0}
    rises = zip(shares, np.diff([0.0, *shares.values()]), strict=True)
    steps = [sc.LoadStep(time_s=time_s, bus=9, power_mw=-15.0 * rise) for time_s, rise in rises]
    found = []
    for events in ((cut, ramp), (cut, *steps)):
        simulator.start(0, scenario(*events), LAWS)
        recorded(simulator, 3.0)
        found.append(simulator.state())
    assert found[0] == pytest.approx(found[1], abs=1e-12)


def test_a_lane_that_starts_again_has_all_its_units_and_governors(simulator):
    simulator.start(0, scenario(), LAWS)
    fresh = simulator.blocks.copy()
    simulator.start(0, scenario(*ALL), LAWS)
    recorded(simulator, 4.0)
    simulator.start(0, scenario(), LAWS)
    assert (simulator.blocks == fresh).all()


@pytest.mark.parametrize("impedance", [1e-4j, 0.02 + 0.05j])
def test_during_a_fault_its_impedance_carries_all_that_flows_into_the_bus(impedance):
    what = sc.Fault(time_s=1.0, bus=4, clears_after_s=0.1, resistance_pu=impedance.real, reactance_pu=impedance.imag)
    simulator = started(plant(control_dt=0.025), scenario(what))
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
        assert simulator.lane_values("status")[0] == Status.RUNNING
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
    found, simulator = simulate(what, LAW, plant()), started(plant(), what)
    live = recorded(simulator, 3.0, "speed", "shift")
    assert np.abs(live["shift"]).max() > 1e-4
    assert (found.wtg_frequency_hz[1:] == 50.0 * (live["speed"] + live["shift"])).all()


def test_a_chopper_heats_by_what_it_burns_and_cools_and_a_group_with_a_full_one_trips():
    limits = ConverterLimitParameters(chopper_energy_pu_s=0.015, chopper_cooling_s=5.0)
    # A loss of load: machines press power into the converter that gives least.
    pressed = (sc.LoadStep(time_s=1.0, bus=bus, power_mw=power) for bus, power in ((3, -130.0), (9, -50.0)))
    simulator = started(plant(limits=limits, control_dt=0.025, shedding=NO_SHEDDING), scenario(*pressed))
    heat, burnt, fullest = np.zeros(2), np.zeros(2), np.zeros(2)
    for _ in range(1600):
        was = simulator.wtg_values("connected")[0]
        simulator.advance()
        now = simulator.wtg_values("energy_chopped")[0]
        heat, burnt = heat * np.exp(-0.025 / 5.0) + now - burnt, now
        assert simulator.wtg_values("heat")[0] == pytest.approx(heat, abs=1e-12)
        fullest = np.maximum(fullest, heat)
        if simulator.lane_values("step")[0] % 4 == 0:
            assert (simulator.wtg_values("connected")[0] == was * (heat <= 0.015)).all()
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
    assert 0.015 < fullest[1] < 0.02 and heat[1] < 0.2 * fullest[1] and fullest[0] == 0.0
