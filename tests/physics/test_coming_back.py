"""Units that come back and islands that join again: in step with the grid, whatever turns they have made."""

import dataclasses

import numpy as np
import pytest

from tests.physics.extended import scenario, started
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import STAGES, Status
from wtg_gym.physics.scenario import Event, GovernorLoss, GroupTrip, LineTrip, LoadStep, MachineOutage
from wtg_gym.physics.simulator import Simulator
from wtg_gym.scenarios import get_suite

V1 = get_suite("standard-v1").plant
WITHOUT_MACHINES = dataclasses.replace(V1, case=dataclasses.replace(V1.case, machines=(), slack_bus=2))


def cut(*lines: tuple[int, int], recloses_after_s: float) -> list[Event]:
    return [LineTrip(time_s=1.0, from_bus=a, to_bus=b, recloses_after_s=recloses_after_s) for a, b in lines]


def played(
    events: list[Event], wind: float = 9.0, plant: Plant = V1, load_level: float = 1.0, seconds: float = 25.0
) -> Simulator:
    what = scenario(*events, wind=np.full((4, 1), wind), load_level=load_level, duration_s=seconds)
    simulator = started(plant, what)
    for _ in range(round(10.0 * seconds)):
        simulator.advance()
    return simulator


@pytest.mark.parametrize(
    ("events", "wind", "plant", "load_level"),
    [
        ([MachineOutage(time_s=1.0, bus=1, returns_after_s=5.0)], 9.0, V1, 1.0),
        ([MachineOutage(time_s=1.0, bus=1), GroupTrip(time_s=1.5, group=3, returns_after_s=10.0)], 11.0, V1, 0.9),
        ([GroupTrip(time_s=2.0, group=0, returns_after_s=8.0)], 12.0, WITHOUT_MACHINES, 0.6),
        (cut((5, 6), (10, 11), (13, 14), recloses_after_s=5.0), 9.0, V1, 1.0),
        (cut((5, 6), (10, 11), (13, 14), recloses_after_s=12.0), 9.0, V1, 1.0),
    ],
    ids=["generator", "group after the last generator", "group without machines", "islands", "islands, later"],
)
def test_what_comes_back_in_phase_has_not_lost_synchronism(events, wind, plant, load_level):
    simulator = played(events, wind, plant, load_level)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.lane_values("coi")[0] == pytest.approx(1.0, abs=0.01)


def test_a_grid_that_a_part_joins_remembers_which_stages_have_acted():
    # Two small buses in the west join the rest, which has shed.
    simulator = played(cut((1, 5), (2, 3), (2, 4), (2, 5), recloses_after_s=0.9), 8.0, seconds=2.1)
    n_stages = len(V1.shedding)
    shed = [simulator.values(row)[0] for row in simulator.layout.first_rows(STAGES, "shed")[:n_stages]]
    assert min(shed) < 0.0


def test_energy_that_is_not_served_is_never_negative():
    away = [
        LineTrip(time_s=1.0, from_bus=7, to_bus=8),
        GroupTrip(time_s=1.0, group=3),
        MachineOutage(time_s=1.0, bus=8),
    ]
    simulator = played([*away, LoadStep(time_s=2.0, bus=8, power_mw=-50.0)], seconds=5.0)
    assert simulator.lane_values("shed_energy")[0] == 0.0


def test_a_group_that_returns_to_a_revived_bus_begins_with_the_grids_frequency():
    line = LineTrip(time_s=1.0, from_bus=7, to_bus=8, recloses_after_s=9.0)
    simulator = played([line, GroupTrip(time_s=9.0, group=3, returns_after_s=1.0)], seconds=10.1)
    # Within 0.1 s its power lifts it by less than a fifth of what lay between the dead island and the grid.
    assert simulator.wtg_values("speed")[0, 3] == pytest.approx(simulator.lane_values("coi")[0], abs=6e-3)


def test_a_machine_that_has_lost_its_governor_comes_back_with_its_gate_closed():
    lost = [GovernorLoss(time_s=1.0, bus=1), MachineOutage(time_s=2.0, bus=1, returns_after_s=0.5)]
    assert played(lost, seconds=4.0).machine_values("gate")[0, 0] == 0.0
