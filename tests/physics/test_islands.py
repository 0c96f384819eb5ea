"""Facts about networks that fall apart, that join again in step, and that lose their last machine."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.physics.extended import LAW, NO_SHEDDING, largest_rate, numbers, plant, recorded, scenario, started
from wtg_gym import GroupTrip, LineTrip, LoadStep, MachineOutage, Plant, get_law, get_suite, simulate
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.layout import n_rows_of
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.physics.protection import STAGES, Status
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.units import BUSES, ISLANDS, TripCause
from wtg_gym.physics.wtg_unit import EXTENSIONS, GROUPS
from wtg_gym.systems.systems import Kind

#: Lines between buses 1 … 5, which have the more load, and 6 … 14; a group lives in either part.
CUT = ((5, 6), (4, 7), (4, 9))
NORTH, SOUTH = (1, 2, 3, 4, 5), tuple(range(6, 15))
PARTED = (WtgGroup(bus=2, n_turbines=20.0), WtgGroup(bus=9, n_turbines=18.0))
PARTED_WIND = [[9.0], [11.4]]
ALL_WIND = (WtgGroup(bus=2, n_turbines=50.0), WtgGroup(bus=6, n_turbines=30.0))
V1 = get_suite("standard-v1").plant


def cut(time_s: float, lines: tuple[tuple[int, int], ...] = CUT, again_s: float | None = None) -> tuple[LineTrip, ...]:
    return tuple(LineTrip(time_s=time_s, from_bus=f, to_bus=t, recloses_after_s=again_s) for f, t in lines)


def parted(**more: object) -> Plant:
    return plant(**{"groups": PARTED, "shedding": NO_SHEDDING, **more})


def rows_of(simulator: Simulator, kind: Kind, units: list[int]) -> np.ndarray:
    """All rows of some units of a kind (n_units, n_rows)."""
    n = n_rows_of(kind.rows)
    return simulator.layout.first[kind] + np.add.outer(np.array(units, dtype=int) * n, np.arange(n))


def alone(settings: Plant, buses: tuple[int, ...], slack: int) -> Plant:
    whole = settings.case
    inside = tuple(bus for bus in whole.buses if bus.number in buses)
    lines = tuple(b for b in whole.branches if b.from_bus in buses and b.to_bus in buses)
    machines, groups = (tuple(u for u in units if u.bus in buses) for units in (whole.machines, settings.groups))
    case = dataclasses.replace(whole, slack_bus=slack, buses=inside, branches=lines, machines=machines)
    return dataclasses.replace(settings, case=case, groups=groups)


@pytest.mark.parametrize(("buses", "slack"), [(NORTH, 1), (SOUTH, 6)], ids=["grid", "second island"])
def test_an_island_runs_as_a_network_that_consists_of_it_alone(buses, slack):
    settings = parted(load_frequency_dependence=1.0)
    whole = started(settings, scenario(LoadStep(time_s=0.5, bus=13, power_mw=5.0), *cut(1.0), wind=PARTED_WIND))
    recorded(whole, 1.0)
    groups = [j for j, group in enumerate(settings.groups) if group.bus in buses]
    machines = [i for i, machine in enumerate(settings.case.machines) if machine.bus in buses]
    events = [LoadStep(time_s=0.0, bus=13, power_mw=5.0)] if 13 in buses else []
    what = scenario(*events, wind=np.array(PARTED_WIND)[groups], load_noise_bus=slack)
    part = started(alone(settings, buses, slack), what)
    at = [settings.case.bus_index(bus) for bus in buses]
    for kind, own in ((MACHINES, machines), (GROUPS, groups), (EXTENSIONS, groups), (BUSES, at)):
        into = rows_of(part, kind, list(range(len(own))))
        part.blocks[0, into, 0] = whole.blocks[0, rows_of(whole, kind, own), 0]
    if events:
        event = part.data.events[0, :1]
        event[:] = whole.data.events[0, 0]
        event["start"] = event["end"] = 0.0
        event["bus"] = buses.index(13)
    part.blocks[0, part.layout.first_rows(ISLANDS, "centre")] = whole.env_values("coi")[0]
    part.blocks[0, part.layout.env("next_change"), 0] = 0.0
    island = 0 if slack == 1 else 1
    for _ in range(30):
        whole.advance()
        part.advance()
        for name in ("speed", "power", "voltage"):
            own, expected = whole.machine_values(name)[0, machines], part.machine_values(name)[0]
            assert own == pytest.approx(expected, abs=1e-11), name
        for name in ("speed", "power", "rotor_speed", "terminal_voltage"):
            assert whole.wtg_values(name)[0, groups] == pytest.approx(part.wtg_values(name)[0], abs=1e-11), name
        centre = numbers(whole, ISLANDS, "centre")[island]
        assert centre == pytest.approx(part.env_values("coi")[0], abs=1e-12)
    assert abs(centre - 1.0) > 5e-5


def test_parts_without_a_unit_are_dark_and_count_as_not_served():
    settings = parted()
    dark = cut(1.0, ((9, 14), (13, 14)), 1.0)
    simulator = started(settings, scenario(*dark, LoadStep(time_s=0.5, bus=14, power_mw=4.0), wind=PARTED_WIND))
    load = simulator.layout.first_rows(BUSES, "load")[13]
    recorded(simulator, 1.5)
    voltage = np.abs(simulator.bus_voltages())
    assert voltage[13] == 0.0 and numbers(simulator, BUSES, "island")[13] == -1.0 and (voltage[:13] > 0.9).all()
    conductance = simulator.blocks[0, load, 0]
    unserved = simulator.env_values("unserved")[0]
    assert unserved == pytest.approx(conductance + simulator.data.events["active"][0, 2], abs=1e-15)
    assert simulator.env_values("shed_energy")[0] == pytest.approx(0.5 * unserved, rel=1e-12)
    recorded(simulator, 1.0)
    assert abs(simulator.bus_voltages()[13]) > 0.9 and (numbers(simulator, BUSES, "island") == 0.0).all()
    assert simulator.env_values("unserved")[0] == 0.0
    assert simulator.env_values("shed_energy")[0] == pytest.approx(unserved, rel=1e-12)
    assert simulator.env_values("status")[0] == Status.RUNNING


def test_shedding_acts_in_the_island_with_the_deficit_alone():
    simulator = started(plant(groups=PARTED), scenario(*cut(1.0), wind=[[9.0], [7.0]]))
    recorded(simulator, 6.0)
    served = numbers(simulator, BUSES, "served")
    south = numbers(simulator, BUSES, "island") == 1.0
    assert simulator.env_values("split")[0] == 1.0
    assert (served[~south] == 1.0).all() and np.ptp(served[south]) == 0.0 and served[south][0] < 0.96
    load = numbers(simulator, BUSES, "load")
    assert simulator.env_values("unserved")[0] == pytest.approx((1.0 - served) @ load, abs=1e-14)
    shed = numbers(simulator, STAGES, "shed").reshape(4, -1)
    assert (shed[0] >= 0.0).all() and (shed[1] < 0.0).any()


def test_a_second_island_beyond_its_limits_trips_its_units_and_the_run_goes_on():
    # Condensers alone feed the load of their part.
    simulator = started(plant(shedding=NO_SHEDDING), scenario(*cut(1.0)))
    recorded(simulator, 30.0)
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert simulator.machine_values("connected")[0].tolist() == [1.0, 1.0, 0.0, 0.0]
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 1.0]
    assert (numbers(simulator, BUSES, "island") == [0.0] * 5 + [-1.0] * 9).all()
    assert (simulator.bus_voltages()[5:] == 0.0).all()
    load = numbers(simulator, BUSES, "load")
    assert simulator.env_values("unserved")[0] == pytest.approx(load[5:].sum(), abs=1e-14)


def test_a_group_goes_with_its_island():
    outages = (MachineOutage(time_s=1.0, bus=bus) for bus in (6, 8))
    run = simulate(scenario(*cut(1.0), *outages, wind=[[9.0], [7.0]], duration_s=30.0), LAW, parted())
    assert run.status == Status.RUNNING and run.connected[-1].tolist() == [True, False]
    assert run.trip_causes == (None, TripCause.ISLAND_LOST)
    assert (run.bus_voltage_pu[-1, 5:] == 0.0).all() and (run.bus_voltage_pu[-1, :5] > 0.9).all()


def test_the_end_of_the_grid_is_the_end_of_the_run():
    # All that generates is in the part with less load.
    groups = (WtgGroup(bus=2, n_turbines=10.0),) * 2
    lines = ((1, 5), (2, 3), (2, 4), (2, 5))
    simulator = started(plant(groups=groups, shedding=NO_SHEDDING), scenario(*cut(1.0, lines)))
    recorded(simulator, 30.0)
    assert simulator.env_values("status")[0] in (Status.FREQUENCY_LIMIT, Status.VOLTAGE_COLLAPSE)
    assert simulator.env_values("active")[0] == 0.0


def test_without_its_last_machine_a_grid_of_converters_runs_on():
    settings = plant(groups=(WtgGroup(bus=2, n_turbines=40.0), WtgGroup(bus=6, n_turbines=20.0)), shedding=NO_SHEDDING)
    outages = tuple(MachineOutage(time_s=t, bus=bus) for t, bus in ((1.0, 3), (1.0, 6), (1.0, 8), (2.0, 1)))
    simulator = started(settings, scenario(*outages, wind=[[11.0], [11.0]]))
    recorded(simulator, 2.0)
    held = simulator.machine_values("speed")[0, 0]
    result = recorded(simulator, 20.0, "speed", "power")
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert (simulator.machine_values("connected")[0] == 0.0).all()
    # The frame of all angles turns on with the speed that the first machine had last.
    assert simulator.machine_values("speed")[0, 0] == held
    assert np.ptp(result["speed"][-1]) < 1e-6
    angles = simulator.env_values("angle")[0]
    simulator.advance()
    turned = simulator.env_values("angle")[0] - angles
    assert turned == pytest.approx(0.1 * 100.0 * np.pi * (held - 1.0), rel=1e-9, abs=1e-12)


def test_wind_turbines_alone_share_the_load_by_one_factor_on_k_or_too_little_wind_is_said_in_one_line():
    case = dataclasses.replace(get_grid("ieee14").case, machines=(), slack_bus=2)
    settings = plant(case=case, groups=ALL_WIND, shedding=NO_SHEDDING)
    step = LoadStep(time_s=1.0, bus=3, power_mw=10.0)
    simulator = started(settings, scenario(step, wind=[[10.5], [10.0]], load_noise_bus=2))
    assert largest_rate(simulator) < 1e-10
    law = get_law(LAW, settings.turbine)
    factors = [simulator.wtg_values(name)[0] / getattr(law, name) for name in ("k_min", "k_nominal", "k_max")]
    assert np.ptp(factors) < 1e-12 and 0.1 < np.mean(factors) < 1.0
    power, rotor = (simulator.wtg_values(name)[0] for name in ("power", "rotor_speed"))
    assert power == pytest.approx(simulator.wtg_values("k_nominal")[0] * rotor**3, abs=1e-11)
    voltage = simulator.bus_voltages()
    assert np.abs(voltage[1]) == pytest.approx(1.045, abs=1e-10)
    result = recorded(simulator, 30.0, "speed")
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert 0.99 < result["coi"][-1] < 0.9999 and np.ptp(result["speed"][-1]) < 1e-6
    with pytest.raises(ValueError, match=r"^[^\n]*WTG groups alone cannot meet the load at a level of 1;[^\n]*$"):
        started(settings, scenario(wind=[[7.0], [6.0]], load_noise_bus=2))


def played(*events: Event, wind: float = 9.0, seconds: float = 25.0) -> Simulator:
    simulator = started(V1, scenario(*events, wind=np.full((4, 1), wind), duration_s=seconds))
    recorded(simulator, seconds)
    return simulator


@pytest.mark.parametrize("again_s", [5.0, 12.0])
def test_what_joins_in_phase_has_not_lost_synchronism(again_s):
    simulator = played(*cut(1.0, ((5, 6), (10, 11), (13, 14)), again_s))
    assert simulator.env_values("status")[0] == Status.RUNNING
    assert simulator.env_values("coi")[0] == pytest.approx(1.0, abs=0.01)


def test_a_grid_that_a_part_joins_remembers_which_stages_have_acted():
    # Two small buses in the west join the rest, which has shed.
    simulator = played(*cut(1.0, ((1, 5), (2, 3), (2, 4), (2, 5)), 0.9), wind=8.0, seconds=2.1)
    n_stages = len(V1.shedding)
    shed = [simulator.values(row)[0] for row in simulator.layout.first_rows(STAGES, "shed")[:n_stages]]
    assert min(shed) < 0.0


def test_energy_that_is_not_served_is_never_negative():
    away = (*cut(1.0, ((7, 8),)), GroupTrip(time_s=1.0, group=3), MachineOutage(time_s=1.0, bus=8))
    simulator = played(*away, LoadStep(time_s=2.0, bus=8, power_mw=-50.0), seconds=5.0)
    assert simulator.env_values("shed_energy")[0] == 0.0
