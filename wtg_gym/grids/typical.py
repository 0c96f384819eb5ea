"""Typical machines, for cases that say what each one gives and nothing else."""

from __future__ import annotations

import dataclasses

import numpy as np

from wtg_gym.physics.machine_parameters import ExciterParameters, GovernorParameters, SynchronousMachineParameters
from wtg_gym.physics.network import NetworkCase, PowerFlow, assemble_admittance, branch_admittances
from wtg_gym.physics.sparse_flow import pattern_of, solve_sparse_flow

#: Rating over the apparent power of the power flow, and the least one [MVA].
_MARGIN, _LEAST_MVA = 1.3, 20.0
#: Columns of a bus in the power flow.
_AT = PowerFlow(power=0, polar=2, holds_voltage=4, flow=5, voltage=7)


def typical_machine(bus: int, power_mw: float, slack: bool) -> SynchronousMachineParameters:
    """Return a machine of a rating that :func:`rated` corrects; one that gives no power is a condenser.

    Its values are those of a large round-rotor machine; source: P. Kundur: Power System Stability and Control, table
    4.2.
    """
    governed = power_mw > 0.0 or slack
    return SynchronousMachineParameters(
        bus=bus, rating_mva=_LEAST_MVA, two_h_s=8.0 if governed else 3.0, dispatch_mw=power_mw, damping_pu=0.0,
        x_d=1.8, x_q=1.7, x_d_transient=0.3, x_q_transient=0.55, x_subtransient=0.25, x_leakage=0.15,
        t_d0_transient_s=8.0, t_q0_transient_s=0.4, t_d0_subtransient_s=0.03, t_q0_subtransient_s=0.05,
        exciter=ExciterParameters(), governor=GovernorParameters(droop_pu=0.05) if governed else None,
    )  # fmt: skip


def rated(case: NetworkCase) -> NetworkCase:
    """Return a network whose machines are rated for what they give in its power flow.

    Raises:
        ValueError: the power flow has no solution.
    """
    power = {machine.bus: 0j for machine in case.machines}
    rows = np.zeros((len(case.buses), 9))
    for row, bus in zip(rows, case.buses, strict=True):
        row[:2] = -bus.load_mw / case.base_mva, -bus.load_mvar / case.base_mva
        row[_AT.polar], row[_AT.holds_voltage] = bus.voltage_pu or 1.0, float(bus.voltage_pu is not None)
    for machine in case.machines:
        rows[case.bus_index(machine.bus), 0] += machine.dispatch_mw / case.base_mva
    ends = np.array([[case.bus_index(b.from_bus), case.bus_index(b.to_bus)] for b in case.branches], dtype=np.int64)
    shunts = np.array([complex(bus.shunt_mw, bus.shunt_mvar) / case.base_mva for bus in case.buses])
    y = assemble_admittance(ends, branch_admittances(case.branches), shunts)
    if solve_sparse_flow(y, case.bus_index(case.slack_bus), rows, _AT, pattern_of(y)) < 0:
        raise ValueError(f"the power flow of {case.name} has no solution")
    for bus, row in zip(case.buses, rows, strict=True):
        if bus.number in power:
            power[bus.number] = case.base_mva * complex(*row[_AT.flow :][:2]) + complex(bus.load_mw, bus.load_mvar)
    machines = (
        dataclasses.replace(machine, rating_mva=max(_MARGIN * abs(power[machine.bus]), _LEAST_MVA))
        for machine in case.machines
    )
    return dataclasses.replace(case, machines=tuple(machines))
