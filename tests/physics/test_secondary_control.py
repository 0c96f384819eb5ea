"""Facts about secondary control: an integral of the speed's deviation in the governor's reference."""

import dataclasses

import numpy as np
import pytest

from tests.physics.extended import scenario, with_machine
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.machine_parameters import GovernorParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Event, GovernorLoss, LoadStep, MachineOutage
from wtg_gym.physics.simulator import Simulator

TIME_S = 30.0
GOVERNOR = GovernorParameters(droop_pu=0.05, gate_max_pu=1.0)
#: One control interval is one step of the integration.
DT = 0.025
MORE = LoadStep(time_s=1.0, bus=4, power_mw=60.0)


def reference_and_speed(
    *events: Event, seconds: float, secondary_time_s: float = TIME_S, governor: GovernorParameters = GOVERNOR
) -> tuple[Floats, Floats]:
    """Gate reference and speed of the generator, from the start on, after each step."""
    case = with_machine(governor=governor)
    settings = Plant(case=case, groups=(), secondary_time_s=secondary_time_s, control_dt=DT, simulation_dt=DT)
    simulator = Simulator(settings, duration_s=seconds)
    simulator.start(0, scenario(*events, wind=np.zeros((0, 1)), duration_s=seconds), ())
    names, found = ("gate_reference", "speed"), []
    for _ in range(round(seconds / DT) + 1):
        found.append([simulator.machine_values(name)[0, 0] for name in names])
        simulator.advance()
    reference, speed = np.array(found).T
    return reference, speed


def test_the_reference_is_the_integral_of_the_deviation_over_droop_and_time():
    reference, speed = reference_and_speed(MORE, seconds=20.0)
    moved = -DT / (TIME_S * GOVERNOR.droop_pu) * np.cumsum(speed[1:] - 1.0)
    assert moved[-1] > 0.05
    assert reference[1:] - reference[0] == pytest.approx(moved, abs=1e-12)


def test_the_reference_stays_within_the_limits_of_the_gate():
    narrow = dataclasses.replace(GOVERNOR, gate_min_pu=0.36, gate_max_pu=0.48)
    for power_mw, limit in ((60.0, 0.48), (-60.0, 0.36)):
        step = LoadStep(time_s=1.0, bus=4, power_mw=power_mw)
        reference, speed = reference_and_speed(step, seconds=60.0, governor=narrow)
        # The deviation lasts, but it is not added up beyond the limit.
        assert (reference >= 0.36).all() and (reference <= 0.48).all()
        assert (reference[-400:] == limit).all() and (np.abs(speed[-400:] - 1.0) > 1e-3).all()


def test_a_lost_governor_or_a_machine_that_is_away_keeps_its_reference():
    for event in (GovernorLoss(time_s=5.0, bus=1), MachineOutage(time_s=5.0, bus=1)):
        reference, speed = reference_and_speed(MORE, event, seconds=10.0)
        last = round(5.0 / DT)
        assert reference[last] > reference[0] and (speed[last + 1 :] != 1.0).all()
        # The gate stays where a lost governor leaves it; the reference of a machine that trips, where it was.
        assert (reference[last + 1 :] == reference[last + 1]).all()
