"""Facts about faults, branches that change, units that return, and what a converter, its torque and chopper stand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.extended import LAW, NO_SHEDDING, plant, recorded, scenario, started
from tests.physics.test_islands import PARTED_WIND, cut, parted
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import ConverterLimitParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.reduction import assemble
from wtg_gym.physics.scenario import Event, Fault, LineTrip, LoadStep, ReactanceStep
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.physics.trajectory import simulate


def bus_matrix(simulator: Simulator) -> np.ndarray:
    network = simulator.plant.network
    y = np.zeros((network.shunts.size,) * 2, dtype=np.complex128)
    assemble(y, np.zeros_like(network.unit_y), simulator.blocks[0], 0, 0, network, simulator.data)
    return y


# --- Faults and branches


@pytest.mark.parametrize("impedance", [1e-4j, 0.02 + 0.05j])
def test_during_a_fault_its_impedance_carries_all_that_flows_into_the_bus(impedance: complex) -> None:
    what = Fault(time_s=1.0, bus=4, clears_after_s=0.1, resistance_pu=impedance.real, reactance_pu=impedance.imag)
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


def test_a_line_that_clears_a_fault_is_a_line_that_trips_then() -> None:
    both = [
        (Fault(time_s=1.0, bus=4, clears_after_s=0.15, opens=(4, 2)),),
        (Fault(time_s=1.0, bus=4, clears_after_s=0.15), LineTrip(time_s=1.15, from_bus=4, to_bus=2)),
    ]
    ends = []
    for events in both:
        simulator = started(plant(), scenario(*events))
        recorded(simulator, 5.0)
        assert simulator.lane_values("status")[0] == Status.RUNNING
        ends.append(simulator.blocks.copy())
    assert (ends[0] == ends[1]).all()


@pytest.mark.parametrize(("ends", "factor"), [((2, 4), 3.0), ((4, 7), 0.25)], ids=["line", "transformer"])
def test_a_reactance_step_gives_the_network_with_that_impedance(ends: tuple[int, int], factor: float) -> None:
    event = ReactanceStep(time_s=1.0, from_bus=ends[1], to_bus=ends[0], factor=factor)
    other = ReactanceStep(time_s=0.5, from_bus=ends[0], to_bus=ends[1], factor=7.0)
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


# --- Energies

#: A loss of load: machines press power into the converter that gives least.
PRESSED = (LoadStep(time_s=1.0, bus=3, power_mw=-130.0), LoadStep(time_s=1.0, bus=9, power_mw=-50.0))


def stored(simulator: Simulator) -> Floats:
    """H_m ω_m², less what was captured and not delivered or burnt."""
    captured, delivered, burnt, speed = (
        simulator.wtg_values(name)[0]
        for name in ("energy_captured", "energy_delivered", "energy_chopped", "rotor_speed")
    )
    kept: Floats = simulator.settings.turbine.inertia_constant_s * speed**2 - (captured - delivered - burnt)
    return kept


@pytest.mark.parametrize(
    "events",
    [
        (Fault(time_s=1.0, bus=4, clears_after_s=0.15, opens=(2, 4)), LoadStep(time_s=3.0, bus=3, power_mw=-150.0)),
        cut(1.0, again_s=2.0),
    ],
    ids=["fault, and power pressed in", "islands"],
)
def test_energies_close_whatever_happens(events: tuple[Event, ...]) -> None:
    simulator = started(parted(), scenario(*events, wind=PARTED_WIND))
    start = stored(simulator)
    for _ in range(200):
        simulator.advance()
        assert np.abs(stored(simulator) - start).max() < 1e-11
    assert simulator.lane_values("status")[0] == Status.RUNNING


# --- What converters stand


def test_a_turbine_is_not_held_beyond_its_power_and_torque_and_all_see_the_frequency_of_its_voltage() -> None:
    settings = plant(shedding=NO_SHEDDING, simulation_dt=0.0125)
    simulator = started(settings, scenario(wind=[[14.0], [11.4]], duration_s=300.0), duration_s=300.0)
    plant_, law = simulator.plant, get_law(LAW, settings.turbine)
    shares, group_two_h = plant_.share, plant_.turbine[0]["converter.two_h"]
    weights = np.concatenate([plant_.machines["two_h"], group_two_h * shares])
    shifts = []
    for _ in range(3000):
        # A law that asks for more than the generator gives.
        simulator.blocks[0, simulator.layout.wtg("k_offset"), 0] = 1.0
        simulator.advance()
        speed, shift = simulator.wtg_values("speed")[0], simulator.wtg_values("shift")[0]
        shifts.append(shift)
        frequency = speed + shift
        seen = np.concatenate([simulator.machine_values("speed")[0], frequency])
        assert simulator.wtg_values("coefficient")[0] == pytest.approx(
            np.interp(frequency, [0.992, 1.0, 1.008], [law.k_min, law.k_nominal, law.k_max]) + 1.0, abs=1e-12
        )
        # Of the step's last stage, which is a little beside its end.
        assert simulator.lane_values("coi")[0] - 1.0 == pytest.approx(weights @ (seen - 1.0) / weights.sum(), abs=1e-7)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert (shifts[-1] < -1e-4).all()
    torque = simulator.wtg_values("power")[0] / simulator.wtg_values("rotor_speed")[0]
    assert torque.max() <= 1.1 + 1e-6 and torque.min() > 1.0999
    assert simulator.wtg_values("power")[0].max() <= 1.1 + 1e-6


def test_a_record_shows_the_frequency_of_the_voltage() -> None:
    what = scenario(LoadStep(time_s=0.5, bus=2, power_mw=150.0), duration_s=3.0)
    found, simulator = simulate(what, LAW, plant()), started(plant(), what)
    live = recorded(simulator, 3.0, "speed", "shift")
    assert np.abs(live["shift"]).max() > 1e-4
    assert (found.wtg_frequency_hz[1:] == 50.0 * (live["speed"] + live["shift"])).all()


def test_a_chopper_heats_by_what_it_burns_and_cools_and_a_group_with_a_full_one_trips() -> None:
    limits = ConverterLimitParameters(chopper_energy_pu_s=0.015, chopper_cooling_s=5.0)
    simulator = started(plant(limits=limits, control_dt=0.025, shedding=NO_SHEDDING), scenario(*PRESSED))
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
