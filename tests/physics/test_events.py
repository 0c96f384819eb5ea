"""Facts about events that take units, governors and lines away, and about lines that come back."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.linearisation import largest_stable_steps, moving_states, state_matrix
from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
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

LAWS = (STRATEGIES["coordinated-piecewise"],) * 2
WIND = np.array([[11.4], [8.0]])
CASE = modified_ieee14()
ALL = (
    LoadStep(time_s=0.5, bus=3, power_mw=20.0),
    LineTrip(time_s=1.0, from_bus=2, to_bus=4, recloses_after_s=0.75),
    MachineOutage(time_s=1.25, bus=6),
    GovernorLoss(time_s=2.0, bus=1),
    LoadRamp(time_s=2.1, bus=9, power_mw=-15.0, duration_s=0.5),
    GroupTrip(time_s=2.525, group=1),
    LineTrip(time_s=3.0, from_bus=4, to_bus=5),
    LineTrip(time_s=3.0, from_bus=2, to_bus=4, recloses_after_s=0.025),
    LoadTrip(time_s=3.5, bus=14),
)


def scenario(*events: Event) -> Scenario:
    return Scenario(name="x", wind_speed=WIND, events=events)


def advance(simulator: Simulator, seconds: float) -> None:
    for _ in range(round(seconds / simulator.settings.control_dt)):
        simulator.advance()


def admittance(simulator: Simulator) -> np.ndarray:
    """The reduced admittance that acts [p.u.]."""
    n, first = simulator.layout.n_unit, simulator.layout.rows.admittance
    return (simulator.blocks[0, first : first + 2 * n * n].reshape(-1, 2) @ [1.0, 1j]).reshape(n, n)


def phasors(simulator: Simulator, first: int) -> np.ndarray:
    return simulator.blocks[0, first : first + 2 * simulator.layout.n_unit].reshape(-1, 2) @ [1.0, 1j]


def whole_network(simulator: Simulator, what: Scenario, now_s: float) -> tuple[np.ndarray, list[int]]:
    """The admittance matrix of loads, shunts and closed branches during the step that ends now, and who is connected.

    From the scenario itself, without the simulator's own table of events.
    """
    plant, case = simulator.plant, simulator.settings.case
    step_s, control_s = plant.simulation_dt, simulator.settings.control_dt
    at = now_s - 0.5 * step_s
    start = Simulator(simulator.settings)
    start.start(0, dataclasses.replace(what, events=()), LAWS)
    held = np.abs(start.bus_voltages())
    loads = start.data.load_y[0].copy()
    opened = np.zeros(len(plant.branches), dtype=bool)
    connected = list(range(simulator.layout.n_unit))
    for event in what.events:
        if event.time_s > at:
            continue
        if isinstance(event, LineTrip):
            if event.recloses_after_s is None or at < event.time_s + event.recloses_after_s:
                opened[case.branch_index(event.from_bus, event.to_bus)] = True
        elif isinstance(event, GroupTrip):
            connected.remove(simulator.layout.n_sync + event.group)
        elif isinstance(event, MachineOutage):
            connected = [u for u in connected if u >= len(case.machines) or case.machines[u].bus != event.bus]
        elif isinstance(event, LoadTrip):
            bus = case.bus_index(event.bus)
            loads[bus] -= start.data.load_y[0, bus]
        elif isinstance(event, LoadStep):
            share = 1.0
            if isinstance(event, LoadRamp):
                # A staircase: the value of the middle, until the control interval ends or something happens.
                interval = np.floor(at / control_s + 1e-9) * control_s
                changes = [interval, interval + control_s, *(t for e in what.events for t in (e.time_s, e.end_s))]
                begin, end = max(t for t in changes if t <= at), min(t for t in changes if t > at)
                share = min(1.0, (0.5 * (begin + end) - event.time_s) / event.duration_s)
            bus = case.bus_index(event.bus)
            loads[bus] += share * complex(event.power_mw, -event.reactive_mvar) / case.base_mva / held[bus] ** 2
    return assemble_admittance(plant.branches, opened, plant.buses["shunt"] + loads), connected


def reduced(simulator: Simulator, passive: np.ndarray, connected: list[int]) -> np.ndarray:
    """Y - Y B Z Bᵀ Y with the connected units alone; zero for the others."""
    c = simulator.plant.constants[0]
    at, y = c["unit_bus"][connected], np.diag(c["unit_y"][connected])
    full = passive.copy()
    np.add.at(full, (at, at), c["unit_y"][connected])
    found = np.zeros((simulator.layout.n_unit,) * 2, dtype=complex)
    found[np.ix_(connected, connected)] = y - y @ np.linalg.inv(full)[np.ix_(at, at)] @ y
    return found


def check_network(simulator: Simulator, what: Scenario, now_s: float) -> None:
    """Reduced admittance, currents, bus voltages and power balance are those of the whole network."""
    passive, connected = whole_network(simulator, what, now_s)
    expected = reduced(simulator, passive, connected)
    assert np.abs(admittance(simulator) - expected).max() <= 1e-11
    rows = simulator.layout.rows
    emf, current = phasors(simulator, rows.voltage), phasors(simulator, rows.current)
    gone = [unit for unit in range(simulator.layout.n_unit) if unit not in connected]
    assert (current[gone] == 0.0).all()
    assert np.abs(current - expected @ emf).max() <= 1e-10
    voltage = simulator.bus_voltages()
    c = simulator.plant.constants[0]
    own = c["unit_y"][connected] * (emf - voltage[c["unit_bus"]])[connected]
    assert np.abs(own - current[connected]).max() <= 1e-10
    given = simulator.machine_values("power")[0].sum() + simulator.wtg_values("power")[0] @ simulator.plant.share
    assert abs(given - (voltage @ np.conj(passive @ voltage)).real) <= 1e-9


def test_the_network_is_that_of_the_scenario_through_every_kind_of_event(simulator: Simulator) -> None:
    what = scenario(*ALL)
    simulator.start(0, what, LAWS)
    for interval in range(1, 41):
        simulator.advance()
        check_network(simulator, what, 0.1 * interval)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.wtg_values("connected")[0].tolist() == [1.0, 0.0]
    assert simulator.machine_values("connected")[0].tolist() == [1.0, 1.0, 0.0, 1.0]


def test_a_lane_that_starts_again_has_all_its_units_and_governors(simulator: Simulator) -> None:
    simulator.start(0, scenario(), LAWS)
    fresh = simulator.blocks.copy()
    simulator.start(0, scenario(*ALL), LAWS)
    advance(simulator, 4.0)
    simulator.start(0, scenario(), LAWS)
    assert (simulator.blocks == fresh).all()


def test_events_change_nothing_before_they_strike(simulator: Simulator) -> None:
    late: tuple[Event, ...] = tuple(dataclasses.replace(event, time_s=event.time_s + 1.0) for event in ALL)
    ends = []
    for events in ((), late):
        simulator.start(0, scenario(*events), LAWS)
        advance(simulator, 1.5)
        ends.append(simulator.state())
    assert (ends[0] == ends[1]).all()


# --- Governor


def test_a_lost_governor_keeps_its_gate_to_the_bit(simulator: Simulator) -> None:
    events = (LoadStep(time_s=0.5, bus=3, power_mw=30.0), GovernorLoss(time_s=1.0, bus=1))
    simulator.start(0, scenario(*events), LAWS)
    start = simulator.machine_values("gate")[0, 0]
    advance(simulator, 1.0)
    gate = simulator.machine_values("gate")[0, 0]
    assert gate > start + 1e-3
    for _ in range(800):
        simulator.advance()
        assert simulator.machine_values("gate")[0, 0] == gate
    # The torque stays: that of the gate, once the reheater has come to it.
    torque = gate * CASE.machines[0].rating_mva / CASE.base_mva
    assert simulator.machine_values("torque")[0, 0] == pytest.approx(torque, rel=1e-5)


def test_without_its_governor_the_frequency_falls_lower(simulator: Simulator) -> None:
    step = LoadStep(time_s=0.5, bus=3, power_mw=30.0)
    lowest = []
    for events in ((step,), (step, GovernorLoss(time_s=0.5, bus=1))):
        simulator.start(0, scenario(*events), LAWS)
        advance(simulator, 20.0)
        lowest.append(simulator.lane_values("coi_min")[0])
    assert lowest[1] < lowest[0] - 1e-3


# --- Groups


def test_after_all_groups_have_tripped_the_run_is_that_of_a_plant_without_them(simulator: Simulator) -> None:
    simulator.start(0, scenario(*(GroupTrip(time_s=0.5, group=group) for group in (0, 1))), LAWS)
    advance(simulator, 0.5)
    other = Simulator(PlantSettings(groups=()))
    other.start(0, Scenario(name="y", wind_speed=np.zeros((0, 1)), duration_s=30.0), ())
    machines = slice(0, simulator.layout.rows.wtg)
    other.blocks[0, machines] = simulator.blocks[0, machines]
    for name in ("angle", "coi", "coi_min", "coi_max"):
        other.blocks[0, other.layout.lane(name)] = simulator.lane_values(name)[0]
    other.data.load_y[:] = simulator.data.load_y
    # Its network is reduced with these loads before the first step.
    other.blocks[0, other.layout.lane("next_change")] = 0.0
    kept = simulator.wtg_values("rotor_speed")
    n_states = other.layout.state_rows.size - 1
    for _ in range(20):
        simulator.advance()
        other.advance()
        assert simulator.state()[:n_states] == pytest.approx(other.state()[:n_states], abs=1e-11)
        assert (simulator.wtg_values("power") == 0.0).all()
        assert simulator.lane_values("coi") == pytest.approx(other.lane_values("coi"), abs=1e-13)
        assert simulator.lane_values("status") == other.lane_values("status")
    assert (simulator.wtg_values("rotor_speed") == kept).all()


def test_an_event_and_the_protection_trip_a_group_alike() -> None:
    """The paper's run in which group 2 stalls under MPPT, against the same run with an event at that instant."""
    stalls = get_suite("paper").scenario(0)
    tripping = Simulator(PlantSettings(trips_groups=True), duration_s=120.0)
    laws = (STRATEGIES["mppt"],) * 2
    tripping.start(0, stalls, laws)
    while tripping.wtg_values("connected")[0].all():
        tripping.advance()
    at = round(float(tripping.lane_values("step")[0]) * tripping.plant.simulation_dt, 3)
    advance(tripping, 5.0)
    by_event = Simulator(PlantSettings(), duration_s=120.0)
    what = dataclasses.replace(stalls, events=(*stalls.events, GroupTrip(time_s=at, group=1)))
    by_event.start(0, what, laws)
    advance(by_event, at - 0.1)
    # The stall ends a run without the option at the end of this interval: the option is not what is compared.
    by_event.plant.constants["trips_groups"] = True
    advance(by_event, 5.1)
    assert (by_event.state() == tripping.state()).all()


# --- Machines


@pytest.mark.parametrize("bus", [3, 6, 8])
def test_a_condenser_after_its_outage_feeds_in_nothing_and_counts_nowhere(simulator: Simulator, bus: int) -> None:
    simulator.start(0, scenario(MachineOutage(time_s=1.0, bus=bus)), LAWS)
    advance(simulator, 1.0)
    out = [machine.bus for machine in CASE.machines].index(bus)
    stays = [i for i in range(4) if i != out]
    layout = simulator.layout
    names = layout.state_names
    own = [i for i, name in enumerate(names) if name.startswith(f"sync{out}.")]
    before = simulator.state()[own]
    speeds = []
    for _ in range(100):
        simulator.advance()
        assert (simulator.state()[own] == before).all()
        assert (simulator.rates()[own] == 0.0).all()
        for name in ("power", "torque"):
            assert simulator.machine_values(name)[0, out] == 0.0
        inertia = np.array([CASE.machines[i].two_h_s * CASE.machines[i].rating_mva for i in stays]) / CASE.base_mva
        groups = simulator.plant.share * simulator.plant.constants["turbine"][0]["converter.two_h"]
        weights = np.concatenate([inertia, groups])
        speed = np.concatenate([simulator.machine_values("speed")[0, stays], simulator.wtg_values("speed")[0]])
        speeds.append(speed)
        assert simulator.lane_values("coi")[0] - 1.0 == pytest.approx(
            weights @ (speed - 1.0) / weights.sum(), abs=1e-14
        )
        angles = np.concatenate([simulator.machine_values("angle")[0, stays], simulator.wtg_values("angle")[0]])
        assert simulator.lane_values("least_angle")[0] == angles.min()
        assert simulator.lane_values("largest_angle")[0] == angles.max()
    assert np.ptp(speeds) > 1e-6


def test_nothing_depends_on_the_states_of_a_machine_after_its_outage(simulator: Simulator) -> None:
    simulator.start(0, scenario(MachineOutage(time_s=1.0, bus=6), LoadStep(time_s=2.0, bus=3, power_mw=30.0)), LAWS)
    advance(simulator, 1.1)
    snapshot, layout = simulator.snapshot(), simulator.layout
    others = [i for i, name in enumerate(layout.state_names) if not name.startswith("sync2.")]
    watched = [
        layout.lane(name) for name in ("coi", "coi_min", "least_angle", "largest_angle", "least_squared_voltage")
    ]
    ends = []
    for strange in (False, True):
        simulator.restore(snapshot)
        if strange:
            for name, value in {"angle": 50.0, "speed": 1.5, "e_q_transient": 0.1, "psi_1d": 0.1}.items():
                simulator.blocks[0, layout.machine(name)[2]] = value
        advance(simulator, 3.0)
        ends.append([*simulator.state()[others], *simulator.blocks[0, watched]])
        assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.machine_values("voltage")[0, 2] < 0.3
    assert ends[0] == ends[1]


def test_the_outage_of_the_first_machine_is_that_of_any_other() -> None:
    """Its rotor carries the frame of all angles; with the machines in another order it is another's."""
    turned = dataclasses.replace(CASE, machines=(*CASE.machines[1:], CASE.machines[0]))
    runs = []
    for case in (CASE, turned):
        simulator = Simulator(PlantSettings(case=case))
        what = scenario(LoadStep(time_s=0.3, bus=3, power_mw=30.0), MachineOutage(time_s=1.0, bus=1))
        simulator.start(0, what, LAWS)
        found: list[list[float]] = []
        for _ in range(15):
            simulator.advance()
            of_bus = {
                m.bus: value for m, value in zip(case.machines, simulator.machine_values("speed")[0], strict=True)
            }
            spread = simulator.lane_values("largest_angle") - simulator.lane_values("least_angle")
            found.append(
                [
                    *(of_bus[bus] for bus in (3, 6, 8)),
                    *simulator.wtg_values("speed")[0],
                    *simulator.wtg_values("power")[0],
                    *np.abs(simulator.bus_voltages()),
                    float(simulator.lane_values("coi")[0]),
                    # The first unit's own angle is zero.
                    float(spread[0]),
                    float(simulator.lane_values("status")[0]),
                    float(simulator.lane_values("step")[0]),
                ]
            )
        runs.append(np.array(found))
    assert runs[0] == pytest.approx(runs[1], abs=1e-9)
    # The generator is gone, so the frequency falls, until the protection ends the run.
    assert runs[0][-1, -4] < 0.98


def test_with_fewer_units_the_modes_are_no_faster(simulator: Simulator) -> None:
    """So that the step that suits the start suits what is left."""
    found = {}
    for out in ((), (3,), (6,), (8,), (1,), (3, 6, 8), (1, 3, 6), (1, 3, 8), (1, 6, 8)):
        events = tuple(MachineOutage(time_s=0.0, bus=bus) for bus in out)
        for groups in ((), (0,), (0, 1)):
            simulator.start(0, scenario(*events, *(GroupTrip(time_s=0.0, group=group) for group in groups)), LAWS)
            simulator.advance()
            rows, layout = simulator.blocks[0].copy(), simulator.layout
            matrix = state_matrix(rows, simulator.plant, layout, -1.0)
            keep = moving_states(matrix, rows, layout)
            found[out, groups] = largest_stable_steps(np.linalg.eigvals(matrix[np.ix_(keep, keep)])).min()
    assert min(found.values()) >= 0.99 * found[(), ()]
    assert found[(3, 6, 8), ()] > 1.1 * found[(), ()]


# --- Lines


def test_a_line_that_closes_again_gives_back_the_first_network(simulator: Simulator) -> None:
    simulator.start(0, scenario(LineTrip(time_s=0.5, from_bus=1, to_bus=2, recloses_after_s=0.3)), LAWS)
    first = admittance(simulator)
    advance(simulator, 0.6)
    assert np.abs(admittance(simulator) - first).max() > 0.1
    advance(simulator, 0.3)
    assert np.abs(admittance(simulator) - first).max() <= 1e-12


def test_a_line_may_open_again_once_it_is_closed(simulator: Simulator) -> None:
    def trip(time_s: float, after_s: float | None) -> LineTrip:
        return LineTrip(time_s=time_s, from_bus=1, to_bus=2, recloses_after_s=after_s)

    simulator.start(0, scenario(trip(0.5, 0.5), trip(1.0, 0.25), trip(2.0, None)), LAWS)
    with pytest.raises(ValueError, match="opens the line 1-2 twice"):
        simulator.start(0, scenario(trip(0.5, 0.525), trip(1.0, None)), LAWS)
    with pytest.raises(ValueError, match="would split the network"):
        simulator.start(0, scenario(trip(0.5, 0.525), LineTrip(time_s=1.0, from_bus=5, to_bus=1)), LAWS)
    simulator.start(0, scenario(trip(0.5, 0.5), LineTrip(time_s=1.0, from_bus=5, to_bus=1)), LAWS)


# --- Lanes, copies, any list of events


def test_lanes_with_every_kind_of_event_equal_single_runs_bit_for_bit() -> None:
    suite = get_suite("standard")
    scenarios = [
        dataclasses.replace(
            drawn,
            events=tuple(
                dataclasses.replace(event, time_s=round(event.time_s + 0.025 * (lane % 7), 3))
                for event in ALL[: 1 + lane % len(ALL)]
            ),
        )
        for lane, drawn in enumerate(suite.scenario(20_000 + lane) for lane in range(20))
    ]
    batch = Simulator(PlantSettings(), n_lanes=len(scenarios))
    batch.commit(range(len(scenarios)), batch.prepare(scenarios, LAWS))
    advance(batch, 8.0)
    single = Simulator(PlantSettings())
    for lane, what in enumerate(scenarios):
        single.start(0, what, LAWS)
        advance(single, 8.0)
        assert (single.state() == batch.state(lane)).all()
        assert (single.bus_voltages() == batch.bus_voltages(lane)).all()
        for name in ("connected", "inv_droop"):
            assert (single.machine_values(name)[0] == batch.machine_values(name)[lane]).all()


def test_snapshots_and_copies_keep_what_is_disconnected(simulator: Simulator) -> None:
    simulator.start(0, scenario(*ALL), LAWS)
    advance(simulator, 2.3)
    snapshot, copy = simulator.snapshot(), pickle.loads(pickle.dumps(simulator))
    ends: list[Floats] = []
    for run in (simulator, copy):
        advance(run, 2.0)
        ends.append(run.blocks.copy())
    simulator.start(0, scenario(), LAWS)
    simulator.restore(snapshot)
    advance(simulator, 2.0)
    assert (ends[0] == ends[1]).all()
    assert (simulator.blocks == ends[0]).all()


TIMES = st.integers(0, 80).map(lambda n: n * 0.025)
LINES = st.sampled_from([(1, 2), (2, 4), (4, 5), (6, 12), (9, 14), (13, 14)])


@st.composite
def event_lists(draw: st.DrawFn) -> tuple[Event, ...]:
    """Any events that a plant takes, in any order."""
    found: list[Event] = [LoadStep(time_s=draw(TIMES), bus=draw(st.integers(1, 14)), power_mw=draw(st.floats(-40, 40)))]
    found += [MachineOutage(time_s=draw(TIMES), bus=bus) for bus in draw(st.sets(st.sampled_from([3, 6, 8])))]
    found += [GroupTrip(time_s=draw(TIMES), group=group) for group in draw(st.sets(st.integers(0, 1)))]
    found += [GovernorLoss(time_s=draw(TIMES), bus=1)] if draw(st.booleans()) else []
    after = draw(st.none() | st.integers(1, 60).map(lambda n: n * 0.025))
    from_bus, to_bus = draw(LINES)
    found.append(LineTrip(time_s=draw(TIMES), from_bus=from_bus, to_bus=to_bus, recloses_after_s=after))
    return tuple(draw(st.permutations(found)))


@given(events=event_lists())
@settings(max_examples=40, deadline=None, derandomize=True)
def test_any_list_of_events_keeps_states_finite_and_the_network_right(events: tuple[Event, ...]) -> None:
    what = scenario(*events)
    assert Scenario.from_json(what.to_json()).events == events
    simulator = Simulator(PlantSettings())
    simulator.start(0, what, LAWS)
    for interval in range(1, 31):
        simulator.advance()
        # A sum with NaN or infinity is not below the bound.
        assert np.abs(simulator.state()).sum() < 1e4
        assert np.abs(simulator.machine_values("voltage")).sum() + np.abs(simulator.wtg_values("power")).sum() < 1e2
        if simulator.lane_values("active")[0] < 0.5:
            assert simulator.lane_values("status")[0] != Status.NUMERICAL_FAILURE
            break
        if interval % 5 == 0:
            check_network(simulator, what, 0.1 * interval)
