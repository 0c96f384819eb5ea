"""Models of machines that only some plants have: which parameters mean which, and what joins the lists of a step."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from typing import Any

from wtg_gym.physics.control_parameters import (
    BoilerGovernorParameters,
    FilterStabiliserParameters,
    GasGovernorParameters,
    LeadLagExciterParameters,
    ReheatGovernorParameters,
    SaturatingExciterParameters,
    SpeedStabiliserParameters,
)
from wtg_gym.physics.gast import GAST
from wtg_gym.physics.ieeeg1 import IEEEG1
from wtg_gym.physics.ieeest import IEEEST
from wtg_gym.physics.ieeex1 import IEEEX1
from wtg_gym.physics.ieesgo import IEESGO
from wtg_gym.physics.machine_controls import Control
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters
from wtg_gym.physics.saturated_machine import SYSTEMS
from wtg_gym.physics.stab1 import STAB1
from wtg_gym.systems.systems import System

#: Controls by their parameters. Stabilisers come before the exciters whose references they shift.
CONTROLS: Mapping[type[Any], Control] = types.MappingProxyType(
    {
        SpeedStabiliserParameters: STAB1,
        FilterStabiliserParameters: IEEEST,
        LeadLagExciterParameters: IEEEX1,
        SaturatingExciterParameters: IEEEX1,
        BoilerGovernorParameters: IEEEG1,
        ReheatGovernorParameters: IEESGO,
        GasGovernorParameters: GAST,
    }
)
_BY_NAME = {control.kind.name: control for control in CONTROLS.values()}


def controls_of(machine: SynchronousMachineParameters) -> list[tuple[Control, Any]]:
    """Return the controls of a machine that are units of their own, each with its parameters."""
    electric = () if machine.classical else (machine.stabiliser, machine.exciter)
    own = (*electric, machine.governor)
    return [(CONTROLS[type(record)], record) for record in own if type(record) in CONTROLS]


def control_constants(machines: Sequence[SynchronousMachineParameters]) -> dict[str, list[Any]]:
    """Return the constants of all controls that are units of their own, by the names of their kinds."""
    found: dict[str, list[Any]] = {}
    for index, machine in enumerate(machines):
        for control, parameters in controls_of(machine):
            found.setdefault(control.kind.name, []).append(control.constants(index, parameters))
    return found


def control_named(name: str) -> Control:
    """Return a control by the name of its kind."""
    return _BY_NAME[name]


def joining_models(names: Sequence[str], *, saturated: bool) -> dict[str, tuple[System, ...]]:
    """Return the systems of controls, by the names of their kinds, and of saturation, by the places where they join.

    At the start exciters come before the stabilisers: they say what reference they need.
    """
    present = [one for name, one in _BY_NAME.items() if name in names]
    places: dict[str, tuple[System, ...]] = dict(SYSTEMS) if saturated else {}
    for one in present:
        for place, systems in one.systems.items():
            before = places.get(place, ())
            places[place] = (*systems, *before) if place == "control settle" else (*before, *systems)
    return places
