"""Internal voltages of the WTG groups, and the bus voltage that would keep them within the limit of equipment."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from wtg_gym.analysis.eigenvalues import synchronising_coefficients
from wtg_gym.analysis.loops import single_machine
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES

#: Upper end of the voltage that equipment stands continuously [p.u.].
VOLTAGE_LIMIT_PU = 1.1
#: Reactive power at a power factor of 0.95 and rated active power, a usual requirement of grid codes [p.u.].
REACTIVE_LIMIT_PU = math.tan(math.acos(0.95))
_WTG_BUS = 2


@dataclass(frozen=True, kw_only=True)
class VoltageLimit:
    """The start of the paper's load increase with bus 2 held at a voltage.

    Args:
        bus_voltage_pu: of bus 2 [p.u.].
        voltage_pu, reactive_pu: |E| and reactive power of each group (n_wtg,) [p.u.].
        synchronising_coefficient: K_p of each group (n_wtg,) [p.u./rad].
        phase_margin_deg: of the reference at that K_p, under-frequency (n_wtg,) [deg].
    """

    bus_voltage_pu: float
    voltage_pu: Floats
    reactive_pu: Floats
    synchronising_coefficient: Floats
    phase_margin_deg: Floats


def voltage_limits(scenario: Scenario) -> tuple[VoltageLimit, VoltageLimit]:
    """Return the start of a scenario with bus 2 at its scheduled voltage, and where no |E| exceeds 1.1 p.u."""
    scheduled = modified_ieee14().buses[_WTG_BUS - 1].voltage_pu
    assert scheduled is not None

    def excess(bus_voltage_pu: float) -> float:
        return float(_start_at(scenario, bus_voltage_pu).voltage_pu.max()) - VOLTAGE_LIMIT_PU

    limited = float(brentq(excess, 1.0, scheduled, xtol=1e-6))
    return _start_at(scenario, scheduled), _start_at(scenario, limited)


def _start_at(scenario: Scenario, bus_voltage_pu: float) -> VoltageLimit:
    """Return the start of a scenario in the paper's plant with bus 2 held at another voltage [p.u.]."""
    case, law = modified_ieee14(), STRATEGIES[REFERENCE_STRATEGY]
    buses = tuple(
        dataclasses.replace(bus, voltage_pu=bus_voltage_pu) if bus.number == _WTG_BUS else bus for bus in case.buses
    )
    settings = PlantSettings(case=dataclasses.replace(case, buses=buses))
    simulator = Simulator(settings, duration_s=scenario.duration_s)
    simulator.start(0, scenario, (law,) * len(settings.groups))
    simulator.evaluate()
    k_p = np.diag(synchronising_coefficients(scenario, law, settings))
    winds = scenario.wind_speed[:, 0]
    margins = [
        single_machine(law, float(w), float(k)).margins().phase_margin_deg for w, k in zip(winds, k_p, strict=True)
    ]
    return VoltageLimit(
        bus_voltage_pu=bus_voltage_pu,
        voltage_pu=simulator.wtg_values("emf")[0],
        reactive_pu=reactive_power(simulator),
        synchronising_coefficient=k_p,
        phase_margin_deg=np.array(margins),
    )


def reactive_power(simulator: Simulator, lane: int = 0) -> Floats:
    """Return the reactive power that every group feeds into its bus, on its own base (n_wtg,) [p.u.]."""
    settings = simulator.settings
    buses = [settings.case.bus_index(group.bus) for group in settings.groups]
    voltage = np.abs(simulator.bus_voltages(lane))[buses]
    reactance = settings.control.reactance_pu
    across = reactance * simulator.wtg_values("power")[lane] / voltage
    along = np.sqrt(simulator.wtg_values("emf")[lane] ** 2 - across**2)
    return np.asarray(voltage * (along - voltage) / reactance)
