"""Builders shared by physics tests."""

from __future__ import annotations

from typing import Any

from wtg_gym.physics import machine_parameters
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters


def classical_machine(
    bus: int, *, rating_mva: float = 100.0, dispatch_mw: float = 0.0, **more: Any
) -> SynchronousMachineParameters:
    """Return a constant voltage behind a reactance of ordinary size."""
    ordinary = {"two_h_s": 10.0, "x_d_transient": 0.2}
    return machine_parameters.classical_machine(
        bus=bus, rating_mva=rating_mva, dispatch_mw=dispatch_mw, **{**ordinary, **more}
    )
