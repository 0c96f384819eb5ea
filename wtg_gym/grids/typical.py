"""Typical machines and controls, in the place of what a case does not say."""

from __future__ import annotations

from wtg_gym.physics.machine_parameters import (
    ExciterParameters,
    GovernorParameters,
    SpeedStabiliserParameters,
    SynchronousMachineParameters,
)

#: Rating over the apparent power that a machine gives, and the least one [MVA]: a power flow may ask a small condenser
#: for more reactive power than its limits allow.
_MARGIN, _LEAST_MVA = 1.3, 50.0
TYPICAL_EXCITER = ExciterParameters()
#: For all of the machines have fast exciters, under which they would swing against each other.
TYPICAL_STABILISER = SpeedStabiliserParameters()
TYPICAL_GOVERNOR = GovernorParameters(droop_pu=0.05)


def typical_machine(
    bus: int, power: complex = 0j, least: float = _LEAST_MVA, *, slack: bool = False
) -> SynchronousMachineParameters:
    """Return a machine that gives a power [MW + j Mvar], of a least rating [MVA]; without active power a condenser.

    Its values are those of a large round-rotor machine; source: P. Kundur: Power System Stability and Control, table
    4.2.
    """
    governed = power.real > 0.0 or slack
    return SynchronousMachineParameters(
        bus=bus, rating_mva=max(_MARGIN * abs(power), least, _LEAST_MVA), two_h_s=8.0 if governed else 3.0,
        dispatch_mw=power.real, damping_pu=0.0, x_d=1.8, x_q=1.7, x_d_transient=0.3, x_q_transient=0.55,
        x_subtransient=0.25, x_leakage=0.15, t_d0_transient_s=8.0, t_q0_transient_s=0.4, t_d0_subtransient_s=0.03,
        t_q0_subtransient_s=0.05, exciter=TYPICAL_EXCITER, governor=TYPICAL_GOVERNOR if governed else None,
        stabiliser=TYPICAL_STABILISER if governed else None,
    )  # fmt: skip
