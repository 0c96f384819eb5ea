"""Controls that only some machines have: which parameters mean which, and what joins the lists of a step."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.gast import GAST
from wtg_gym.physics.hydro_unit import HYGOV
from wtg_gym.physics.ieeeg1 import IEEEG1
from wtg_gym.physics.ieeest import IEEEST
from wtg_gym.physics.ieeex1 import IEEEX1
from wtg_gym.physics.ieesgo import IEESGO
from wtg_gym.physics.machine_controls import Control
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters
from wtg_gym.physics.stab1 import STAB1
from wtg_gym.physics.units import ControlJoining
from wtg_gym.systems.records import structured
from wtg_gym.systems.systems import System

#: By the names of their kinds. Stabilisers come before the exciters whose references they shift.
CONTROLS: Mapping[str, Control] = types.MappingProxyType(
    {control.kind.name: control for control in (STAB1, IEEEST, IEEEX1, HYGOV, IEEEG1, IEESGO, GAST)}
)
_BY_PARAMETERS = {parameters: control for control in CONTROLS.values() for parameters in control.constants.parameters}


def controls_of(machine: SynchronousMachineParameters) -> list[tuple[Control, Any]]:
    """Return the controls of a machine that are units of their own, each with its parameters."""
    electric = () if machine.classical else (machine.stabiliser, machine.exciter)
    own = (*electric, machine.governor)
    return [(_BY_PARAMETERS[type(record)], record) for record in own if type(record) in _BY_PARAMETERS]


def control_constants(machines: Sequence[SynchronousMachineParameters]) -> dict[str, npt.NDArray[np.void]]:
    """Return the constants of all controls that are units of their own, by the names of their kinds."""
    found: dict[str, list[Any]] = {}
    for index, machine in enumerate(machines):
        for control, parameters in controls_of(machine):
            found.setdefault(control.kind.name, []).append(control.constants(index, parameters))
    return {name: structured(CONTROLS[name].constants.record, own) for name, own in found.items()}


def joining_controls(names: Sequence[str]) -> dict[ControlJoining, tuple[System, ...]]:
    """Return the systems of controls, by the names of their kinds, by the places where they join.

    At the start exciters come before the stabilisers: they say what reference they need.
    """
    places: dict[ControlJoining, tuple[System, ...]] = {}
    for one in (one for name, one in CONTROLS.items() if name in names):
        for place, systems in one.systems.items():
            before = places.get(place, ())
            places[place] = (*systems, *before) if place is ControlJoining.SETTLE else (*before, *systems)
    return places
