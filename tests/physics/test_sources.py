"""Facts about imposed sources, local frequencies, committed units, lanes with such events, and events as text."""

import dataclasses
import math

import numpy as np
import pytest

from tests.physics.extended import NO_SHEDDING, largest_rate, plant, recorded, scenario, started, with_machine
from tests.physics.test_events import bus_matrix
from tests.physics.test_islands import PARTED_WIND, cut, parted
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.devices import SOURCES
from wtg_gym.physics.grid import NetworkCase, Source, get_grid
from wtg_gym.physics.protection import FILTER_S, Status, turn_between
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.units import BUSES, ISLANDS, Phasor


def with_source(**changes: float) -> NetworkCase:
    """An imposed source in the place of the machine with the governor."""
    case = get_grid("ieee14").case
    return dataclasses.replace(case, machines=case.machines[1:], sources=(Source(bus=1, reactance=0.02, **changes),))


def local(simulator: Simulator) -> np.ndarray:
    return simulator.blocks[0, simulator.layout.rows_of(BUSES, "frequency"), 0]


def test_units_follow_the_frequency_that_a_source_imposes_and_the_centre_of_inertia_leaves_it_out():
    settings = plant(case=with_source(), shedding=NO_SHEDDING)
    ramp = sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=-0.05, duration_s=6.0)
    simulator = started(settings, scenario(ramp, wind=[[8.0], [8.0]], duration_s=200.0), duration_s=200.0)
    assert largest_rate(simulator) < 1e-10
    row = simulator.layout.rows_of(SOURCES, "speed")[0]
    machines, groups = simulator.plant.machines["two_h"], simulator.plant.share * 10.0
    found = []
    for _ in range(2000):
        simulator.advance()
        speed = simulator.wtg_values("speed")[0] + simulator.wtg_values("shift")[0]
        speed = np.concatenate([simulator.machine_values("speed")[0], speed])
        weights = np.concatenate([machines, groups])
        centre = simulator.lane_values("coi")[0]
        assert centre - 1.0 == pytest.approx(weights @ (speed - 1.0) / weights.sum(), abs=1e-14)
        found.append([simulator.blocks[0, row, 0], *speed])
    imposed, units = np.array(found)[:, 0], np.array(found)[:, 1:]
    times = 0.1 * np.arange(1, 2001)
    assert imposed == pytest.approx(1.0 - 0.001 * np.clip(times - 1.0, 0.0, 6.0), abs=1e-13)
    rate = np.diff(units[40:69], axis=0) / 0.1
    assert rate.mean() == pytest.approx(-0.001, rel=0.02)
    assert units[-1] == pytest.approx(0.994, abs=1e-9)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert local(simulator) == pytest.approx(0.994, abs=1e-9)


@pytest.mark.parametrize(("deviation_hz", "power"), [(-0.4, 1.05), (-0.2, 1.02375), (0.0, 0.9975), (0.2, 0.97125)])
def test_above_rated_wind_a_group_holds_its_reserve_and_gives_it(deviation_hz, power):
    ramp = sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=deviation_hz / 4.0, duration_s=4.0)
    settings = plant(case=with_source(), shedding=NO_SHEDDING)
    simulator = started(settings, scenario(ramp, wind=[[14.0], [8.0]], duration_s=120.0), duration_s=120.0)
    recorded(simulator, 120.0)
    assert simulator.wtg_values("captured")[0, 0] == pytest.approx(power, abs=1e-6)
    assert simulator.wtg_values("power")[0, 0] == pytest.approx(power, abs=1e-6)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.3, 90.0, 179.0, -179.0, 179.9999, -90.0, -0.3])
@pytest.mark.parametrize("at", [0.0, 100.0, 179.5, -135.0])
def test_the_angle_between_two_voltages_is_exact_near_half_a_turn_too(at, turn):
    first, second = (size * np.exp(1j * math.radians(a)) for size, a in ((0.9, at), (1.1, at + turn)))
    found = turn_between(Phasor(first.real, first.imag), Phasor(second.real, second.imag))
    assert found == pytest.approx(math.radians(turn), abs=2e-10)


def test_a_local_frequency_is_the_filtered_turn_of_the_voltage():
    simulator = started(plant(simulation_dt=0.0025), scenario(sc.LoadStep(time_s=1.0, bus=9, power_mw=60.0)))
    expected, before = np.ones(14), simulator.bus_voltages() * np.exp(1j * simulator.lane_values("angle")[0])
    lowest = 1.0
    for _ in range(60):
        simulator.advance()
        now = simulator.bus_voltages() * np.exp(1j * simulator.lane_values("angle")[0])
        measured = 1.0 + np.angle(now / before) / (2.0 * np.pi * 50.0 * 0.1)
        expected += (1.0 - math.exp(-0.1 / FILTER_S)) * (measured - expected)
        assert local(simulator) == pytest.approx(expected, abs=1e-7)
        before = now
        units = np.concatenate(
            [simulator.machine_values("speed")[0], simulator.wtg_values("speed")[0] + simulator.wtg_values("shift")[0]]
        )
        lowest = min(lowest, expected.min(), units.min())
        assert simulator.lane_values("worst_min")[0] == pytest.approx(lowest, abs=1e-7)
    assert lowest < 0.998


def test_half_the_units_of_a_machine_are_a_machine_of_half_the_rating():
    case = get_grid("ieee14").case
    half = with_machine(rating_mva=0.5 * case.machines[0].rating_mva)
    step = sc.LoadStep(time_s=1.0, bus=3, power_mw=30.0)
    some, small = started(plant(), scenario(step, committed=0.5)), started(plant(case=half), scenario(step))
    for _ in range(100):
        some.advance()
        small.advance()
        for name in ("speed", "voltage", "gate"):
            assert some.machine_values(name) == pytest.approx(small.machine_values(name), abs=1e-12)
        assert some.machine_values("power") == pytest.approx(small.machine_values("power"), abs=1e-11)
        assert some.wtg_values("power") == pytest.approx(small.wtg_values("power"), abs=1e-12)
        assert some.lane_values("coi") == pytest.approx(small.lane_values("coi"), abs=1e-13)


def test_conductances_follow_the_frequency_of_their_island():
    settings, what = parted(load_frequency_dependence=2.0), scenario(*cut(1.0), wind=PARTED_WIND)
    simulator = started(settings, what)
    recorded(simulator, 3.0)
    centres = simulator.blocks[0, simulator.layout.rows_of(ISLANDS, "centre"), 0]
    assert np.ptp(centres[:2]) > 1e-4
    # In a control interval it is that of its beginning.
    before = simulator.blocks[0, simulator.layout.rows_of(ISLANDS, "centre"), 0]
    simulator.advance()
    load = simulator.layout.first_rows(BUSES, "load")
    load = simulator.blocks[0, load, 0] + 1j * simulator.blocks[0, load + 1, 0]
    island = simulator.blocks[0, simulator.layout.rows_of(BUSES, "island"), 0].astype(int)
    passive = started(parted(), what)
    recorded(passive, 3.1)
    assert np.abs(passive.blocks[0, passive.layout.first_rows(BUSES, "load"), 0] - load.real).max() == 0.0
    # The matrix is written with the centre as it is when it is asked for.
    simulator.blocks[0, simulator.layout.rows_of(ISLANDS, "centre"), 0] = before
    change = bus_matrix(simulator) - bus_matrix(passive)
    assert np.abs(change - np.diag(load.real * 2.0 * (before[island] - 1.0))).max() < 1e-14


EVERY = (
    sc.Fault(time_s=1.0, bus=4, clears_after_s=0.15, resistance_pu=0.01, reactance_pu=0.02, opens=(2, 4)),
    sc.Fault(time_s=2.0, bus=4, clears_after_s=0.15),
    sc.LineTrip(time_s=1.0, from_bus=4, to_bus=5, recloses_after_s=1.5),
    sc.ReactanceStep(time_s=1.0, from_bus=1, to_bus=2, factor=2.0),
    sc.PhaseJump(time_s=1.0, bus=1, angle_deg=-30.0),
    sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=1.0, duration_s=2.0),
    sc.MachineOutage(time_s=1.0, bus=6),
    sc.GroupTrip(time_s=1.0, group=0),
)


def test_every_event_and_the_commitment_come_back_from_text():
    what = scenario(*EVERY, committed=0.5)
    again = sc.Scenario.from_json(what.to_json())
    assert again.events == EVERY and again.committed == 0.5
    assert again.to_json() == what.to_json()
