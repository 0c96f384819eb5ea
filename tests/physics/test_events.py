"""Facts about events that take units, governors and lines away, and about lines that come back."""

import dataclasses

import numpy as np

from tests.physics.extended import phasors, recorded, scenario
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.units import BUSES, PAIRS, UNITS

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


def whole_network(simulator: Simulator, what: sc.Scenario, now_s: float) -> tuple[np.ndarray, list[int]]:
    """The admittance matrix of loads, shunts and closed branches during the step that ends now, and who is connected.

    From the scenario itself, without the simulator's own table of events.
    """
    plant, case = simulator.plant.network, simulator.settings.case
    step_s, control_s = simulator.plant.simulation_dt, simulator.settings.control_dt
    at = now_s - 0.5 * step_s
    start = Simulator(simulator.settings)
    start.start(0, dataclasses.replace(what, events=()), LAWS)
    held = np.abs(start.bus_voltages())
    first = start.layout.first_rows(BUSES, "load")
    held_load = start.blocks[0, first, 0] + 1j * start.blocks[0, first + 1, 0]
    loads = held_load.copy()
    opened = np.zeros(len(plant.branch_y), dtype=bool)
    connected = list(range(simulator.layout.n_unit))
    for event in what.events:
        if event.time_s > at:
            continue
        if isinstance(event, sc.LineTrip):
            if event.recloses_after_s is None or at < event.time_s + event.recloses_after_s:
                opened[case.branch_index(event.from_bus, event.to_bus)] = True
        elif isinstance(event, sc.GroupTrip):
            connected.remove(simulator.layout.n_sync + event.group)
        elif isinstance(event, sc.MachineOutage):
            connected = [u for u in connected if u >= len(case.machines) or case.machines[u].bus != event.bus]
        elif isinstance(event, sc.LoadTrip):
            bus = case.bus_index(event.bus)
            loads[bus] -= held_load[bus]
        elif isinstance(event, sc.LoadStep):
            share = 1.0
            if isinstance(event, sc.LoadRamp):
                # A staircase: the value of the middle, until the control interval ends or something happens.
                interval = np.floor(at / control_s + 1e-9) * control_s
                changes = [interval, interval + control_s, *(t for e in what.events for t in (e.time_s, e.end_s))]
                begin, end = max(t for t in changes if t <= at), min(t for t in changes if t > at)
                share = min(1.0, (0.5 * (begin + end) - event.time_s) / event.duration_s)
            bus = case.bus_index(event.bus)
            loads[bus] += share * complex(event.power_mw, -event.reactive_mvar) / case.base_mva / held[bus] ** 2
    return assemble_admittance(plant.branch_ends[~opened], plant.branch_y[~opened], plant.shunts + loads), connected


def reduced(simulator: Simulator, passive: np.ndarray, connected: list[int]) -> np.ndarray:
    """Y - Y B Z Bᵀ Y with the connected units alone; zero for the others."""
    plant = simulator.plant.network
    at, y = plant.unit_bus[connected], np.diag(plant.unit_y[connected])
    full = passive.copy()
    np.add.at(full, (at, at), plant.unit_y[connected])
    found = np.zeros((simulator.layout.n_unit,) * 2, dtype=complex)
    found[np.ix_(connected, connected)] = y - y @ np.linalg.inv(full)[np.ix_(at, at)] @ y
    return found


def check_network(simulator: Simulator, what: sc.Scenario, now_s: float) -> None:
    """Reduced admittance, currents, bus voltages and power balance are those of the whole network."""
    passive, connected = whole_network(simulator, what, now_s)
    expected, n, plant = reduced(simulator, passive, connected), simulator.layout.n_unit, simulator.plant
    assert np.abs(phasors(simulator, PAIRS, "admittance").reshape(n, n) - expected).max() <= 1e-11
    emf, current = phasors(simulator, UNITS, "voltage"), phasors(simulator, UNITS, "current")
    gone = [unit for unit in range(n) if unit not in connected]
    assert (current[gone] == 0.0).all()
    assert np.abs(current - expected @ emf).max() <= 1e-10
    voltage = simulator.bus_voltages()
    own = plant.network.unit_y[connected] * (emf - voltage[plant.network.unit_bus])[connected]
    assert np.abs(own - current[connected]).max() <= 1e-10
    given = simulator.machine_values("power")[0].sum() + simulator.wtg_values("power")[0] @ plant.share
    assert abs(given - (voltage @ np.conj(passive @ voltage)).real) <= 1e-9


def test_the_network_is_that_of_the_scenario_through_every_kind_of_event(simulator):
    what = scenario(*ALL)
    simulator.start(0, what, LAWS)
    for interval in range(1, 41):
        simulator.advance()
        check_network(simulator, what, 0.1 * interval)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
    assert simulator.machine_values("connected")[0].tolist() == [1.0, 1.0, 0.0, 1.0]


def test_a_lane_that_starts_again_has_all_its_units_and_governors(simulator):
    simulator.start(0, scenario(), LAWS)
    fresh = simulator.blocks.copy()
    simulator.start(0, scenario(*ALL), LAWS)
    recorded(simulator, 4.0)
    simulator.start(0, scenario(), LAWS)
    assert (simulator.blocks == fresh).all()
