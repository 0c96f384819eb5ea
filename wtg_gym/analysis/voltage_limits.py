"""Internal voltages of the WTG groups, and how stiffly they hold the groups to the grid.

With voltage control E is a state, and the angle moves power with K_p(s) = K_p + K_1/(s + a): a constant E at high
frequencies, a held terminal voltage at low ones.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.modes import slope, synchronising_coefficients
from wtg_gym.physics.parameters import TurbineParameters, VoltageControlParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law
from wtg_gym.reproduce.loops import single_machine, with_moving_voltage

#: Upper end of the voltage that equipment stands continuously [p.u.].
VOLTAGE_LIMIT_PU = 1.1
#: Bus 2 here keeps the groups clear of their reactive limit, which would be a corner of the right-hand side [p.u.].
REGULATED_PU = 1.04
_WTG_BUS = 2


@dataclass(frozen=True, kw_only=True)
class VoltageLimit:
    """The start of the paper's load increase with bus 2 held at a voltage."""

    bus_voltage_pu: float  # of bus 2 [p.u.]
    #: voltage_pu, reactive_pu: |E| and reactive power of each group (n_wtg,) [p.u.].
    voltage_pu: Floats
    reactive_pu: Floats
    synchronising_coefficient: Floats  # K_p of each group at constant E (n_wtg,) [p.u./rad]
    slow_coefficient: Floats  # K_p + K_1/a, at which voltage control settles; K_p without it (n_wtg,) [p.u./rad]
    phase_margin_deg: Floats  # of the reference at K_p(s), under-frequency (n_wtg,) [deg]


def voltage_limits(scenario: Scenario) -> tuple[VoltageLimit, VoltageLimit]:
    """Return the start of a scenario with bus 2 at its scheduled voltage, and where no |E| exceeds 1.1 p.u."""
    scheduled = modified_ieee14().buses[_WTG_BUS - 1].voltage_pu
    assert scheduled is not None

    def excess(bus_voltage_pu: float) -> float:
        return float(start_at(scenario, bus_voltage_pu).voltage_pu.max()) - VOLTAGE_LIMIT_PU

    limited = float(brentq(excess, 1.0, scheduled, xtol=1e-6))
    return start_at(scenario, scheduled), start_at(scenario, limited)


def start_at(
    scenario: Scenario,
    bus_voltage_pu: float,
    *,
    turbine: TurbineParameters | None = None,
    voltage_control: VoltageControlParameters | None = None,
) -> VoltageLimit:
    """Return the start of a scenario with bus 2 held at another voltage; without voltage control E is constant."""
    turbine = turbine or TurbineParameters()
    case, law = modified_ieee14(), get_law(REFERENCE_STRATEGY, turbine)
    buses = tuple(
        dataclasses.replace(bus, voltage_pu=bus_voltage_pu) if bus.number == _WTG_BUS else bus for bus in case.buses
    )
    settings = PlantSettings(
        case=dataclasses.replace(case, buses=buses), turbine=turbine, voltage_control=voltage_control
    )
    simulator = Simulator(settings, duration_s=scenario.duration_s)
    simulator.start(0, scenario, (law,) * len(settings.groups))
    simulator.evaluate()
    k_p = np.diag(synchronising_coefficients(scenario, law, settings))
    effects = [(0.0, 1.0)] * k_p.size
    if voltage_control is not None:
        effects = [voltage_feedback(simulator, group) for group in range(k_p.size)]
    winds = scenario.wind_speed[:, 0]
    loops = [
        with_moving_voltage(single_machine(law, float(w), float(k), turbine=turbine), *effect)
        for w, k, effect in zip(winds, k_p, effects, strict=True)
    ]
    return VoltageLimit(
        bus_voltage_pu=bus_voltage_pu,
        voltage_pu=simulator.wtg_values("emf")[0],
        reactive_pu=reactive_power(simulator),
        synchronising_coefficient=k_p,
        slow_coefficient=k_p + np.array([effect / decay for effect, decay in effects]),
        phase_margin_deg=np.array([loop.margins().phase_margin_deg for loop in loops]),
    )


def voltage_feedback(simulator: Simulator, group: int) -> tuple[float, float]:
    """Return K_1 [p.u./(rad s)] and a [1/s] of a group at rest in lane 0, everybody else's states held."""
    layout, here = simulator.layout, simulator.state()
    names = layout.state_names
    internal = names.index(f"wtg{group}.internal_voltage")

    def read() -> Floats:
        return np.array([simulator.wtg_values("power")[0, group], simulator.rates()[internal]])

    places = names.index(f"wtg{group}.angle"), internal
    (_, rate_by_angle), (power_by_voltage, rate_by_voltage) = (slope(simulator, here, at, read) for at in places)
    simulator.set_state(here)
    simulator.evaluate()
    return float(power_by_voltage * rate_by_angle), float(-rate_by_voltage)


def reactive_power(simulator: Simulator, lane: int = 0) -> Floats:
    """Return the reactive power that every group feeds into its bus, on its own base (n_wtg,) [p.u.]."""
    settings = simulator.settings
    buses = [settings.case.bus_index(group.bus) for group in settings.groups]
    voltage = np.abs(simulator.bus_voltages(lane))[buses]
    reactance = settings.control.reactance_pu
    across = reactance * simulator.wtg_values("power")[lane] / voltage
    along = np.sqrt(simulator.wtg_values("emf")[lane] ** 2 - across**2)
    return np.asarray(voltage * (along - voltage) / reactance)
