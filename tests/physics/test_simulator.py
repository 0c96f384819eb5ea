"""Copies, lanes prepared together, intervals, and voltages of a simulator."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from tests.physics.extended import WIND, recorded, scenario, started
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import GovernorLoss, GroupTrip, LineTrip, LoadStep, MachineOutage
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import get_suite

LAWS = (STRATEGIES["coordinated-piecewise"],) * 2


def test_load_noise_ends_with_its_series_at_every_control_interval() -> None:
    noisy = scenario(duration_s=2.0, load_noise_mw=np.array([0.0, 0.0, 40.0, 40.0]))
    for control_dt in (0.05, 0.1, 0.2):
        noise = started(PlantSettings(control_dt=control_dt), noisy, duration_s=2.0).data.noise[0]
        assert noise.sum() * control_dt == pytest.approx(2 * 40.0 * 0.1)
        assert (noise[round(0.4 / control_dt) :] == 0.0).all()


def test_lanes_copies_and_snapshots_go_on_like_a_single_run_bit_for_bit() -> None:
    steps = (LoadStep(time_s=float(t), bus=2, power_mw=10.0) for t in range(1, 8))
    gone = MachineOutage(time_s=1.25, bus=6), GovernorLoss(time_s=2.0, bus=1), GroupTrip(time_s=2.525, group=1)
    line = LineTrip(time_s=1.0, from_bus=2, to_bus=4, recloses_after_s=3.0)
    events = (*steps, *gone, line)
    simulator = Simulator(PlantSettings(), n_lanes=3)
    for lane in range(3):
        simulator.start(lane, scenario(*events, wind=WIND + 0.1 * lane), LAWS)
    recorded(simulator, 2.5)
    snapshot, ends = simulator.snapshot(), []
    for run in (pickle.loads(pickle.dumps(simulator)), copy.deepcopy(simulator), simulator):
        recorded(run, 4.0)
        ends.append(run.blocks.copy())
    alone = started(PlantSettings(), scenario(*events, wind=WIND + 0.2))
    recorded(alone, 6.5)
    assert (alone.state() == simulator.state(2)).all()
    simulator.start(1, scenario(), LAWS)
    simulator.restore(snapshot)
    recorded(simulator, 4.0)
    for end in ends:
        assert (end == simulator.blocks).all()


def test_bus_voltages_are_those_at_the_machines_terminals(simulator: Simulator) -> None:
    """Recovered from the whole network, against the machines' own equations, through steps, ramps and noise."""
    what = get_suite("standard").scenario(20_003)
    simulator.start(0, what, LAWS)
    assert what.events and what.load_noise_mw.any()
    case = simulator.settings.case
    at = [case.bus_index(machine.bus) for machine in case.machines]
    for _ in range(600):
        own = simulator.machine_values("voltage")[0]
        assert np.abs(simulator.bus_voltages())[at] == pytest.approx(own, abs=1e-12)
        simulator.advance()


def test_runs_prepared_together_equal_runs_prepared_alone_bit_for_bit(simulator: Simulator) -> None:
    scenarios = [get_suite("weak-grid").scenario(seed) for seed in range(20_000, 20_030)]
    together = simulator.prepare(scenarios, LAWS)
    for i, what in enumerate(scenarios):
        alone = simulator.prepare([what], LAWS)
        n_events = alone.data.events.shape[1]
        assert (together.rows[i] == alone.rows[0]).all()
        assert (together.data.events[i, :n_events] == alone.data.events[0]).all()
        for one, many in zip(alone.data[:-1], together.data[:-1], strict=True):
            assert (many[i] == one[0]).all()
