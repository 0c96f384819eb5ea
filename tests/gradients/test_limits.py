"""What is traced of the kernels, and gradients through the limits of the converters."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from tests.gradients.test_gradients import N_LANES, V1, actions_of, agrees, given, tape_of
from wtg_gym.gradients.kernel_programs import require_known
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.machine_parameters import HydroGovernorParameters
from wtg_gym.physics.plant import PlantSettings, build_plant
from wtg_gym.physics.scenario import GroupTrip, LoadStep

Floats = npt.NDArray[np.float64]
#: A group trips in strong wind, and others take over until load is lost too: their currents are limited meanwhile.
OVERLOAD = (GroupTrip(time_s=1.0, group=0), LoadStep(time_s=1.6, bus=4, power_mw=-70.0))


def reactances(tape: Tape) -> Floats:
    return tape.lanes.simulator.wtg_values("limiting_reactance")


def test_the_gradient_goes_through_the_limits_of_currents_and_powers() -> None:
    tape = tape_of(**V1)
    step = LoadStep(time_s=1.0, bus=2, power_mw=60.0, reactive_mvar=60.0)
    scenarios = [given(4, *OVERLOAD, wind=11.5), given(4, step, wind=11.5), given(4, *OVERLOAD, wind=11.5)]
    actions = actions_of(tape, 80, 0.2)
    agrees(tape, scenarios, actions)
    tape.start(scenarios)
    limited, over_power = np.zeros(N_LANES, dtype=int), np.zeros(N_LANES)
    for own in actions:
        tape.step(own)
        limited += (reactances(tape) > 0.0).any(axis=1)
        over_power = np.minimum(over_power, tape.lanes.simulator.wtg_values("over_power").min(axis=1))
    assert (limited[[0, 2]] > 2).all() and over_power[1] < -1e-4


def test_hydro_governors_are_refused() -> None:
    hydro = [dataclasses.replace(m, governor=HydroGovernorParameters()) for m in modified_ieee14().machines]
    case = dataclasses.replace(modified_ieee14(), machines=tuple(hydro))
    with pytest.raises(ValueError, match="hydro"):
        require_known(build_plant(PlantSettings(case=case)))
