"""Facts about grids: as files they come back as they were or are refused clearly; their power flows; what they play."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from tests.changes import write
from tests.physics.extended import classical, scenario, started
from wtg_gym import GFMWTGEnv, LineTrip, Plant, Scenario
from wtg_gym.physics import network
from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.equilibrium import FLOW_COLUMNS
from wtg_gym.physics.grid import FOLDER, Branch, Bus, Grid, NetworkCase, get_grid, grid_text, known_grids, read_grid
from wtg_gym.physics.layout import n_rows_of
from wtg_gym.physics.linearisation import moving_matrix, swing_modes
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup, nrel_5mw
from wtg_gym.physics.plant import plant_tables
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import group_laws
from wtg_gym.physics.units import BUSES

#: A grid that nobody has seen: two machines, a ring of five buses at 60 Hz, on 250 MVA.
STRANGER = json.loads((Path(__file__).parent / "stranger.json").read_text(encoding="utf-8"))
# Solution of the IEEE 14-bus test case: voltage [p.u.] and angle [deg] of buses 1 … 14, as printed in the archive.
VOLTAGES = (1.060, 1.045, 1.010, 1.019, 1.020, 1.070, 1.062, 1.090, 1.056, 1.051, 1.057, 1.055, 1.050, 1.036)
ANGLES = (0.0, -4.98, -12.72, -10.33, -8.78, -14.22, -13.37, -13.36, -14.94, -15.10, -14.79, -15.07, -15.16, -16.04)


@pytest.mark.parametrize("name", known_grids())
def test_a_grid_comes_back_from_its_file(name, tmp_path):
    grid = get_grid(name)
    path = write(tmp_path / "again.json", grid_text(grid))
    assert read_grid(path) == grid and path.read_text() == (FOLDER / f"{name}.json").read_text()
    assert grid.source and grid.licence


def test_a_grid_that_is_an_object_plays_as_its_file_does():
    grid = get_grid("kundur")
    env = GFMWTGEnv(grid=grid)
    path = Path(env.settings.suite_name)
    assert read_grid(path) == grid
    # The file of its name counts only with what belongs into it.
    path.write_text(grid_text(get_grid("ieee39")), encoding="utf-8")
    assert GFMWTGEnv(grid=grid).settings.resolved_plant == env.settings.resolved_plant and read_grid(path) == grid
    assert np.isfinite(env.reset(seed=1)[0]).all()


def test_machines_share_what_the_wind_leaves_by_rating_and_gate():
    grid = get_grid("ieee39")
    plant = Plant().replaced(physics="extended", case=grid.with_groups, groups=grid.groups, shares_dispatch=True)
    for wind in (9.5, 10.2):
        simulator = started(plant, scenario(wind=np.full((6, 1), wind), load_noise_bus=39), "coordinated-tuned")
        # A slack machine that is left with the losses' rest deviates by that alone.
        assert np.ptp(simulator.machine_values("gate")[0]) < 2e-3


def test_kundurs_areas_swing_as_in_the_book():
    case = get_grid("kundur").case
    bare = {"exciter": None, "stabiliser": None, "governor": None}
    machines = tuple(dataclasses.replace(machine, **bare) for machine in case.machines)
    rest = scenario(wind=np.zeros((0, 1)), load_noise_bus=7)
    simulator = started(Plant(case=dataclasses.replace(case, machines=machines), groups=()), rest)
    simulator.evaluate()
    matrix, _ = moving_matrix(simulator.blocks[0, :, 0], simulator.plant, simulator.layout, -1.0)
    # Kundur: Power System Stability and Control, example 12.6, with manual excitation, saturation and other loads.
    modes = swing_modes(np.linalg.eigvals(matrix))
    assert sorted(hertz for _, hertz in modes) == pytest.approx([0.545, 1.087, 1.117], rel=0.01)


def test_a_parallel_line_trips_by_its_circuit():
    case = get_grid("kundur").case
    assert case.branch_index(7, 8) == case.branch_index(8, 7, 1) != case.branch_index(7, 8, 2)
    with pytest.raises(ValueError, match="no circuit 3 between buses 7 and 8; there are 2"):
        case.branch_index(7, 8, 3)
    trips = (LineTrip(time_s=0.1, from_bus=7, to_bus=8), LineTrip(time_s=0.2, from_bus=8, to_bus=7, circuit=2))
    still = dict(wind_speed=np.zeros((0, 1)), duration_s=1.0, load_noise_bus=7)
    with pytest.raises(ValueError, match="would split the network"):
        Simulator(Plant(case=case, groups=()), duration_s=1).prepare([Scenario(name="both", events=trips, **still)], [])


def test_bridges_are_what_takes_the_network_apart():
    rng = np.random.default_rng(0)
    for _ in range(50):
        n = int(rng.integers(2, 12))
        ends = [(int(rng.integers(1, k)), k) for k in range(2, n + 1)]
        ends += [(int(a), int(b)) for a, b in rng.integers(1, n + 1, (int(rng.integers(0, 6)), 2)) if a != b]
        buses = tuple(Bus(number=k, voltage_pu=1.0) for k in range(1, n + 1))
        lines = tuple(Branch(from_bus=a, to_bus=b, resistance=0.0, reactance=0.1) for a, b in ends)
        base = {"name": "random", "base_mva": 1.0, "frequency_hz": 50.0, "slack_bus": 1}
        case = NetworkCase(buses=buses, branches=lines, machines=(), **base)
        apart = {index for index in range(len(ends)) if len(case.parts_without((index,))) > 1}
        assert case.bridges == apart


def test_a_grid_names_what_its_groups_replace():
    grid = get_grid("ieee39")
    assert {machine.bus for machine in grid.with_groups.machines} == {30, 31, 34, 37}
    with pytest.raises(ValueError, match="unknown bus 99"):
        Grid(case=grid.case, groups=(WtgGroup(bus=99),))
    assert dataclasses.replace(grid, groups=(), replaced=()).with_groups == grid.case


def test_groups_have_turbines_of_their_own():
    small = TurbineParameters(rated_power_mw=2.0, blade_radius_m=40.0, nominal_rotor_speed_rad_s=1.8)
    groups = WtgGroup(bus=2, n_turbines=10.0), WtgGroup(bus=3, n_turbines=10.0, turbine=small)
    plant = Plant().replaced(physics="extended", groups=groups)
    simulator, laws = Simulator(plant, duration_s=60.0), group_laws("coordinated-piecewise", plant.turbines)
    assert laws[0].k_nominal != laws[1].k_nominal
    simulator.start(0, scenario(wind=np.full((2, 1), 9.0)), laws)
    simulator.evaluate()
    for group, (turbine, law) in enumerate(zip(plant.turbines, laws, strict=True)):
        speed, power = (simulator.wtg_values(name)[0, group] for name in ("rotor_speed", "power"))
        assert power == pytest.approx(law.k_nominal * speed**3, abs=1e-9)
        assert simulator.wtg_values("captured")[0, group] == pytest.approx(power, abs=1e-9)
        assert power < available_power_pu(9.0, turbine)
    # Ten turbines of 5 and of 2 MW, on 100 MVA.
    assert simulator.plant.share.tolist() == [0.5, 0.2]
    with pytest.raises(ValueError, match="must have one C_p curve"):
        Plant().replaced(physics="extended", groups=(groups[0], WtgGroup(bus=3, turbine=nrel_5mw())))


def flow_table(case: NetworkCase, power: np.ndarray):
    """Admittance matrix, slack bus, and the table that a power flow of these powers of units [p.u.] fills in."""
    plant, at = plant_tables(Plant(case=case, groups=())), FLOW_COLUMNS
    buses = np.zeros((len(case.buses), n_rows_of(BUSES.scratch)))
    buses[:, at.power] = power.real - plant.buses["load.re"]
    buses[:, at.power + 1] = power.imag - plant.buses["load.im"]
    buses[:, at.polar], buses[:, at.holds_voltage] = plant.buses["voltage"], plant.buses["holds_voltage"]
    return plant.bus_y, case.bus_index(case.slack_bus), buses


def test_power_flow_meets_the_published_solution_of_the_ieee_14_bus_system_and_an_impossible_one_is_reported():
    case = get_grid("ieee14").case
    original = dataclasses.replace(case, machines=(*case.machines, classical(bus=2, dispatch_mw=40.0)))
    power = np.zeros(14, dtype=np.complex128)
    power[1] = 0.4
    y, slack, buses = flow_table(original, power)
    assert 0 < network.solve_power_flow(y, slack, buses, FLOW_COLUMNS) <= 6
    assert buses[:, FLOW_COLUMNS.polar] == pytest.approx(VOLTAGES, abs=1.5e-3)
    assert np.degrees(buses[:, FLOW_COLUMNS.polar + 1]) == pytest.approx(ANGLES, abs=0.03)
    power[13] = -30.0
    assert network.solve_power_flow(*flow_table(case, power), FLOW_COLUMNS) == -1


@pytest.mark.parametrize("name", known_grids())
def test_the_sparse_power_flow_finds_what_the_dense_one_finds(name):
    case = get_grid(name).case
    power = np.zeros(len(case.buses), dtype=np.complex128)
    for machine in case.machines:
        power[case.bus_index(machine.bus)] += machine.dispatch_mw / case.base_mva
    y, slack, dense = flow_table(case, power)
    sparse = dense.copy()
    assert network.solve_power_flow(y, slack, dense, FLOW_COLUMNS) > 0
    assert network.solve_sparse_flow(y, slack, sparse, FLOW_COLUMNS, network.pattern_of(y)) > 0
    assert np.abs(dense - sparse).max() < 1e-10


def test_off_nominal_tap_and_phase_follow_the_pi_model():
    tap, phase, y = 0.9, 0.2, 1.0 / complex(0.01, 0.1)
    branch = Branch(from_bus=1, to_bus=2, resistance=0.01, reactance=0.1, charging=0.04, tap=tap, phase_rad=phase)
    ratio = tap * np.exp(1j * phase)
    expected = [(y + 0.02j) / tap**2, -y / np.conj(ratio), -y / ratio, y + 0.02j]
    assert network.branch_admittances((branch,))[0] == pytest.approx(np.array(expected))
