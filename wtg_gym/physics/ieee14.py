"""The modified IEEE 14-bus system as data: WTG groups in the place of the generator at bus 2.

Power-flow data: the IEEE 14-bus test case (University of Washington archive; the same numbers as MATPOWER's case14).
Machine data: F. Milano's dynamic data for this system, see :mod:`wtg_gym.physics.parameters`.
"""

from __future__ import annotations

import functools
from typing import Any

from wtg_gym.physics.machine_parameters import ExciterParameters, GovernorParameters, SynchronousMachineParameters
from wtg_gym.physics.network import Branch, Bus, NetworkCase

# number, load [MW], load [Mvar], shunt [Mvar], held voltage [p.u.]
_BUSES = (
    (1, 0.0, 0.0, 0.0, 1.06),
    (2, 21.7, 12.7, 0.0, 1.045),
    (3, 94.2, 19.0, 0.0, 1.01),
    (4, 47.8, -3.9, 0.0, None),
    (5, 7.6, 1.6, 0.0, None),
    (6, 11.2, 7.5, 0.0, 1.07),
    (7, 0.0, 0.0, 0.0, None),
    (8, 0.0, 0.0, 0.0, 1.09),
    (9, 29.5, 16.6, 19.0, None),
    (10, 9.0, 5.8, 0.0, None),
    (11, 3.5, 1.8, 0.0, None),
    (12, 6.1, 1.6, 0.0, None),
    (13, 13.5, 5.8, 0.0, None),
    (14, 14.9, 5.0, 0.0, None),
)
# from, to, r, x, b, tap [p.u.]
_BRANCHES = (
    (1, 2, 0.01938, 0.05917, 0.0528, 1.0),
    (1, 5, 0.05403, 0.22304, 0.0492, 1.0),
    (2, 3, 0.04699, 0.19797, 0.0438, 1.0),
    (2, 4, 0.05811, 0.17632, 0.0340, 1.0),
    (2, 5, 0.05695, 0.17388, 0.0346, 1.0),
    (3, 4, 0.06701, 0.17103, 0.0128, 1.0),
    (4, 5, 0.01335, 0.04211, 0.0, 1.0),
    (4, 7, 0.0, 0.20912, 0.0, 0.978),
    (4, 9, 0.0, 0.55618, 0.0, 0.969),
    (5, 6, 0.0, 0.25202, 0.0, 0.932),
    (6, 11, 0.09498, 0.19890, 0.0, 1.0),
    (6, 12, 0.12291, 0.25581, 0.0, 1.0),
    (6, 13, 0.06615, 0.13027, 0.0, 1.0),
    (7, 8, 0.0, 0.17615, 0.0, 1.0),
    (7, 9, 0.0, 0.11001, 0.0, 1.0),
    (9, 10, 0.03181, 0.08450, 0.0, 1.0),
    (9, 14, 0.12711, 0.27038, 0.0, 1.0),
    (10, 11, 0.08205, 0.19207, 0.0, 1.0),
    (12, 13, 0.22092, 0.19988, 0.0, 1.0),
    (13, 14, 0.17093, 0.34802, 0.0, 1.0),
)
# bus, rating [MVA], 2H [s], x_d, x'_d, x'', x_q, x'_q [p.u.], T'_d0, T''_d0, T'_q0, T''_q0 [s]
_MACHINES = (
    (1, 615.0, 10.296, 0.8979, 0.2998, 0.23, 0.646, 0.646, 7.4, 0.03, 1.0, 0.033),
    (3, 60.0, 13.08, 1.05, 0.185, 0.13, 0.98, 0.36, 6.1, 0.04, 0.3, 0.099),
    (6, 25.0, 10.12, 1.25, 0.232, 0.12, 1.22, 0.715, 4.75, 0.06, 1.5, 0.21),
    (8, 25.0, 10.12, 1.25, 0.232, 0.12, 1.22, 0.715, 4.75, 0.06, 1.5, 0.21),
)
_MACHINE_FIELDS = (
    *("bus", "rating_mva", "two_h_s", "x_d", "x_d_transient", "x_subtransient", "x_q", "x_q_transient"),
    *("t_d0_transient_s", "t_d0_subtransient_s", "t_q0_transient_s", "t_q0_subtransient_s"),
)


@functools.cache
def modified_ieee14(*, classical: bool = False) -> NetworkCase:
    """Return the modified IEEE 14-bus system at 50 Hz on 100 MVA, without its WTG groups.

    Args:
        classical: constant voltage behind x'_d for every machine instead of GENROU and exciter.
    """
    slack_bus = 1
    machines = []
    for row in _MACHINES:
        data: dict[str, Any] = dict(zip(_MACHINE_FIELDS, row, strict=True))
        governor = GovernorParameters() if data["bus"] == slack_bus else None
        exciter = None if classical else ExciterParameters()
        machines.append(SynchronousMachineParameters(**data, governor=governor, exciter=exciter, classical=classical))
    return NetworkCase(
        name="modified IEEE 14-bus system",
        base_mva=100.0,
        frequency_hz=50.0,
        slack_bus=slack_bus,
        buses=tuple(Bus(number=n, load_mw=p, load_mvar=q, shunt_mvar=b, voltage_pu=v) for n, p, q, b, v in _BUSES),
        branches=tuple(
            Branch(from_bus=f, to_bus=t, resistance=r, reactance=x, charging=b, tap=tap)
            for f, t, r, x, b, tap in _BRANCHES
        ),
        machines=tuple(machines),
    )
