"""Builders shared by physics tests."""

from __future__ import annotations

from typing import Any

from wtg_gym.physics.parameters import SynchronousMachineParameters


def classical_machine(
    bus: int, *, rating_mva: float = 100.0, dispatch_mw: float = 0.0, **more: Any
) -> SynchronousMachineParameters:
    """Return a constant voltage behind a reactance; the GENROU numbers it does not use are placeholders."""
    values: dict[str, Any] = {
        "bus": bus,
        "rating_mva": rating_mva,
        "two_h_s": 10.0,
        "x_d": 1.0,
        "x_d_transient": 0.2,
        "x_subtransient": 0.15,
        "x_q": 1.0,
        "x_q_transient": 0.5,
        "t_d0_transient_s": 6.0,
        "t_d0_subtransient_s": 0.03,
        "t_q0_subtransient_s": 0.05,
        "classical": True,
        "exciter": None,
        "dispatch_mw": dispatch_mw,
        **more,
    }
    return SynchronousMachineParameters(**values)
