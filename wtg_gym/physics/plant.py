"""From parameters to the tables the kernels read."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Plant
from wtg_gym.physics.network import NetworkCase, branch_admittances
from wtg_gym.physics.parameters import (
    GridFormingParameters,
    PitchParameters,
    ProtectionParameters,
    TurbineParameters,
    WtgGroup,
    default_groups,
)
from wtg_gym.physics.scenario import require_range
from wtg_gym.physics.synchronous_machine import MachineConstant, machine_constants
from wtg_gym.physics.wind_turbine import TurbineConstant, turbine_constants

#: Integration steps that are accepted [s].
SIMULATION_DT_RANGE = (5e-5, 0.04)


def whole_steps(name: str, interval: float, step: float, step_name: str) -> int:
    """Return how many steps make up an interval [s].

    Raises:
        ValueError: it is not a whole number of steps (within a rounding of 1e-6 steps); the message names both.
    """
    count = round(interval / step)
    if abs(count * step - interval) > 1e-6 * step:
        raise ValueError(f"{name} = {interval:g} s is not a whole number of {step_name}s of {step:g} s")
    return count


@dataclass(frozen=True, kw_only=True)
class PlantSettings:
    """A network, its WTG groups and the time steps.

    Args:
        case: the network with its synchronous machines.
        groups: the WTG groups; may be empty where the network has machines.
        turbine, pitch, control, protection: parameters of every WTG, and what ends a run.
        control_dt: control interval [s], a whole number of simulation steps.
        simulation_dt: step of the integration, 0.05 … 40 ms [s]; a simulator refuses one that is too long for the
            plant's fastest mode.
        trips_groups: a stalled or over-speeding group is disconnected instead of ending the run.

    Raises:
        ValueError: a bus is unknown, a step does not divide, or a value is outside its range.
    """

    case: NetworkCase = dataclasses.field(default_factory=modified_ieee14)
    groups: tuple[WtgGroup, ...] = dataclasses.field(default_factory=default_groups)
    turbine: TurbineParameters = dataclasses.field(default_factory=TurbineParameters)
    pitch: PitchParameters = dataclasses.field(default_factory=PitchParameters)
    control: GridFormingParameters = dataclasses.field(default_factory=GridFormingParameters)
    protection: ProtectionParameters = dataclasses.field(default_factory=ProtectionParameters)
    control_dt: float = 0.1
    simulation_dt: float = 0.025
    trips_groups: bool = False

    def __post_init__(self) -> None:
        require_range("simulation_dt", self.simulation_dt, *SIMULATION_DT_RANGE, "s")
        require_range("control_dt", self.control_dt, self.simulation_dt, 10.0, "s")
        whole_steps("control_dt", self.control_dt, self.simulation_dt, "simulation step")
        for group in self.groups:
            self.case.bus_index(group.bus)
            require_range(f"n_turbines of the WTG group at bus {group.bus}", group.n_turbines, 1e-3, 1e4, "turbines")


def build_plant(settings: PlantSettings) -> Plant:
    """Return the tables of a plant for the kernels."""
    case = settings.case
    machines = [machine_constants(m, case.base_mva) for m in case.machines]
    turbine = turbine_constants(settings.turbine, settings.pitch, settings.control, settings.protection)
    share = np.array([g.n_turbines * settings.turbine.rated_power_mw / case.base_mva for g in settings.groups])
    buses = [m.bus for m in case.machines] + [g.bus for g in settings.groups]
    unit_bus = np.array([case.bus_index(b) for b in buses], dtype=np.int64)
    internal = [complex(m[MachineConstant.RESISTANCE], m[MachineConstant.INTERNAL_REACTANCE]) for m in machines]
    internal += [1j * turbine[TurbineConstant.REACTANCE] / s for s in share]
    has_unit = np.zeros(len(case.buses), dtype=np.bool_)
    has_unit[unit_bus] = True
    held = np.array([bus.voltage_pu is not None for bus in case.buses])
    return Plant(
        syncs=(0,) * len(machines),
        wtgs=(0,) * len(share),
        machines=np.array(machines).reshape(len(machines), len(MachineConstant)),
        turbine=turbine,
        share=share,
        unit_bus=unit_bus,
        unit_y=1.0 / np.array(internal, dtype=np.complex128),
        branch_from=np.array([case.bus_index(b.from_bus) for b in case.branches], dtype=np.int64),
        branch_to=np.array([case.bus_index(b.to_bus) for b in case.branches], dtype=np.int64),
        branch_y=branch_admittances(case.branches),
        shunt_y=np.array([complex(b.shunt_mw, b.shunt_mvar) / case.base_mva for b in case.buses]),
        load=np.array([complex(b.load_mw, b.load_mvar) / case.base_mva for b in case.buses]),
        voltage=np.array([bus.voltage_pu or 1.0 for bus in case.buses]),
        holds_voltage=held & has_unit,
        dispatch=np.array([m.dispatch_mw / case.base_mva for m in case.machines]),
        slack=case.bus_index(case.slack_bus),
        angular_frequency=2.0 * math.pi * case.frequency_hz,
        base_mva=case.base_mva,
        simulation_dt=settings.simulation_dt,
        n_substeps=whole_steps("control_dt", settings.control_dt, settings.simulation_dt, "simulation step"),
        trips_groups=settings.trips_groups,
    )
