"""Balances, independence of lanes, and agreement with other integrators."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import (
    Event,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
    Scenario,
)
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import get_suite

LAW = STRATEGIES["coordinated-piecewise"]


@pytest.mark.parametrize("name", ["mppt", "coordinated-piecewise", "coordinated-undamped"])
def test_kinetic_energy_is_what_was_captured_and_not_delivered(simulator: Simulator, name: str) -> None:
    simulator.start(0, get_suite("gust").scenario(20_003), (STRATEGIES[name],) * 2)
    before = simulator.wtg_values("rotor_speed")[0]
    for _ in range(300):
        simulator.advance()
    gained = 13.0 * (simulator.wtg_values("rotor_speed")[0] - before)
    captured = simulator.wtg_values("energy_captured")[0]
    delivered = simulator.wtg_values("energy_delivered")[0]
    assert captured - delivered == pytest.approx(gained, abs=1e-12)
    assert (captured > 5.0).all()


def network_power(simulator: Simulator, extra: complex = 0j, bus: int = 2) -> tuple[float, float]:
    """Power into the network from its units, and what loads and branches take, from the bus voltages [p.u.]."""
    plant, data, view = simulator.plant, simulator.data, simulator.blocks[0]
    c, first = plant.constants[0], simulator.layout.rows.voltage
    emf = view[first : first + 2 * len(c["unit_bus"])].reshape(-1, 2) @ [1.0, 1j]
    bus_y = plant.buses["shunt"] + data.load_y[0]
    bus_y[simulator.settings.case.bus_index(bus)] += extra
    passive = assemble_admittance(plant.branches, np.zeros(len(plant.branches), dtype=bool), bus_y)
    full = passive.copy()
    injected = np.zeros(len(bus_y), dtype=np.complex128)
    for unit, at in enumerate(c["unit_bus"]):
        full[at, at] += c["unit_y"][unit]
        injected[at] += c["unit_y"][unit] * emf[unit]
    voltage = np.linalg.solve(full, injected)
    consumed = (voltage * np.conj(passive @ voltage)).sum().real
    machines = simulator.machine_values("power")[0].sum()
    return float(machines + (simulator.wtg_values("power")[0] * plant.share).sum()), float(consumed)


def test_power_from_the_units_equals_loads_and_losses(simulator: Simulator) -> None:
    step = LoadStep(time_s=2.0, bus=2, power_mw=75.0)
    simulator.start(0, Scenario(name="x", wind_speed=np.array([[11.4], [8.0]]), events=(step,)), (LAW, LAW))
    assert network_power(simulator)[0] == pytest.approx(network_power(simulator)[1], abs=1e-12)
    for _ in range(45):
        simulator.advance()
    given, taken = network_power(simulator, extra=0.75 / 1.045**2)
    assert given == pytest.approx(taken, abs=1e-12)
    assert given > 2.9


def test_load_noise_by_rank_one_update_equals_a_full_reduction() -> None:
    # 12 MW of noise at bus 9 from t = 0.1 s on, against the same as a load step of 12 MW.
    events = (LoadStep(time_s=0.1, bus=9, power_mw=12.0),)
    noise = np.concatenate([[0.0], np.full(40, 12.0)])
    wind = np.array([[11.4], [8.0]])
    stepped = Scenario(name="step", wind_speed=wind, events=events)
    noisy = Scenario(name="noise", wind_speed=wind, load_noise_mw=noise, load_noise_bus=9)
    results = []
    for scenario in (stepped, noisy):
        simulator = Simulator(PlantSettings())
        simulator.start(0, scenario, (LAW, LAW))
        for _ in range(30):
            simulator.advance()
        results.append(simulator.state())
    assert results[0] == pytest.approx(results[1], abs=1e-12)


EVENTS = (
    LoadStep(time_s=0.2, bus=2, power_mw=75.0, reactive_mvar=20.0),
    LoadTrip(time_s=0.5, bus=9),
    LineTrip(time_s=0.8, from_bus=2, to_bus=4),
    LoadRamp(time_s=1.0, bus=3, power_mw=30.0, duration_s=0.5),
)
OUTAGES = (
    LineTrip(time_s=0.2, from_bus=2, to_bus=4, recloses_after_s=0.5),
    MachineOutage(time_s=0.5, bus=6),
    GovernorLoss(time_s=1.0, bus=1),
    GroupTrip(time_s=1.3, group=1),
)


def reference_run(scenario: Scenario, until_s: float, method: str) -> tuple[np.ndarray, Simulator]:
    """Integrate the same right-hand side with scipy, restarting wherever the network changes."""
    simulator = Simulator(PlantSettings(simulation_dt=0.02))
    simulator.start(0, scenario, (LAW, LAW))
    state = simulator.state()
    from wtg_gym.physics.reduction import combine_load_noise, refresh_network

    def rates(_t: float, x: np.ndarray) -> np.ndarray:
        simulator.set_state(x)
        simulator.evaluate()
        return simulator.rates()

    next_change, clock = simulator.layout.lane("next_change"), simulator.layout.lane("step")
    step = 0
    while step < round(until_s / 0.02):
        following = min(simulator.blocks[0, next_change], round(until_s / 0.02))
        if following > step:
            done = solve_ivp(rates, (step * 0.02, following * 0.02), state, method=method, rtol=1e-10, atol=1e-12)
            state, step = done.y[:, -1], int(following)
        simulator.blocks[0, clock] = step
        simulator.set_state(state)
        refresh_network(simulator.blocks[0], 0, 0, simulator.plant, simulator.data, 1)
        combine_load_noise(simulator.blocks[0], simulator.plant.constants[0], np.zeros(1), simulator.lanes)
    return state, simulator


@pytest.mark.parametrize("events", [EVENTS, OUTAGES], ids=["loads", "outages"])
@pytest.mark.parametrize("method", ["DOP853", "Radau"])
def test_default_step_agrees_with_tight_integration_through_every_kind_of_event(
    method: str, events: tuple[Event, ...]
) -> None:
    scenario = Scenario(name="x", wind_speed=np.array([[11.4], [8.0]]), events=events)
    expected, simulator = reference_run(scenario, 2.0, method)
    fixed = Simulator(PlantSettings())
    fixed.start(0, scenario, (LAW, LAW))
    for _ in range(20):
        fixed.advance()
    names = simulator.layout.state_names
    error = dict(zip(names, np.abs(fixed.state() - expected), strict=True))
    assert max(value for name, value in error.items() if name.endswith("speed")) < 2e-7
    assert max(error.values()) < 2e-4


def test_error_falls_with_the_fourth_power_of_the_step() -> None:
    scenario = Scenario(name="x", wind_speed=np.array([[11.4], [8.0]]), events=EVENTS[:1])
    ends = {}
    for dt in (0.02, 0.01, 0.005, 0.00125):
        simulator = Simulator(PlantSettings(simulation_dt=dt))
        simulator.start(0, scenario, (LAW, LAW))
        for _ in range(20):
            simulator.advance()
        ends[dt] = simulator.wtg_values("speed")[0]
    errors = [np.abs(ends[dt] - ends[0.00125]).max() for dt in (0.02, 0.01, 0.005)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 3.5).all(), orders


def test_lane_result_ignores_other_lanes_and_equals_a_single_run() -> None:
    suite = get_suite("standard")
    scenarios = [suite.scenario(seed) for seed in range(20_000, 20_021)]
    batch = Simulator(PlantSettings(), n_lanes=len(scenarios))
    for lane, scenario in enumerate(scenarios):
        batch.start(lane, scenario, (LAW, LAW))
    for _ in range(200):
        batch.advance()
    single = Simulator(PlantSettings())
    for lane in (0, 7, 15, 16, 20):
        single.start(0, scenarios[lane], (LAW, LAW))
        for _ in range(200):
            single.advance()
        assert (single.state() == batch.state(lane)).all()


@pytest.mark.parametrize("trips", [False, True])
def test_a_stalled_group_ends_the_run_or_is_tripped(trips: bool) -> None:
    scenario = get_suite("paper").scenario(0)
    simulator = Simulator(PlantSettings(trips_groups=trips), duration_s=120.0)
    simulator.start(0, scenario, (STRATEGIES["mppt"],) * 2)
    for _ in range(1000):
        simulator.advance()
    connected = simulator.wtg_values("connected")[0]
    if trips:
        assert simulator.lane_values("status")[0] == 0.0
        assert simulator.lane_values("step")[0] == 1000 * simulator.plant.n_substeps
        assert connected.tolist() == [1.0, 0.0]
        assert simulator.wtg_values("power")[0, 1] == 0.0
        # The others carry the lost group's share at a lower frequency.
        assert 0.98 < simulator.lane_values("coi")[0] < 0.9953
    else:
        assert simulator.lane_values("status")[0] == 1.0
        assert simulator.lane_values("step")[0] < 2500.0


def test_an_ended_run_stands_still() -> None:
    simulator = Simulator(PlantSettings(), duration_s=120.0)
    simulator.start(0, get_suite("paper").scenario(0), (STRATEGIES["mppt"],) * 2)
    while simulator.lane_values("active")[0] > 0.5:
        simulator.advance()
    before = simulator.state()
    extremes = simulator.wtg_values("peak_power")
    simulator.advance()
    assert (simulator.state() == before).all()
    assert (simulator.wtg_values("peak_power") == extremes).all()


def test_grid_strength_changes_frequency_as_it_must(simulator: Simulator) -> None:
    def nadir(**strength: float) -> float:
        step = LoadStep(time_s=1.0, bus=3, power_mw=60.0)
        scenario = Scenario(name="x", wind_speed=np.array([[11.4], [8.0]]), events=(step,), **strength)  # type: ignore[arg-type]
        simulator.start(0, scenario, (LAW, LAW))
        for _ in range(150):
            simulator.advance()
        return float(simulator.lane_values("coi_min")[0])

    assert nadir(governor_droop=0.05) < nadir(governor_droop=0.03) < nadir(governor_droop=0.018)
    assert nadir(inertia_scale=0.5) < nadir()
