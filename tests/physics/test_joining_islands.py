"""Islands that join again: in step with the grid, whatever turns they have made."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.extended import scenario, started
from wtg_gym.physics.protection import STAGES, Status
from wtg_gym.physics.scenario import Event, GroupTrip, LineTrip, LoadStep, MachineOutage
from wtg_gym.physics.simulator import Simulator
from wtg_gym.scenarios import get_suite

V1 = get_suite("standard-v1").plant


def cut(*lines: tuple[int, int], recloses_after_s: float) -> list[Event]:
    return [LineTrip(time_s=1.0, from_bus=a, to_bus=b, recloses_after_s=recloses_after_s) for a, b in lines]


def played(events: list[Event], wind: float = 9.0, seconds: float = 25.0) -> Simulator:
    simulator = started(V1, scenario(*events, wind=np.full((4, 1), wind), duration_s=seconds))
    for _ in range(round(10.0 * seconds)):
        simulator.advance()
    return simulator


@pytest.mark.parametrize("recloses_after_s", [5.0, 12.0])
def test_what_joins_in_phase_has_not_lost_synchronism(recloses_after_s: float) -> None:
    simulator = played(cut((5, 6), (10, 11), (13, 14), recloses_after_s=recloses_after_s))
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert simulator.lane_values("coi")[0] == pytest.approx(1.0, abs=0.01)


def test_a_grid_that_a_part_joins_remembers_which_stages_have_acted() -> None:
    # Two small buses in the west join the rest, which has shed.
    simulator = played(cut((1, 5), (2, 3), (2, 4), (2, 5), recloses_after_s=0.9), 8.0, seconds=2.1)
    n_stages = len(V1.shedding)
    shed = [simulator.values(row)[0] for row in simulator.layout.first_rows(STAGES, "shed")[:n_stages]]
    assert min(shed) < 0.0


def test_energy_that_is_not_served_is_never_negative() -> None:
    away = [
        LineTrip(time_s=1.0, from_bus=7, to_bus=8),
        GroupTrip(time_s=1.0, group=3),
        MachineOutage(time_s=1.0, bus=8),
    ]
    simulator = played([*away, LoadStep(time_s=2.0, bus=8, power_mw=-50.0)], seconds=5.0)
    assert simulator.lane_values("shed_energy")[0] == 0.0
