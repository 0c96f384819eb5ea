"""What a simulator refuses, and that it can be copied."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import GridFormingParameters, ProtectionParameters, WtgGroup
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import GovernorLoss, GroupTrip, LineTrip, LoadStep, LoadTrip, MachineOutage, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.scenarios import get_suite

LAW = STRATEGIES["coordinated-piecewise"]
WIND = np.array([[11.4], [8.0]])
IEEE14 = modified_ieee14()
UNWEIGHTED = tuple(dataclasses.replace(machine, reactive_weight=0.0) for machine in IEEE14.machines)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"simulation_dt": 0.03}, r"control_dt = 0.1 s is not a whole number of simulation steps of 0.03 s"),
        ({"simulation_dt": 0.0}, r"simulation_dt = 0 s is outside the allowed range"),
        ({"simulation_dt": -0.01}, r"simulation_dt = -0.01 s is outside"),
        ({"simulation_dt": float("nan")}, r"simulation_dt = nan s is outside"),
        ({"control_dt": 0.001}, r"control_dt = 0.001 s is outside the allowed range 0.025 … 10 s"),
        ({"groups": (WtgGroup(bus=99),)}, r"unknown bus 99; .* has buses \[1, 2"),
        ({"groups": None}, r"PlantSettings.groups must be a tuple of WtgGroup, got None"),
        ({"groups": [{"bus": 2}]}, r"PlantSettings.groups must be a tuple of WtgGroup, got"),
        (
            {"case": dataclasses.replace(IEEE14, machines=UNWEIGHTED)},
            r"reactive_weight is 0 MVA for every machine at bus 1; one must have more",
        ),
        ({"case": "ieee14"}, r"PlantSettings.case must be NetworkCase, got 'ieee14'"),
        ({"trips_groups": "no"}, r"PlantSettings.trips_groups must be bool, got 'no'"),
        (
            {"control": GridFormingParameters(frequency_setpoint_pu=0.998)},
            r"start at nominal frequency, so that frequency_setpoint_pu must be 1 p.u., got 0.998 p.u.",
        ),
    ],
)
def test_impossible_plants_are_named(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PlantSettings(**settings)


@pytest.mark.parametrize(("n_turbines", "voltage"), [(0.01, "631"), (1.0, "7.2")])
def test_internal_voltages_that_nobody_builds_are_refused_with_the_numbers(n_turbines: float, voltage: str) -> None:
    message = (
        rf"WTG group 0 at bus 2 needs an internal voltage of {voltage}.* p.u. to hold 1.045 p.u. .* at most 2 p.u."
    )
    with pytest.raises(ValueError, match=message):
        Simulator(PlantSettings(groups=(WtgGroup(bus=2, n_turbines=n_turbines),)))


def test_internal_voltages_of_machines_are_refused_too() -> None:
    case = modified_ieee14(classical=True)
    small = (*case.machines[:3], dataclasses.replace(case.machines[3], rating_mva=3.0))
    with pytest.raises(ValueError, match=r"the synchronous machine at bus 8 needs an internal voltage of .* at most 2"):
        Simulator(PlantSettings(case=dataclasses.replace(case, machines=small)))


def test_a_start_beyond_the_allowed_internal_voltage_names_its_scenario() -> None:
    simulator = Simulator(PlantSettings(protection=ProtectionParameters(internal_voltage_max_pu=1.45)))
    laws = (LAW, LAW)
    simulator.prepare([Scenario(name="x", wind_speed=WIND)], laws)
    loaded = Scenario(name="loaded", wind_speed=np.full((2, 1), 11.4), load_level=1.5)
    with pytest.raises(ValueError, match=r"scenario 'loaded' cannot start: WTG group 0 at bus 2 needs .* at most 1.45"):
        simulator.prepare([Scenario(name="x", wind_speed=WIND), loaded], laws)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (
            {"events": (LoadStep(time_s=1.003, bus=2, power_mw=1.0),)},
            r"event time = 1.003 s is not a whole number of simulation steps of 0.025 s",
        ),
        ({"events": (LoadTrip(time_s=1.0, bus=15),)}, r"unknown bus 15"),
        ({"events": (LineTrip(time_s=1.0, from_bus=1, to_bus=9),)}, r"no branch 1-9"),
        ({"events": (LineTrip(time_s=1.0, from_bus=7, to_bus=8),)}, r"would split the network"),
        (
            {"events": (LoadTrip(time_s=1.0, bus=9), LoadTrip(time_s=2.0, bus=9))},
            r"disconnects a load twice; .*\[9, 9\]",
        ),
        (
            {"events": tuple(LineTrip(time_s=t, from_bus=1, to_bus=2) for t in (1.0, 2.0))},
            r"opens the line 1-2 twice",
        ),
        (
            {"events": (LineTrip(time_s=1.0, from_bus=1, to_bus=2, recloses_after_s=0.51),)},
            r"recloses_after_s = 0.51 s is not a whole number of simulation steps of 0.025 s",
        ),
        (
            {"events": (LineTrip(time_s=1.0, from_bus=7, to_bus=8, recloses_after_s=0.5),)},
            r"would split the network",
        ),
        ({"events": (GroupTrip(time_s=1.0, group=2),)}, r"unknown WTG group 2; the plant has 2, counted from 0"),
        (
            {"events": tuple(GroupTrip(time_s=t, group=1) for t in (1.0, 2.0))},
            r"disconnects WTG group 1 at bus 2 twice",
        ),
        ({"events": (GovernorLoss(time_s=1.0, bus=15),)}, r"unknown bus 15"),
        (
            {"events": (GovernorLoss(time_s=1.0, bus=3),)},
            r"no machine with a governor at bus 3; buses with one: \[1\]",
        ),
        (
            {"events": tuple(GovernorLoss(time_s=t, bus=1) for t in (1.0, 2.0))},
            r"loses the governor of the synchronous machine at bus 1 twice",
        ),
        (
            {"events": (MachineOutage(time_s=1.0, bus=2),)},
            r"no synchronous machine at bus 2; buses with one: \[1, 3, 6, 8\]",
        ),
        (
            {"events": tuple(MachineOutage(time_s=t, bus=6) for t in (1.0, 2.0))},
            r"disconnects the synchronous machine at bus 6 twice",
        ),
        (
            {"events": tuple(MachineOutage(time_s=1.0, bus=bus) for bus in (8, 1, 6, 3))},
            r"disconnects every synchronous machine; one must stay connected",
        ),
        ({"load_noise_bus": 77}, r"unknown bus 77"),
        ({"duration_s": 300.0}, r"lasts 300 s, longer than the 120 s held here"),
        ({"wind_speed": np.full((3, 1), 9.0)}, r"has wind for 3 WTG groups .* the plant has 2 groups"),
    ],
)
def test_scenarios_that_do_not_fit_are_named(simulator: Simulator, scenario: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulator.start(0, Scenario(**{"name": "x", "wind_speed": WIND, **scenario}), (LAW, LAW))


@pytest.mark.parametrize("duration_s", [-5.0, float("nan"), 1e12])
def test_impossible_durations_are_refused(duration_s: float) -> None:
    with pytest.raises(ValueError, match=r"duration_s = .* s is outside the allowed range 0 … 86400 s"):
        Simulator(PlantSettings(), duration_s=duration_s)


def test_load_noise_in_a_network_with_a_phase_shifter_is_refused() -> None:
    case = modified_ieee14()
    shifted = (dataclasses.replace(case.branches[0], phase_rad=0.1), *case.branches[1:])
    simulator = Simulator(PlantSettings(case=dataclasses.replace(case, branches=shifted)))
    scenario = Scenario(name="x", wind_speed=WIND, load_noise_mw=np.array([0.0, 5.0]))
    with pytest.raises(ValueError, match=r"scenario 'x': load noise needs a network without phase shifters"):
        simulator.start(0, scenario, (LAW, LAW))
    simulator.start(0, dataclasses.replace(scenario, load_noise_mw=np.zeros(2)), (LAW, LAW))


@pytest.mark.parametrize("control_dt", [0.05, 0.1, 0.2])
def test_load_noise_ends_with_its_series_at_every_control_interval(control_dt: float) -> None:
    scenario = Scenario(name="x", wind_speed=WIND, duration_s=2.0, load_noise_mw=np.array([0.0, 0.0, 40.0, 40.0]))
    simulator = Simulator(PlantSettings(control_dt=control_dt), duration_s=2.0)
    simulator.start(0, scenario, (LAW, LAW))
    noise = simulator.data.noise[0]
    assert noise.sum() * control_dt == pytest.approx(2 * 40.0 * 0.1)
    assert (noise[round(0.4 / control_dt) :] == 0.0).all()


def test_what_is_no_scenario_is_refused() -> None:
    with pytest.raises(ValueError, match="scenario must be a Scenario, got str"):
        simulate("load-increase", "mppt")  # type: ignore[arg-type]


def test_a_plant_without_groups_can_be_simulated() -> None:
    run = simulate(Scenario(name="x", wind_speed=np.zeros((0, 1)), duration_s=1.0), (), PlantSettings(groups=()))
    assert run.power_pu.shape == (11, 0)
    assert run.frequency_hz == pytest.approx(np.full(11, 50.0))


@pytest.mark.parametrize("n_lanes", [0, -3, 1.5, True])
def test_impossible_numbers_of_lanes_are_refused(n_lanes: Any) -> None:
    with pytest.raises(ValueError, match="number of lanes must be 1"):
        Simulator(PlantSettings(), n_lanes=n_lanes)


def test_copies_and_snapshots_go_on_bit_for_bit() -> None:
    events = tuple(LoadStep(time_s=float(t), bus=2, power_mw=10.0) for t in range(1, 8))
    simulator = Simulator(PlantSettings(), n_lanes=3)
    for lane in range(3):
        simulator.start(lane, Scenario(name="x", wind_speed=WIND + 0.1 * lane, events=events), (LAW, LAW))
    for _ in range(25):
        simulator.advance()
    others = [pickle.loads(pickle.dumps(simulator)), copy.deepcopy(simulator)]
    snapshot = simulator.snapshot()
    ends = []
    for run in (simulator, *others):
        for _ in range(40):
            run.advance()
        ends.append(run.blocks.copy())
    simulator.start(1, Scenario(name="other", wind_speed=WIND), (LAW, LAW))
    simulator.restore(snapshot)
    for _ in range(40):
        simulator.advance()
    ends.append(simulator.blocks.copy())
    for end in ends[1:]:
        assert (end == ends[0]).all()


def test_a_finer_control_interval_does_not_change_a_run_without_noise() -> None:
    scenario = Scenario(name="x", wind_speed=WIND, events=(LoadStep(time_s=0.4, bus=2, power_mw=50.0),))
    ends = []
    for control_dt in (0.025, 0.1, 0.2):
        simulator = Simulator(PlantSettings(control_dt=control_dt))
        simulator.start(0, scenario, (LAW, LAW))
        for _ in range(round(4.0 / control_dt)):
            simulator.advance()
        ends.append(simulator.state())
    assert (ends[0] == ends[1]).all()
    assert (ends[0] == ends[2]).all()


def test_bus_voltages_are_those_at_the_machines_terminals() -> None:
    """Recovered from the whole network, against the machines' own equations, through steps, ramps and noise."""
    scenario = get_suite("standard").scenario(20_003)
    simulator = Simulator(PlantSettings(), duration_s=scenario.duration_s)
    simulator.start(0, scenario, (LAW, LAW))
    assert scenario.events and scenario.load_noise_mw.any()
    case = simulator.settings.case
    for _ in range(simulator.n_intervals):
        magnitude = np.abs(simulator.bus_voltages())
        for i, machine in enumerate(case.machines):
            own = simulator.machine_values("voltage")[0, i]
            assert magnitude[case.bus_index(machine.bus)] == pytest.approx(own, abs=1e-12)
        simulator.advance()


def test_runs_prepared_together_equal_runs_prepared_alone_bit_for_bit() -> None:
    simulator = Simulator(PlantSettings())
    scenarios = [get_suite("weak-grid").scenario(seed) for seed in range(20_000, 20_030)]
    together = simulator.prepare(scenarios, (LAW, LAW))
    for i, scenario in enumerate(scenarios):
        alone = simulator.prepare([scenario], (LAW, LAW))
        n_events = alone.data.events.shape[1]
        assert (together.rows[i] == alone.rows[0]).all()
        assert (together.data.events[i, :n_events] == alone.data.events[0]).all()
        for one, many in zip(alone.data[:-1], together.data[:-1], strict=True):
            assert (many[i] == one[0]).all()


def test_one_run_that_cannot_start_stops_all_that_are_prepared_with_it() -> None:
    simulator = Simulator(PlantSettings(), n_lanes=2)
    good = Scenario(name="good", wind_speed=WIND)
    bad = Scenario(name="bad", wind_speed=np.full((2, 1), 25.0), load_level=0.3)
    with pytest.raises(ValueError, match="scenario 'bad' cannot start"):
        simulator.prepare([good, bad, good], (LAW, LAW))
